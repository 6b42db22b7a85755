// Charts over the last seconds, on canvases.

const WINDOW = 12; // s

class Chart {
  // lines: [{name, tone, dashed}]; levels: dashed lines at [value, ...]; least: of the height
  constructor(parent, { title, lines, levels, least }) {
    this.lines = lines;
    this.levels = levels;
    this.least = least;
    this.rows = [];
    const figure = parent.appendChild(document.createElement("figure"));
    const caption = figure.appendChild(document.createElement("figcaption"));
    caption.appendChild(document.createElement("b")).textContent = title;
    for (const { name, tone, dashed } of lines) {
      const key = caption.appendChild(document.createElement("span"));
      key.className = dashed ? "key dashed" : "key";
      key.style.setProperty("--tone", `var(--${tone})`);
      key.textContent = name;
    }
    this.canvas = figure.appendChild(document.createElement("canvas"));
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${title} over the last ${WINDOW} seconds`);
  }

  clear() {
    this.rows = [];
  }

  append(time, values) {
    this.rows.push([time, ...values]);
    if (this.rows.length > 6000) this.rows.splice(0, 3000);
  }

  draw(now) {
    const { canvas, lines, levels } = this;
    const ratio = window.devicePixelRatio || 1;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(wide * ratio)) canvas.width = Math.round(wide * ratio);
    if (canvas.height !== Math.round(high * ratio)) canvas.height = Math.round(high * ratio);
    const pen = canvas.getContext("2d");
    const colours = getComputedStyle(canvas);
    const colour = (name) => colours.getPropertyValue(`--${name}`).trim();
    const start = Math.max(now - WINDOW, 0);
    const rows = this.rows.filter((row) => row[0] >= start);
    let [low, top] = [Infinity, -Infinity];
    for (const row of rows) for (let k = 1; k < row.length; k++) { low = Math.min(low, row[k]); top = Math.max(top, row[k]); }
    for (const level of levels) { low = Math.min(low, level); top = Math.max(top, level); }
    if (!(low <= top)) [low, top] = [0, 0];
    const more = Math.max(0.08 * (top - low), 0.5 * (this.least - (top - low)));
    [low, top] = [low - more, top + more];
    const [left, bottom] = [58, 20];
    const x = (time) => left + ((time - start) / WINDOW) * (wide - left - 4);
    const y = (value) => 6 + ((top - value) / (top - low)) * (high - bottom - 6);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, high);
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "middle";
    const step = ticked((top - low) / 4);
    pen.lineWidth = 1;
    for (let value = Math.ceil(low / step) * step; value <= top; value += step) {
      pen.strokeStyle = colour("rule");
      stroke(pen, [[left, y(value)], [wide, y(value)]]);
      pen.fillStyle = colour("soft");
      pen.textAlign = "right";
      pen.fillText(String(Number(value.toPrecision(6)) || 0), left - 6, y(value));
    }
    pen.textAlign = "center";
    for (let time = Math.ceil(start / 2) * 2; time < start + WINDOW; time += 2) pen.fillText(`${time} s`, Math.min(Math.max(x(time), left + 8), wide - 14), high - 8);
    pen.setLineDash([6, 5]);
    pen.strokeStyle = colour("bound");
    for (const level of levels) stroke(pen, [[left, y(level)], [wide, y(level)]]);
    lines.forEach(({ tone, dashed }, k) => {
      pen.setLineDash(dashed ? [6, 5] : []);
      pen.strokeStyle = colour(tone);
      pen.lineWidth = 2;
      stroke(pen, rows.map((row) => [x(row[0]), y(row[k + 1])]));
    });
    pen.setLineDash([]);
  }
}

function stroke(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

// 1, 2 or 5 times a power of ten, at least a size.
function ticked(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return [1, 2, 5, 10].map((part) => part * power).find((part) => part >= size * (1 - 1e-9));
}

// Charts over time, on uPlot: the window moves with the newest measurement.

/* global uPlot */

export class Rows {
  // The last rows of a table, a column an array, in memory that is there from the start.
  constructor(columns, capacity) {
    this.capacity = capacity;
    this.columns = Array.from({ length: columns }, () => new Float64Array(2 * capacity));
    this.count = 0;
  }

  clear() {
    this.count = 0;
  }

  append(numbers, rows) {
    const wide = this.columns.length;
    for (let row = Math.max(0, rows - this.capacity); row < rows; row++) {
      if (this.count === 2 * this.capacity) {
        for (const column of this.columns) column.copyWithin(0, this.capacity);
        this.count = this.capacity;
      }
      for (let k = 0; k < wide; k++) this.columns[k][this.count] = numbers[row * wide + k];
      this.count += 1;
    }
  }

  // Columns from a time on; the row before it, too, so that lines begin outside of the chart.
  since(time) {
    const times = this.columns[0];
    let low = Math.max(0, this.count - this.capacity), high = this.count;
    const first = low;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < time) low = middle + 1;
      else high = middle;
    }
    const begin = Math.max(first, low - 1);
    return this.columns.map((column) => column.subarray(begin, this.count));
  }

  last(column) {
    return this.count ? this.columns[column][this.count - 1] : NaN;
  }
}

// The colours of the style sheet, looked up once for each theme.
const palette = new Map();

export const forgetColours = () => palette.clear();

export function colour(name) {
  if (!palette.has(name)) palette.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return palette.get(name);
}

export class Chart {
  // lines: [{name, tone, data: () => [times, values], step, dash, width}]; levels: dashed lines at [value, ...]; marks: the only values
  // named at its left, where it is low.
  constructor(parent, { title, kind, lines, levels = [], marks = null, clock, least = 0, decimals = 2, zero = false, last = false }) {
    Object.assign(this, { lines, levels, marks, clock, least, decimals, zero, last, full: () => null, layers: [] });
    const box = parent.appendChild(document.createElement("div"));
    box.className = `chart ${kind}`;
    const head = box.appendChild(document.createElement("div"));
    head.className = "title";
    head.appendChild(document.createElement("b")).textContent = title;
    this.note = document.createElement("span");
    for (const line of lines) {
      if (!line.name) continue;
      line.key = head.appendChild(document.createElement("span"));
      line.key.className = line.dash ? "key dashed" : "key";
      line.key.style.setProperty("--tone", `var(--${line.tone})`);
      line.key.textContent = line.name;
    }
    this.note.className = "key note";
    this.place = box.appendChild(document.createElement("div"));
    this.place.className = "plot";
    this.range = [NaN, NaN];
    this.overlay = null;
    this.build();
    new ResizeObserver(() => this.resize()).observe(this.place);
  }

  build() {
    const labelled = (this.labelled = this.last || matchMedia("(max-width: 1199px)").matches);
    const axis = { stroke: colour("soft"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, border: { show: false }, font: "11px system-ui" };
    const options = {
      width: Math.max(this.place.clientWidth, 50),
      height: Math.max(this.place.clientHeight, 30),
      legend: { show: false },
      cursor: { drag: { x: false, y: false, setScale: false }, points: { show: false } },
      padding: [8, 10, labelled ? 0 : 6, 0],
      scales: { x: { time: false, range: () => this.clock.window() }, y: { range: () => this.limits() } },
      axes: [
        { ...axis, size: labelled ? 20 : 2, gap: 2, splits: () => this.clock.ticks(), values: (u, values) => values.map((value) => this.label(value)) },
        { ...axis, size: 46, gap: 4, space: 18, ...(this.marks && { splits: () => this.marks }) },
      ],
      series: [{}, { show: false }],
      hooks: { draw: [(u) => this.draw(u)] },
    };
    this.plot?.destroy();
    this.plot = new uPlot(options, [[0, 1], [0, 1]], this.place);
    this.plot.over.append(...this.layers);
  }

  // An element of a class over the plot, which stays there.
  lay(name) {
    const layer = document.createElement("div");
    layer.className = name;
    this.layers.push(layer);
    this.plot.over.append(layer);
    return layer;
  }

  // Of a time, below the last chart only, or each where one sees few at a time.
  label(time) {
    return this.labelled ? `${+(time - this.clock.now).toFixed(1)} s` : "";
  }

  resize() {
    this.plot.setSize({ width: Math.max(this.place.clientWidth, 50), height: Math.max(this.place.clientHeight, 30) });
  }

  // Values shown: wide enough at once, narrower only by and by, so that nothing jumps; the full range where that is
  // wanted.
  limits() {
    const full = this.full();
    if (full) {
      const margin = 0.06 * (full[1] - full[0]);
      return (this.range = [full[0] - margin, full[1] + margin]);
    }
    let low = this.zero ? 0 : Infinity, high = -Infinity;
    const [begin, end] = this.clock.window();
    for (const line of this.lines) {
      const [times, values] = line.data();
      for (let k = 0; k < values.length; k += 1 + (values.length >> 9)) {
        if (values[k] < low && times[k] >= begin && times[k] <= end) low = values[k];
        if (values[k] > high && times[k] >= begin && times[k] <= end) high = values[k];
      }
    }
    if (!(high >= low)) return Number.isFinite(this.range[0]) ? this.range : [0, 1]; // the first values set the range at once
    const middle = (low + high) / 2, half = Math.max(0.56 * (high - low), this.least / 2, 1e-9);
    const wanted = [this.zero ? 0 : middle - half, middle + half];
    const kept = 0.04;
    this.range = this.range.map((old, k) => {
      const grows = k ? wanted[k] > old : wanted[k] < old;
      return Number.isFinite(old) && !grows ? old + kept * (wanted[k] - old) : wanted[k];
    });
    return this.range;
  }

  show() {
    this.plot.setData([[this.clock.now, this.clock.now + 1], [0, 0]], true);
  }

  // The value beside each name, and a note behind them.
  tell(note) {
    for (const line of this.lines) {
      if (!line.key) continue;
      const [times, values] = line.data();
      const value = line.ahead ? at(times, values, this.clock.now) : values[values.length - 1];
      line.key.textContent = Number.isFinite(value) ? `${line.name} ${fixed(value, this.decimals)}` : line.name;
    }
    if (note !== undefined) {
      if (!this.note.parentNode) this.place.previousElementSibling.appendChild(this.note);
      this.note.textContent = note;
    }
  }

  draw(u) {
    const context = u.ctx, { left, top, width, height } = u.bbox;
    const [begin, end] = this.clock.window(), ratio = devicePixelRatio || 1;
    const x = (time) => left + ((time - begin) / (end - begin)) * width;
    const y = (value) => u.valToPos(value, "y", true);
    const y0 = y(0), slope = y(1) - y0;
    context.save();
    context.beginPath();
    context.rect(left, top, width, height);
    context.clip();
    for (const level of this.levels) stroke(context, "soft", ratio, [5, 4], [[left, y(level)], [left + width, y(level)]]);
    stroke(context, "soft", ratio, [2, 3], [[x(this.clock.now), top], [x(this.clock.now), top + height]]);
    for (const line of this.lines) {
      const [times, values] = line.data();
      context.beginPath();
      let pen = false, before = 0;
      for (let k = 0; k < times.length; k++) {
        const value = values[k];
        if (!(value === value)) {
          pen = false;
          continue;
        }
        const right = left + ((times[k] - begin) / (end - begin)) * width, up = y0 + slope * value;
        if (!pen) context.moveTo(right, up);
        else {
          if (line.step) context.lineTo(right, before);
          context.lineTo(right, up);
        }
        pen = true;
        before = up;
      }
      context.strokeStyle = colour(line.tone);
      context.lineWidth = (line.width ?? 1.5) * ratio;
      context.lineJoin = "round";
      context.setLineDash((line.dash ?? []).map((d) => d * ratio));
      context.stroke();
    }
    this.overlay?.(context, x, y, ratio);
    context.restore();
  }
}

function stroke(context, tone, width, dash, [from, to]) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.strokeStyle = colour(tone);
  context.lineWidth = width;
  context.setLineDash(dash.map((d) => d * width));
  context.stroke();
}

// A number with so many decimals; nothing is -0.
export const fixed = (value, decimals) => (value + 0).toFixed(decimals).replace(/^-(0\.?0*)$/, "$1");

// A line's value at a time.
export function at(times, values, time) {
  let k = times.length - 1;
  while (k > 0 && times[k] > time) k -= 1;
  return times.length ? values[k] : NaN;
}

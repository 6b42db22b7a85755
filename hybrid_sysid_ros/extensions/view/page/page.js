// The page: takes frames, draws them, and asks for what its user wants. It asks for a frame when it has drawn the one
// before, so that a slow or hidden page costs nothing. The server checks all it says.

import { Chart, Rows, at, colour, fixed, forgetColours } from "./charts.js";
import { Connection } from "./connection.js";
import { Drawing } from "./drawing.js";

const element = (id) => document.getElementById(id);
const AHEAD = 3; // s, shown right of now, where curves are drawn
const SLIDES = 33; // ms, between two set-points of a slider
const LEVELS = ["ok", "warn", "error", "stale"];
const WORST = ["error", "stale", "warn", "ok"];
const SILENT = 2000; // ms without diagnostics of a node
const LAYERS = { policy: "predicted", exact: "estimate", feedback: "measured", shifted_plan: "warn", held: "warn", zeroed: "error", stopped: "error" };
const OTHER = "stale"; // colour of other layers

let rig = null;
let tables = {}, latest = {}, charts = [], drawing = null;
let statuses = new Map(), shares = [], counted = null;
let epoch = -1;
const pictures = [];

// Time: the window of the charts ends AHEAD behind the newest measurement. While a curve is drawn it stands still.
const clock = {
  now: 0,
  frozen: false,
  window() {
    return [this.now - Number(element("back").value), this.now + AHEAD];
  },
  ticks() {
    const [begin, end] = this.window(), step = end - begin > 12 ? 4 : end - begin > 8 ? 2 : 1, found = [];
    for (let t = this.now - step * Math.floor((this.now - begin) / step); t <= end; t += step) found.push(t);
    return found;
  },
};

function say(line, tone = "") {
  element("line").textContent = line || "\u00a0";
  element("line").className = tone;
}

function ask(request) {
  if (!connection.ask(request)) say("no connection", "bad");
}

function lost(reason) {
  badge("no connection", "error");
  say(reason || "the connection is lost: trying again", "bad");
}

function hear(message) {
  if (message.rig) return greet(message);
  say(message.line, message.done ? "good" : "bad");
}

function greet(greeting) {
  rig = greeting;
  document.title = `${rig.rig} – live view`;
  element("rig").textContent = rig.rig;
  const capacity = Math.ceil((Math.max(rig.seconds, 20) * 1.2) / rig.period);
  const outputs = rig.outputs.length, inputs = rig.inputs.length;
  tables = {
    measured: new Rows(1 + outputs + inputs, capacity),
    estimate: new Rows(1 + outputs + inputs + rig.joints.length, capacity),
    command: new Rows(1 + inputs + 1, capacity),
    asked: new Rows(1 + rig.outputs.filter((o) => o.tracked).length, capacity),
  };
  begin(-1);
  statuses = new Map();
  drawing = new Drawing(element("drawing"), rig.drawing, rig.extent);
  buildCharts();
  buildControls();
  say("");
  connection.wantNext();
}

// A frame: the length of its head, the head as JSON, and the numbers that it names.
function take(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let place = 4 + length;
  const numbers = (rows, columns) => {
    const found = new Float64Array(buffer, place, rows * columns);
    place += found.byteLength;
    return found;
  };
  if (head.epoch !== epoch) begin(head.epoch);
  for (const [name, rows, columns] of head.tables) tables[name].append(numbers(rows, columns), rows);
  for (const [name, rows, columns] of head.latest) {
    latest[name] = columnsOf(numbers(rows, columns), rows, columns);
  }
  for (const item of Object.values(head.news)) if (item.node) learn(item);
  requestAnimationFrame(picture);
}

function begin(number) {
  epoch = number;
  for (const table of Object.values(tables)) table.clear();
  latest = {};
  shares = [];
  counted = null;
}

function columnsOf(numbers, rows, columns) {
  const found = Array.from({ length: columns }, () => new Float64Array(rows));
  for (let k = 0; k < rows * columns; k++) found[k % columns][Math.floor(k / columns)] = numbers[k];
  return found;
}

function learn(status) {
  status.heard = performance.now();
  statuses.set(`${status.node}: ${status.task}`, status);
  if (status.node === "controller" && status.task === "loop") countLayers(status.values);
}

// Shares of the layers of safety between two diagnostics.
function countLayers(values) {
  const keys = Object.keys(values).filter((key) => key.startsWith("layer_") && key !== "layer_no_reference");
  const found = Object.fromEntries(keys.map((key) => [key.slice(6), Number(values[key])]));
  if (counted) {
    const grown = Object.entries(found).map(([name, count]) => [name, Math.max(count - (counted[name] ?? 0), 0)]);
    const total = grown.reduce((sum, [, count]) => sum + count, 0);
    if (total) shares.push({ time: clock.now, parts: grown.map(([name, count]) => [name, count / total]) });
    if (shares.length > 200) shares.shift();
  }
  counted = found;
}

function buildCharts() {
  element("charts").replaceChildren();
  charts = [];
  const part = (name, column) => () => {
    const found = tables[name].since(clock.window()[0]);
    return [found[0], found[column]];
  };
  const newest = (name, column) => () => (latest[name] && latest[name][0].at(-1) > clock.now - 0.5 ? [latest[name][0], latest[name][column]] : [[], []]);
  let tracked = 0;
  rig.outputs.forEach((output, k) => {
    const lines = [{ name: "measured", tone: "measured", data: part("measured", 1 + k), width: 1.2 }, { name: "estimate", tone: "estimate", data: part("estimate", 1 + k), width: 1.8 }];
    const index = output.tracked ? tracked++ : -1;
    if (output.tracked) {
      lines.unshift({ name: "reference", tone: "reference", ahead: true, width: 1.8, data: () => referred(index) });
      lines.push({ name: "predicted", tone: "predicted", ahead: true, dash: [5, 3], width: 2, data: newest("prediction", 1 + k) });
    }
    const title = `${output.name.replaceAll("_", " ")} [${output.unit || "1"}]`;
    const least = output.tracked ? 0.1 * (output.high - output.low) : 0;
    const chart = new Chart(element("charts"), { title, kind: "output", lines, clock, least });
    if (output.tracked) drawable(chart, output, index);
    charts.push(chart);
  });
  const outputs = rig.outputs.length;
  rig.inputs.forEach((input, k) => {
    const lines = [
      { name: "applied", tone: "measured", data: part("measured", 1 + outputs + k), width: 1.2 },
      { name: "command", tone: "estimate", data: part("command", 1 + k), step: true, width: 1.6 },
      { name: "planned", tone: "predicted", ahead: true, dash: [5, 3], step: true, width: 2, data: newest("prediction", 1 + outputs + k) },
    ];
    const title = `${input.name.replaceAll("_", " ")} [${input.unit || "1"}]`;
    charts.push(new Chart(element("charts"), { title, kind: "input", lines, levels: [input.low, input.high], clock, least: 0.1 * (input.high - input.low) }));
  });
  const delay = new Chart(element("charts"), {
    title: "delay [ms], from measurement to command", kind: "small", clock, zero: true, least: 1.2e3 * rig.period, levels: [1e3 * rig.period],
    lines: [{ tone: "estimate", data: part("command", 1 + rig.inputs.length), width: 1.2 }],
  });
  delay.noting = () => {
    const found = Array.from(tables.command.since(clock.window()[0])[1 + rig.inputs.length]).filter(Number.isFinite).sort((a, b) => a - b);
    const percentile = (p) => (found.length ? found[Math.min(found.length - 1, Math.floor(p * found.length))].toFixed(2) : "–");
    return `median ${percentile(0.5)}, 99 % ${percentile(0.99)}`;
  };
  charts.push(delay);
  const layers = new Chart(element("charts"), { title: "layers of safety [% of the answers]", kind: "small", last: true, clock, zero: true, lines: [] });
  layers.limits = () => [0, 100];
  layers.overlay = (context, x, y) => {
    shares.forEach(({ time, parts }, k) => {
      const end = shares[k + 1]?.time ?? clock.now;
      let from = 0;
      parts.forEach(([name, part]) => {
        if (!part) return;
        context.fillStyle = colour(LAYERS[name] ?? OTHER);
        context.fillRect(x(time), y(100 * (from + part)), x(end) - x(time) + 1, y(100 * from) - y(100 * (from + part)));
        from += part;
      });
    });
  };
  layers.noting = () => {
    const parts = (shares.at(-1)?.parts ?? []).filter(([, part]) => part > 0).sort(([, one], [, other]) => other - one);
    layers.note.style.setProperty("--tone", `var(--${parts.length ? LAYERS[parts[0][0]] ?? OTHER : "soft"})`);
    return parts.map(([name, part]) => `${name.replaceAll("_", " ")} ${(100 * part).toFixed(0)} %`).join(", ") || "no answers";
  };
  charts.push(layers);
}

// What an output was asked for, and will be: what is past of the previews, and the newest one.
function referred(index) {
  const past = tables.asked.since(clock.window()[0]), ahead = latest.reference;
  return ahead ? [joined(past[0], ahead[0]), joined(past[1 + index], ahead[1 + index])] : [[], []];
}

function joined(one, other) {
  const both = new Float64Array(one.length + other.length);
  both.set(one);
  both.set(other, one.length);
  return both;
}

// A curve that is drawn right of now, with a mouse, a pen or a finger; it begins when it is let go.
function drawable(chart, output, index) {
  let curve = null;
  const place = (event) => {
    const box = chart.plot.over.getBoundingClientRect(), [begin, end] = clock.window();
    const time = begin + ((event.clientX - box.left) / box.width) * (end - begin) - clock.now;
    const value = chart.plot.posToVal(event.clientY - box.top, "y");
    return [Math.min(Math.max(time, 0), rig.curve), Math.min(Math.max(value, output.low), output.high)];
  };
  chart.place.addEventListener("pointerdown", (event) => {
    const box = chart.plot.over.getBoundingClientRect(), [begin, end] = clock.window();
    if (begin + ((event.clientX - box.left) / box.width) * (end - begin) < clock.now || event.clientX > box.right || event.button) return;
    chart.place.setPointerCapture(event.pointerId);
    clock.frozen = true;
    curve = [place(event)];
  });
  chart.place.addEventListener("pointermove", (event) => {
    if (!curve) return;
    const [time, value] = place(event);
    while (curve.length && curve.at(-1)[0] > time - 1e-3) curve.pop();
    curve.push([time, value]);
  });
  const end = (event) => {
    if (!curve) return;
    clock.frozen = false;
    const drawn = curve;
    curve = null;
    if (event.type === "pointerup") followCurve(drawn, output, index);
  };
  chart.place.addEventListener("pointerup", end);
  chart.place.addEventListener("pointercancel", end);
  chart.overlay = (context, x, y, ratio) => {
    context.fillStyle = colour("reference");
    context.globalAlpha = 0.06;
    context.fillRect(x(clock.now), y(output.high), x(clock.now + AHEAD) - x(clock.now), y(output.low) - y(output.high));
    context.globalAlpha = 1;
    if (!curve) return;
    context.beginPath();
    for (const [time, value] of curve) context.lineTo(x(clock.now + time), y(value));
    context.strokeStyle = colour("reference");
    context.lineWidth = 3 * ratio;
    context.setLineDash([]);
    context.stroke();
  };
}

function followCurve(curve, output, index) {
  const present = presentReference();
  const step = Math.ceil(curve.length / (rig.points - 2));
  const points = curve.filter((_, k) => k % step === 0 || k === curve.length - 1);
  if (points[0][0] > 2e-3) points.unshift([0, present[index]], [points[0][0] - 1e-3, present[index]]);
  const times = points.map(([time]) => time);
  ask({ do: "set_point", times, values: points.map(([, value]) => present.map((other, k) => (k === index ? value : other))) });
}

// The reference of now, within what may be asked for.
function presentReference() {
  return rig.outputs.filter((o) => o.tracked).map((output, k) => {
    const value = at(...referred(k), clock.now);
    return Math.min(Math.max(Number.isFinite(value) ? value : 0, output.low), output.high);
  });
}

function button(parent, label, action) {
  const made = parent.appendChild(document.createElement("button"));
  made.textContent = label.replaceAll("_", " ");
  made.dataset.name = label;
  made.addEventListener("click", action);
  return made;
}

const sliders = [];

function buildControls() {
  for (const id of ["kinds", "policies", "faults", "setpoints"]) element(id).replaceChildren();
  for (const kind of rig.kinds) button(element("kinds"), kind, () => ask({ do: "experiment", kind }));
  for (const policy of rig.policies) button(element("policies"), policy, () => ask({ do: "policy", policy }));
  for (const name of Object.keys(rig.faults)) {
    const made = button(element("faults"), name, () => ask({ do: "fault", name, on: made.ariaPressed !== "true" }));
    made.ariaPressed = "false";
  }
  sliders.length = 0;
  for (const output of rig.outputs.filter((o) => o.tracked)) {
    const row = element("setpoints").appendChild(document.createElement("div"));
    row.className = "setpoint";
    row.appendChild(document.createElement("span")).textContent = output.name.replaceAll("_", " ");
    const shown = row.appendChild(document.createElement("output"));
    const slider = row.appendChild(document.createElement("input"));
    Object.assign(slider, { type: "range", min: output.low, max: output.high, step: "any", value: 0 });
    slider.setAttribute("aria-label", output.name);
    sliders.push({ output, slider, shown, held: 0 });
    slider.addEventListener("input", () => slide(sliders.find((item) => item.slider === slider)));
  }
}

let slid = 0, sliding = null;

// At most one set-point in SLIDES, the last one for certain.
function slide(item) {
  item.held = performance.now();
  tellSlider(item);
  if (sliding) return;
  const wait = Math.max(0, slid + SLIDES - performance.now());
  sliding = setTimeout(() => {
    sliding = null;
    slid = performance.now();
    const present = presentReference();
    const values = sliders.map(({ slider, held }, k) => (performance.now() - held < 1000 ? Number(slider.value) : present[k]));
    ask({ do: "set_point", times: [0], values: [values] });
  }, wait);
}

const tellSlider = ({ output, slider, shown }) => (shown.textContent = `${fixed(Number(slider.value), 2)} ${output.unit}`);

function badge(words, level) {
  element("health").textContent = words;
  element("health").className = `badge ${level}`;
}

// The quick part of a picture; words change less often.
function picture(time) {
  if (!rig) return;
  const measured = tables.measured;
  if (!clock.frozen && measured.count) clock.now = measured.last(0);
  const positions = Object.fromEntries(rig.joints.map((name, k) => [name, tables.estimate.last(1 + rig.outputs.length + rig.inputs.length + k)]));
  drawing.move(positions);
  for (const chart of charts) chart.show();
  pictures.push(time);
  while (pictures[0] < time - 2000) pictures.shift();
  if (!words.told || time - words.told > 250) words(time, positions);
  connection.wantNext();
}

function words(time, positions) {
  words.told = time;
  const times = tables.measured.since(clock.now - 1)[0];
  element("time").textContent = clock.now.toFixed(1);
  element("rate").textContent = times.length > 2 ? ((times.length - 1) / (times.at(-1) - times[0])).toFixed(0) : "–";
  element("fps").textContent = pictures.length > 2 ? ((1e3 * (pictures.length - 1)) / (pictures.at(-1) - pictures[0])).toFixed(0) : "–";
  for (const chart of charts) chart.tell(chart.noting?.());
  element("joints").replaceChildren(...rig.joints.map((name) => {
    const part = document.createElement("span"), value = document.createElement("b");
    value.textContent = placed(positions[name], rig.drawing.find((body) => body.joint === name).slides);
    part.append(`${name} `, value);
    return part;
  }));
  const present = presentReference();
  sliders.forEach((item, k) => {
    if (performance.now() - item.held < 1000 || document.activeElement === item.slider && item.slider.matches(":active")) return;
    item.slider.value = present[k];
    tellSlider(item);
  });
  tellStatuses();
}

// Where a joint is: metres, or degrees within a turn.
function placed(value, slides) {
  if (!Number.isFinite(value)) return "–";
  const degrees = (value * 180) / Math.PI;
  return slides ? `${value.toFixed(3)} m` : `${(degrees - 360 * Math.round(degrees / 360)).toFixed(1)}°`;
}

function rowOf({ name, level, words }) {
  const row = document.createElement("tr");
  row.className = level;
  const cell = row.insertCell();
  cell.textContent = name;
  if (words !== "running") cell.appendChild(document.createElement("small")).textContent = words;
  row.insertCell().textContent = level.toUpperCase();
  return row;
}

function tellStatuses() {
  const rows = [...statuses].map(([name, status]) => {
    const silent = performance.now() - status.heard > SILENT;
    return { name, level: silent ? "stale" : LEVELS[status.level] ?? "error", words: silent ? "silent" : status.line };
  });
  rows.sort((one, other) => WORST.indexOf(one.level) - WORST.indexOf(other.level) || (one.name < other.name ? -1 : 1));
  element("diagnostics").querySelector("tbody").replaceChildren(...rows.map(rowOf));
  const worst = WORST.find((level) => level !== "ok" && rows.some((item) => item.level === level));
  if (!rows.length) badge("waiting for the rig", "");
  else badge(worst ? `${rows.filter((item) => item.level === worst).length} ${worst.toUpperCase()}` : "running", worst ?? "ok");
  const values = (name) => statuses.get(name)?.values ?? {};
  mark("kinds", values("reference: reference").kind);
  element("setpoints").classList.toggle("followed", values("reference: reference").kind === "set_point");
  mark("policies", values("controller: loop").policy);
  const plant = values("plant: loop");
  for (const one of element("faults").children) {
    const wanted = rig.faults[one.dataset.name];
    one.ariaPressed = String(Object.entries(wanted).every(([key, value]) => same(plant[key], value)));
    one.disabled = !statuses.has("plant: loop");
  }
}

function same(text, value) {
  try {
    return JSON.stringify(JSON.parse(text)) === JSON.stringify(value);
  } catch {
    return false;
  }
}

function mark(id, name) {
  for (const one of element(id).children) one.ariaPressed = String(one.dataset.name === name);
}

function paint(theme) {
  document.documentElement.dataset.theme = theme;
  forgetColours();
  for (const chart of charts) chart.build();
}

const dark = matchMedia("(prefers-color-scheme: dark)");
paint(dark.matches ? "dark" : "light");
dark.addEventListener("change", () => paint(dark.matches ? "dark" : "light"));
element("theme").addEventListener("click", () => paint(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
for (const one of document.querySelectorAll(".call")) one.addEventListener("click", () => ask({ do: "call", service: one.dataset.service }));
const connection = new Connection({ hear, take, lost });

// The charts of a rig: each output with its error, each input, the delay, and the layers of safety.

import { Chart, colour, fixed } from "./charts.js";
import { AHEAD, clock, element, model, words } from "./model.js";

const LAYERS = { policy: "predicted", exact: "estimate", feedback: "measured", shifted_plan: "warn", held: "warn", zeroed: "error", stopped: "error" };
const OTHER = "stale"; // colour of other layers

const titled = ({ name, unit }, what = "") => `${words(name)}${what} [${unit || "1"}]`;

// A column of a table, as far as it is shown.
const part = (name, column) => () => {
  const found = model.tables[name].since(clock.window()[0]);
  return [found[0], found[column]];
};

// A column of the newest of what replaces one another, unless it is old.
const newest = (name, column) => () => {
  const found = model.latest[name];
  return found && found[0].at(-1) > clock.now - 0.5 ? [found[0], found[column]] : [[], []];
};

// ask: for something; isAsked: whether the set-point of a tracked output is being set elsewhere.
export function buildCharts(ask, isAsked) {
  const { rig } = model, place = element("charts"), charts = [], outputs = rig.outputs.length;
  place.replaceChildren();
  let tracked = 0;
  rig.outputs.forEach((output, k) => {
    const lines = [
      { name: "measured", tone: "measured", data: part("measured", 1 + k), width: 1.2 },
      { name: "estimate", tone: "estimate", data: part("estimate", 1 + k), width: 1.8 },
    ];
    if (!output.tracked) return charts.push(new Chart(place, { title: titled(output), kind: "output", lines, clock }));
    const index = tracked++;
    lines.push({ name: "predicted", tone: "predicted", ahead: true, dash: [5, 3], width: 2, data: newest("prediction", 1 + k) });
    lines.push({ name: "reference", tone: "reference", ahead: true, width: 1.8, data: () => model.reference(index) });
    const chart = new Chart(place, { title: titled(output), kind: "output", lines, clock, least: 0.1 * (output.high - output.low) });
    drawable(chart, output, index, ask, isAsked);
    charts.push(chart, errorChart(place, output, k, index));
  });
  rig.inputs.forEach((input, k) => {
    const lines = [
      { name: "applied", tone: "measured", data: part("measured", 1 + outputs + k), width: 1.2 },
      { name: "command", tone: "estimate", data: part("command", 1 + k), step: true, width: 1.6 },
      { name: "planned", tone: "predicted", ahead: true, dash: [5, 3], step: true, width: 2, data: newest("prediction", 1 + outputs + k) },
    ];
    charts.push(new Chart(place, { title: titled(input), kind: "input", lines, levels: [input.low, input.high], clock, least: 0.1 * (input.high - input.low) }));
  });
  charts.push(delayChart(place), layersChart(place));
  return charts;
}

function errorChart(place, output, k, index) {
  const line = { tone: "reference", data: () => model.error(k, index), width: 1.4 };
  const chart = new Chart(place, { title: titled(output, " error"), kind: "error", lines: [line], levels: [0], clock, least: 0.02 * (output.high - output.low) });
  chart.note.style.setProperty("--tone", "var(--reference)");
  chart.noting = () => {
    const found = Array.from(line.data()[1]).filter(Number.isFinite);
    const rms = Math.sqrt(found.reduce((sum, value) => sum + value * value, 0) / found.length);
    return found.length ? `estimate − reference ${fixed(found.at(-1), 2)}, rms ${fixed(rms, 2)}` : "no reference";
  };
  return chart;
}

function delayChart(place) {
  const { rig } = model, column = 1 + rig.inputs.length;
  const chart = new Chart(place, {
    title: "delay [ms], from measurement to command", kind: "small", clock, zero: true, least: 1.2e3 * rig.period, levels: [1e3 * rig.period], marks: [0, 1e3 * rig.period],
    lines: [{ tone: "estimate", data: part("command", column), width: 1.2 }],
  });
  chart.noting = () => {
    const found = Array.from(model.tables.command.since(clock.window()[0])[column]).filter(Number.isFinite).sort((a, b) => a - b);
    const percentile = (p) => (found.length ? found[Math.min(found.length - 1, Math.floor(p * found.length))].toFixed(2) : "–");
    return `median ${percentile(0.5)}, 99 % ${percentile(0.99)}`;
  };
  return chart;
}

function layersChart(place) {
  const chart = new Chart(place, { title: "layers of safety [% of the answers]", kind: "small", last: true, marks: [0, 100], clock, zero: true, lines: [] });
  chart.limits = () => [0, 100];
  chart.overlay = (context, x, y) => {
    model.shares.forEach(({ begin, end, parts }) => {
      let from = 0;
      parts.forEach(([name, share]) => {
        if (!share) return;
        context.fillStyle = colour(LAYERS[name] ?? OTHER);
        context.fillRect(x(begin), y(100 * (from + share)), x(end) - x(begin) + 1, y(100 * from) - y(100 * (from + share)));
        from += share;
      });
    });
  };
  chart.noting = () => {
    const parts = (model.shares.at(-1)?.parts ?? []).filter(([, share]) => share > 0).sort(([, one], [, other]) => other - one);
    chart.note.style.setProperty("--tone", `var(--${parts.length ? LAYERS[parts[0][0]] ?? OTHER : "soft"})`);
    return parts.map(([name, share]) => `${words(name)} ${(100 * share).toFixed(0)} %`).join(", ") || "no answers";
  };
  return chart;
}

// A curve that is drawn right of now, with a mouse, a pen or a finger; it begins when it is let go. Meanwhile the chart
// shows the rig's whole range, and where a set-point may be.
function drawable(chart, output, index, ask, isAsked) {
  const pad = chart.lay("pad"), [least, most] = output.travel ?? [output.low, output.high];
  let curve = null, hovers = false;
  chart.full = () => (hovers || curve || isAsked(index) ? [Math.min(least, output.low), Math.max(most, output.high)] : null);
  const point = (event) => {
    const box = pad.getBoundingClientRect(), [low, high] = chart.limits();
    const time = ((event.clientX - box.left) / box.width) * AHEAD;
    const value = high - ((event.clientY - box.top) / box.height) * (high - low);
    return [Math.min(Math.max(time, 0), model.rig.curve), Math.min(Math.max(value, output.low), output.high)];
  };
  pad.addEventListener("pointerenter", (event) => (hovers = event.pointerType !== "touch"));
  pad.addEventListener("pointerleave", () => (hovers = false));
  pad.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    pad.setPointerCapture(event.pointerId);
    clock.frozen = hovers = true;
    curve = [point(event)];
  });
  pad.addEventListener("pointermove", (event) => {
    if (!curve) return;
    const [time, value] = point(event);
    while (curve.length && curve.at(-1)[0] > time - 1e-3) curve.pop();
    curve.push([time, value]);
  });
  const end = (event) => {
    if (!curve) return;
    const drawn = curve;
    curve = null;
    clock.frozen = false;
    hovers = hovers && event.pointerType !== "touch";
    if (event.type === "pointerup") followCurve(drawn, index, ask);
  };
  pad.addEventListener("pointerup", end);
  pad.addEventListener("pointercancel", end);
  addEventListener("keydown", (event) => event.key === "Escape" && end(event));
  chart.overlay = (context, x, y, ratio) => {
    pad.classList.toggle("ranged", Boolean(chart.full()));
    pad.hidden = !model.there.set_points || output.low === output.high;
    if (!pad.hidden) paintZone(chart, output, context, x, y, ratio);
    if (!curve) return;
    context.beginPath();
    for (const [time, value] of curve) context.lineTo(x(clock.now + time), y(value));
    context.strokeStyle = colour("reference");
    context.lineWidth = 3 * ratio;
    context.setLineDash([]);
    context.stroke();
  };
}

// Where a set-point may be: tinted, between two lines with their values while one is being set.
function paintZone(chart, output, context, x, y, ratio) {
  const begin = x(clock.now), width = x(clock.now + AHEAD) - begin;
  context.fillStyle = colour("reference");
  context.globalAlpha = 0.06;
  context.fillRect(begin, y(output.high), width, y(output.low) - y(output.high));
  context.globalAlpha = 1;
  if (!chart.full()) return;
  context.fillStyle = context.strokeStyle = colour("asked");
  context.font = `${11 * ratio}px system-ui`;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.lineWidth = 1.5 * ratio;
  context.setLineDash([6 * ratio, 4 * ratio]);
  for (const [value, name, below] of [[output.high, "highest", 13], [output.low, "lowest", -4]]) {
    context.beginPath();
    context.moveTo(x(clock.now - clock.back), y(value));
    context.lineTo(begin + width, y(value));
    context.stroke();
    context.fillText(`${name} set-point ${fixed(value, 2)} ${output.unit}`, x(clock.now - clock.back) + 6 * ratio, y(value) + below * ratio);
  }
}

function followCurve(curve, index, ask) {
  const present = model.presentReference();
  const step = Math.ceil(curve.length / (model.rig.points - 2));
  const points = curve.filter((_, k) => k % step === 0 || k === curve.length - 1);
  if (points[0][0] > 2e-3) points.unshift([0, present[index]], [points[0][0] - 1e-3, present[index]]);
  const times = points.map(([time]) => time);
  ask({ do: "set_point", times, values: points.map(([, value]) => present.map((other, k) => (k === index ? value : other))) });
}


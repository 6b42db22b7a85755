// What the page knows of the rig: what was received, and what time it is.

import { Rows, at } from "./charts.js";

export const element = (id) => document.getElementById(id);
export const words = (name) => name.replaceAll("_", " ");
export const AHEAD = 3; // s, shown right of now, where curves are drawn
export const BACK = [4, 8, 16]; // s, shown left of now
const SILENT = 2000; // ms without diagnostics of a node

// Time: the window of the charts ends AHEAD behind the newest measurement. While a curve is drawn it stands still.
export const clock = {
  now: 0,
  back: BACK[1],
  frozen: false,
  window() {
    return [this.now - this.back, this.now + AHEAD];
  },
  ticks() {
    const [begin, end] = this.window(), step = end - begin > 12 ? 4 : end - begin > 8 ? 2 : 1, found = [];
    for (let t = this.now - step * Math.floor((this.now - begin) / step); t <= end; t += step) found.push(t);
    return found;
  },
};

export const model = {
  rig: null,
  tables: {}, // the last rows of what grows
  latest: {}, // the newest of what replaces one another, column by column
  statuses: new Map(), // of the diagnostics, by node and task
  controller: null, // state and reason
  there: { services: [], nodes: [], set_points: false },
  weights: {},
  recording: null,
  shares: [], // of the layers of safety, between two diagnostics
  counted: null,
  countedAt: 0,
  epoch: -1,

  greet(rig) {
    const capacity = Math.ceil((Math.max(rig.seconds, 20) * 1.2) / rig.period);
    const outputs = rig.outputs.length, inputs = rig.inputs.length;
    this.rig = rig;
    this.tables = {
      measured: new Rows(1 + outputs + inputs, capacity),
      estimate: new Rows(1 + outputs + inputs + rig.joints.length, capacity),
      command: new Rows(1 + inputs + 1, capacity),
      asked: new Rows(1 + this.tracked().length, capacity),
    };
    this.statuses = new Map();
    this.controller = this.recording = null;
    this.there = { services: [], nodes: [], set_points: false };
    this.weights = {};
    this.begin(-1);
  },

  begin(epoch) {
    this.epoch = epoch;
    for (const table of Object.values(this.tables)) table.clear();
    this.latest = {};
    this.shares = [];
    this.counted = null;
    clock.now = 0;
  },

  // A frame: the length of its head, the head as JSON, and the numbers that it names.
  take(buffer) {
    const length = new DataView(buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    let place = 4 + length;
    const numbers = (rows, columns) => {
      const found = new Float64Array(buffer, place, rows * columns);
      place += found.byteLength;
      return found;
    };
    if (head.epoch !== this.epoch) this.begin(head.epoch);
    for (const [name, rows, columns] of head.tables) this.tables[name].append(numbers(rows, columns), rows);
    for (const [name, rows, columns] of head.latest) this.latest[name] = columnsOf(numbers(rows, columns), rows, columns);
    for (const [name, value] of Object.entries(head.news)) {
      if (name.startsWith("status ")) this.learn(value);
      else this[name] = value;
    }
  },

  learn(status) {
    status.heard = performance.now();
    this.statuses.set(`${status.node}: ${status.task}`, status);
    if (status.node === "controller" && status.task === "loop") this.countLayers(status.values);
  },

  countLayers(values) {
    const keys = Object.keys(values).filter((key) => key.startsWith("layer_") && key !== "layer_no_reference");
    const found = Object.fromEntries(keys.map((key) => [key.slice(6), Number(values[key])]));
    if (this.counted) {
      const grown = Object.entries(found).map(([name, count]) => [name, Math.max(count - (this.counted[name] ?? 0), 0)]);
      const total = grown.reduce((sum, [, count]) => sum + count, 0);
      if (total) this.shares.push({ begin: this.countedAt, end: clock.now, parts: grown.map(([name, count]) => [name, count / total]) });
      if (this.shares.length > 200) this.shares.shift();
    }
    this.counted = found;
    this.countedAt = clock.now;
  },

  tracked() {
    return this.rig.outputs.filter((output) => output.tracked);
  },

  values(name) {
    return this.statuses.get(name)?.values ?? {};
  },

  isSilent(status) {
    return performance.now() - status.heard > SILENT;
  },

  // What an output was asked for, and will be: what is past of the previews, and the newest one.
  reference(index) {
    const past = this.tables.asked.since(clock.window()[0]), ahead = this.latest.reference;
    return ahead ? [joined(past[0], ahead[0]), joined(past[1 + index], ahead[1 + index])] : [[], []];
  },

  // How far the estimate of an output, by its place among all and among the tracked ones, is above its reference.
  error(output, index) {
    const estimate = this.tables.estimate.since(clock.window()[0]), [times, values] = this.reference(index);
    const found = new Float64Array(estimate[0].length).fill(NaN);
    for (let k = 0, i = 0; k < found.length; k++) {
      const time = estimate[0][k];
      while (i + 1 < times.length && times[i + 1] <= time) i += 1;
      if (i + 1 >= times.length || times[i] > time) continue;
      const share = (time - times[i]) / (times[i + 1] - times[i]);
      found[k] = estimate[1 + output][k] - (values[i] + share * (values[i + 1] - values[i]));
    }
    return [estimate[0], found];
  },

  // The reference of now, within what may be asked for.
  presentReference() {
    return this.tracked().map((output, k) => {
      const value = at(...this.reference(k), clock.now);
      return Math.min(Math.max(Number.isFinite(value) ? value : 0, output.low), output.high);
    });
  },
};

function columnsOf(numbers, rows, columns) {
  const found = Array.from({ length: columns }, () => new Float64Array(rows));
  for (let k = 0; k < rows * columns; k++) found[k % columns][Math.floor(k / columns)] = numbers[k];
  return found;
}

function joined(one, other) {
  const both = new Float64Array(one.length + other.length);
  both.set(one);
  both.set(other, one.length);
  return both;
}

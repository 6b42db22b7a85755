// The page: takes frames, draws them, and asks for what its user wants. It asks for a frame when it has drawn the one
// before, so that a slow or hidden page costs nothing. The server checks all it says.

import { forgetColours } from "./charts.js";
import { Connection } from "./connection.js";
import { buildControls, isSetting, tellControls } from "./controls.js";
import { Drawing } from "./drawing.js";
import { AHEAD, BACK, clock, element, model } from "./model.js";
import { buildOperation, tellLost, tellOperation } from "./operation.js";
import { buildCharts } from "./rigcharts.js";

const WORDS = 250; // ms, between two changes of what is read
const LEVELS = ["ok", "warn", "error", "stale"];
const WORST = ["error", "stale", "warn", "ok"];
const LOST = "the connection is lost: trying again";

let charts = [], drawing = null, told = 0;
const pictures = [];

function say(line, tone = "") {
  element("line").textContent = line;
  element("line").className = tone;
}

function ask(request) {
  if (!connection.ask(request)) say(request.service === "stop" ? "no connection: Stop does not reach the rig" : "no connection", "bad");
}

function lost(reason, isUnknown) {
  tellLost(true);
  if (model.rig) tellControls(false);
  element("address").hidden = !isUnknown;
  say(reason || LOST, "bad");
}

function hear(message) {
  if (message.rig) return greet(message);
  say(message.line, message.done ? "good" : "bad");
}

function greet(rig) {
  const before = model.rig?.rig;
  model.greet(rig);
  element("rig").textContent = rig.rig;
  element("address").hidden = true;
  document.querySelector("main").hidden = false;
  drawing = new Drawing(element("drawing"), rig.drawing, rig.extent);
  charts = buildCharts(ask, isSetting);
  buildControls(ask);
  tellLost(false);
  say(before && before !== rig.rig ? `this is another rig now: ${rig.rig}` : "");
  connection.wantNext();
}

function take(buffer) {
  model.take(buffer);
  requestAnimationFrame(picture);
}

// The quick part of a picture; words change less often.
function picture(time) {
  const { measured, estimate } = model.tables, { rig } = model;
  if (!clock.frozen && measured.count) clock.now = measured.last(0);
  const positions = Object.fromEntries(rig.joints.map((name, k) => [name, estimate.last(1 + rig.outputs.length + rig.inputs.length + k)]));
  drawing.move(positions);
  for (const chart of charts) chart.show();
  pictures.push(time);
  while (pictures[0] < time - 2000) pictures.shift();
  if (time - told > WORDS) tell(time, positions);
  connection.wantNext();
}

function tell(time, positions) {
  told = time;
  const { rig } = model, times = model.tables.measured.since(clock.now - 1)[0];
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
  tellStatuses();
  tellOperation();
  tellControls(true);
}

// Where a joint is: metres, or degrees within a turn.
function placed(value, slides) {
  if (!Number.isFinite(value)) return "–";
  const degrees = (value * 180) / Math.PI;
  return slides ? `${value.toFixed(3)} m` : `${(degrees - 360 * Math.round(degrees / 360)).toFixed(1)}°`;
}

function rowOf({ name, level, words }) {
  const row = document.createElement("tr"), head = document.createElement("th");
  row.className = level;
  head.scope = "row";
  head.textContent = name;
  if (words !== "running") head.appendChild(document.createElement("small")).textContent = words;
  row.append(head);
  row.insertCell().textContent = level.toUpperCase();
  return row;
}

function tellStatuses() {
  const ended = model.recording?.on ? "" : model.recording?.node; // a recorder is silent when its bag has ended
  const rows = [...model.statuses].filter(([, { node }]) => node !== ended).map(([name, status]) => {
    const silent = model.isSilent(status);
    return { name, level: silent ? "stale" : LEVELS[status.level] ?? "error", words: silent ? "silent" : status.line };
  });
  rows.sort((one, other) => WORST.indexOf(one.level) - WORST.indexOf(other.level) || (one.name < other.name ? -1 : 1));
  element("diagnostics").querySelector("tbody").replaceChildren(...rows.map(rowOf));
  const worst = WORST.find((level) => level !== "ok" && rows.some((item) => item.level === level));
  element("health").textContent = worst ? `${rows.filter((item) => item.level === worst).length} ${worst.toUpperCase()}` : "";
  element("health").className = `badge ${worst ?? ""}`;
}

function paint(theme) {
  document.documentElement.dataset.theme = theme;
  forgetColours();
  for (const chart of charts) chart.build();
}

function look(seconds) {
  clock.back = seconds;
  document.documentElement.style.setProperty("--ahead", `${(100 * AHEAD) / (AHEAD + seconds)}%`);
  for (const one of element("back").children) one.ariaPressed = String(one.dataset.seconds === String(seconds));
}

for (const seconds of BACK) {
  const made = element("back").appendChild(document.createElement("button"));
  made.dataset.seconds = seconds;
  made.textContent = `${seconds} s`;
  made.addEventListener("click", () => look(seconds));
}
look(clock.back);
const dark = matchMedia("(prefers-color-scheme: dark)");
paint(dark.matches ? "dark" : "light");
dark.addEventListener("change", () => paint(dark.matches ? "dark" : "light"));
matchMedia("(max-width: 1199px)").addEventListener("change", () => charts.forEach((chart) => chart.build()));
element("theme").addEventListener("click", () => paint(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
element("record").addEventListener("click", () => ask({ do: "record", on: element("record").ariaPressed !== "true" }));
element("address").addEventListener("submit", (event) => {
  event.preventDefault();
  connection.setAddress(element("address-text").value);
});
buildOperation(ask);
const connection = new Connection({ hear, take, lost });

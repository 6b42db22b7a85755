// What a page sets: set-points, references, policies, weights, faults, and whether a bag is written.

import { fixed } from "./charts.js";
import { element, model, words } from "./model.js";

const SLIDES = 33; // ms, between two set-points of a slider
const KEPT = 1000; // ms for which a slider stays where its user has put it
const setters = []; // of set-points: one for each tracked output
let slid = 0, sliding = null;

function made(parent, kind, attributes = {}, text = "") {
  const found = parent.appendChild(document.createElement(kind));
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  found.textContent = text;
  return found;
}

function button(id, name, action) {
  const found = made(element(id), "button", { "data-name": name, "aria-pressed": "false" }, words(name));
  found.addEventListener("click", () => action(found));
  return found;
}

export function buildControls(ask) {
  const { rig } = model;
  for (const id of ["kinds", "policies", "faults", "setpoints", "weight-fields"]) element(id).replaceChildren();
  for (const kind of rig.kinds) button("kinds", kind, () => ask({ do: "experiment", kind }));
  for (const policy of rig.policies) button("policies", policy, () => ask({ do: "policy", policy }));
  for (const name of Object.keys(rig.faults)) button("faults", name, ({ ariaPressed }) => ask({ do: "fault", name, on: ariaPressed !== "true" }));
  setters.length = 0;
  for (const output of model.tracked()) setters.push(setter(output, ask));
  for (const weight of rig.weights) weight.of.forEach((name, k) => weightField(weight, name, k, ask));
}

function setter(output, ask) {
  const id = `setpoint-${output.name}`, row = made(element("setpoints"), "div", { class: "setpoint" });
  row.hidden = output.low === output.high; // it is weighed, but stays where it is
  made(row, "label", { for: id }, words(output.name));
  const range = { min: output.low, max: output.high, step: "any" };
  const field = made(row, "input", { ...range, id, type: "number" });
  made(row, "span", { class: "quantity" }, output.unit);
  const slider = made(row, "input", { ...range, type: "range", "aria-label": `set-point of ${words(output.name)}` });
  const ends = made(row, "small");
  for (const end of [output.low, output.high]) made(ends, "span", {}, `${fixed(end, 2)} ${output.unit}`);
  const found = { output, slider, field, held: -KEPT };
  slider.addEventListener("input", () => {
    field.value = fixed(Number(slider.value), 2);
    slide(found, ask);
  });
  field.addEventListener("change", () => {
    if (!field.value || !Number.isFinite(Number(field.value))) return;
    slider.value = field.value; // within its ends
    field.value = fixed(Number(slider.value), 2);
    slide(found, ask);
  });
  return found;
}

const isHeld = ({ held }) => performance.now() - held < KEPT;

// Whether the set-point of a tracked output is being set here.
export const isSetting = (index) => isHeld(setters[index]) || setters[index].slider.matches(":active");

// At most one set-point in SLIDES, the last one for certain.
function slide(item, ask) {
  item.held = performance.now();
  if (sliding) return;
  sliding = setTimeout(() => {
    sliding = null;
    slid = performance.now();
    const present = model.presentReference();
    ask({ do: "set_point", times: [0], values: [setters.map((one, k) => (isHeld(one) ? Number(one.slider.value) : present[k]))] });
  }, Math.max(0, slid + SLIDES - performance.now()));
}

function weightField(weight, name, k, ask) {
  const id = `${weight.name}-${name}`, row = made(element("weight-fields"), "div", { class: "weight" });
  made(row, "label", { for: id }, `${words(weight.name)}: ${words(name)}`);
  const field = made(row, "input", { id, type: "number", min: weight.low, max: weight.high, step: "any", "data-weight": weight.name, "data-index": k });
  field.addEventListener("change", () => {
    const values = [...document.querySelectorAll(`[data-weight=${weight.name}]`)].map((one) => Number(one.value));
    ask({ do: "weight", name: weight.name, values });
  });
}

const press = (one, pressed) => one.ariaPressed !== String(pressed) && (one.ariaPressed = String(pressed));

function mark(id, name, there) {
  for (const one of element(id).children) {
    press(one, one.dataset.name === name);
    one.disabled = !there;
  }
}

// Show what is set, and switch off what nobody would do. isOpen: whether there is a connection.
export function tellControls(isOpen) {
  const { there, rig } = model, isThere = (node) => isOpen && there.nodes.includes(node);
  const { kind } = model.values("reference: reference"), { policy } = model.values("controller: loop");
  mark("kinds", kind, isThere("reference"));
  mark("policies", policy, isThere("controller"));
  const plant = model.values("plant: loop");
  for (const one of element("faults").children) {
    const wanted = rig.faults[one.dataset.name];
    press(one, Object.entries(wanted).every(([key, value]) => same(plant[key], value)));
    one.disabled = !isThere("plant");
  }
  element("setpoints").classList.toggle("followed", kind === "set_point");
  const present = model.presentReference();
  setters.forEach((item, k) => {
    const { slider, field } = item;
    slider.disabled = field.disabled = !isOpen || !there.set_points;
    if (isSetting(k)) return;
    slider.value = present[k];
    if (document.activeElement !== field) field.value = fixed(present[k], 2);
  });
  tellWeights(isThere("controller"), policy);
  tellRecording(isOpen);
}

function tellWeights(there, policy) {
  const free = policy === "exact";
  element("weight-hint").textContent = !there || free ? "" : "A network keeps the weights that it was trained with. They can be set while “exact” drives.";
  for (const field of document.querySelectorAll("[data-weight]")) {
    field.disabled = !there || !free;
    const value = model.weights[field.dataset.weight]?.[field.dataset.index];
    if (document.activeElement !== field && value !== undefined) field.value = value;
  }
}

function tellRecording(isOpen) {
  const { on = false, seconds = 0, bag = "", trouble = "" } = model.recording ?? {};
  press(element("record"), on);
  element("record").disabled = !isOpen || !model.recording;
  element("recording").textContent = trouble || (on ? `${seconds} s in ${bag}` : bag && `ended: ${bag}`);
}

function same(text, value) {
  try {
    return JSON.stringify(JSON.parse(text)) === JSON.stringify(value);
  } catch {
    return false;
  }
}

// The page: controls, charts and numbers of a rig that steps as time goes by.

const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const MOST = 0.1; // s that are caught up at once
const PUSHED = 0.3; // s
const words = (name) => name.replaceAll("_", " ");
const number = (value) => (Number.isFinite(value) ? (Math.abs(value) < 5e-5 ? "0.0000" : Math.abs(value) < 1 ? value.toFixed(4) : value.toPrecision(5)) : "not finite");

const normal = () => Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random()); // Box, Muller

function labelled(parent, kind, attributes, text) {
  const label = parent.appendChild(document.createElement("label"));
  const input = document.createElement("input");
  Object.assign(input, { type: kind, ...attributes });
  if (kind === "radio") label.append(input, text);
  else label.append(text, " ", document.createElement("output"), input);
  return input;
}

async function begin() {
  const rig = await Rig.of(data);
  const drawing = data.drawing && new Drawing(element("drawing"), data.drawing.bodies, data.drawing.extent);
  if (!drawing) element("drawing").remove();
  const { outputs, inputs, states } = data;
  const reference = new Float64Array(outputs.length);
  const bias = new Float64Array(inputs.length);
  const noise = new Float64Array(outputs.length);
  const turned = {}; // positions of joints that have a velocity alone
  let [running, pushed, cost, last, left] = [true, 0, 0, 0, 0];

  outputs.forEach((output, k) => {
    if (!output.tracked) return;
    const ends = [output.low / output.scale, output.high / output.scale].sort((a, b) => a - b);
    const step = (ends[1] - ends[0]) / 200; // from 0 on, which a slider's steps from its end may miss
    const slider = labelled(element("references"), "range", {
      min: Math.ceil(ends[0] / step) * step, max: Math.floor(ends[1] / step) * step, step, value: 0, id: `reference-${output.name}`,
    }, words(output.name));
    const show = () => {
      reference[k] = slider.valueAsNumber * output.scale;
      slider.previousSibling.textContent = `${number(slider.valueAsNumber)} ${output.unit}`;
      slider.setAttribute("aria-valuetext", slider.previousSibling.textContent);
    };
    slider.addEventListener("input", show);
    show();
  });
  const drivers = Object.keys(data.drivers);
  for (const name of drivers) {
    const text = name === "exact" ? "exact MPC" : "policy, supervised";
    const radio = labelled(element("drivers"), "radio", { name: "driver", value: name, checked: name === rig.name }, text);
    radio.addEventListener("change", () => rig.choose(name));
  }
  element("chooser").hidden = drivers.length < 2;
  const load = element("load");
  load.addEventListener("input", () => {
    element("load-value").textContent = `${load.value} %`;
    load.setAttribute("aria-valuetext", `${load.value} %`);
  });

  const charts = outputs.map((output, k) => ({
    values: () => [rig.measured[k] / output.scale, ...(output.tracked ? [reference[k] / output.scale] : [])],
    chart: new Chart(element("charts"), {
      title: `${words(output.name)} [${output.unit}]`,
      lines: [{ name: "output", tone: "output" }, ...(output.tracked ? [{ name: "reference", tone: "reference", dashed: true }] : [])],
      levels: [], least: 0.02 * Math.abs((output.high - output.low) / output.scale) || 1e-6,
    }),
  }));
  inputs.forEach((input, j) => charts.push({
    values: () => [rig.applied[j]],
    chart: new Chart(element("charts"), {
      title: `${words(input.name)} [${input.unit}]`,
      lines: [{ name: "command", tone: "input" }, { name: "its bounds", tone: "bound", dashed: true }].slice(0, 2),
      levels: [input.low, input.high], least: 1e-6,
    }),
  }));

  const cells = [];
  const row = (name, value) => {
    const line = element("numbers").tBodies[0].insertRow();
    const head = line.appendChild(document.createElement("th"));
    head.scope = "row";
    head.textContent = name;
    cells.push([line.insertCell(), value]);
  };
  row("time", () => `${rig.time.toFixed(1)} s`);
  states.forEach((state, i) => row(words(state.name), () => `${number(rig.plant.state[i])} ${state.unit}`));
  states.forEach((state, i) => {
    if (i < data.sizes.estimated) row(`${words(state.name)}, estimated`, () => `${number(rig.driver.state[i])} ${state.unit}`);
  });
  inputs.forEach((input, j) => {
    row(`disturbance of ${words(input.name)}`, () => `${number(bias[j])} ${input.unit}`);
    row("the same, estimated", () => `${number(rig.driver.disturbance[j])} ${input.unit}`);
  });
  row("command is", () => words(data.statuses[rig.status]));
  row("a period takes", () => `${cost.toFixed(3)} ms of ${(1000 * data.period).toFixed(0)}`);

  const push = () => { pushed = PUSHED; };
  const pause = () => {
    running = !running;
    element("pause").setAttribute("aria-pressed", String(!running));
  };
  const again = () => {
    rig.begin(rig.name);
    for (const key of Object.keys(turned)) delete turned[key];
    charts.forEach(({ chart }) => chart.clear());
  };
  element("push").addEventListener("click", push);
  element("pause").addEventListener("click", pause);
  element("again").addEventListener("click", again);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest("button, input[type=radio]")) return;
    if (event.key === "p" || event.key === "P") push();
    else if (event.key === " ") { event.preventDefault(); pause(); }
  });

  const positions = () => Object.fromEntries(Object.entries(data.joints).map(([name, joint]) => {
    const at = states.findIndex((state) => state.name === joint.position);
    return [name, at >= 0 ? rig.plant.state[at] : turned[name] || 0];
  }));
  const turn = (seconds) => {
    for (const [name, joint] of Object.entries(data.joints)) {
      const at = states.findIndex((state) => state.name === joint.velocity);
      if (at >= 0) turned[name] = (turned[name] || 0) + seconds * rig.plant.state[at];
    }
  };
  const show = () => {
    if (drawing) drawing.move(positions());
    charts.forEach(({ chart }) => chart.draw(rig.time));
    for (const [cell, value] of cells) cell.textContent = value();
  };
  const frame = (now) => {
    left += running && last ? Math.min((now - last) / 1000, MOST) : 0;
    last = now;
    let periods = 0;
    const started = performance.now();
    for (; left >= data.period; left -= data.period) {
      inputs.forEach((input, j) => {
        bias[j] = (load.valueAsNumber / 100) * (input.high - input.low) + (pushed > 0 ? data.push[j] : 0);
      });
      pushed -= data.period;
      outputs.forEach((output, k) => { noise[k] = output.noise * normal(); });
      rig.period(reference, bias, noise);
      turn(data.period);
      charts.forEach(({ chart, values }) => chart.append(rig.time, values()));
      periods += 1;
    }
    if (periods) cost = 0.9 * cost + (0.1 * (performance.now() - started)) / periods;
    show();
    requestAnimationFrame(frame);
  };
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) pause();
  Object.assign(window, { rig, show }); // for whoever looks at it from the console
  requestAnimationFrame(frame);
}

begin().catch((error) => {
  element("problem").hidden = false;
  element("problem").textContent = `The rig can't be simulated in this browser: ${error.message}.`;
});

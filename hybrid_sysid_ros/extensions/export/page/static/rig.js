// The simulated rig and its controllers as WebAssembly. Nothing here touches the page, so that it runs anywhere.

class Part {
  // sizes: of the numbers that both sides see, by name, in their order
  static async of(text, sizes) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const { instance } = await WebAssembly.instantiate(await new Response(stream).arrayBuffer(), {});
    const part = new Part();
    part.calls = instance.exports;
    if (part.calls._initialize) part.calls._initialize();
    let at = part.calls.shared();
    for (const [name, size] of Object.entries(sizes)) {
      part[name] = new Float64Array(part.calls.memory.buffer, at, size);
      at += 8 * size;
    }
    return part;
  }
}

class Rig {
  static async of(data) {
    const rig = new Rig();
    const { states, estimated, inputs, outputs, horizon } = data.sizes;
    rig.data = data;
    rig.plant = await Part.of(data.plant, { inputs, bias: inputs, state: states, outputs });
    rig.drivers = {};
    for (const [name, text] of Object.entries(data.drivers)) {
      rig.drivers[name] = await Part.of(text, {
        outputs, applied: inputs, preview: horizon * outputs, command: inputs, state: estimated, disturbance: inputs,
      });
    }
    rig.begin(Object.keys(rig.drivers)[0]);
    return rig;
  }

  begin(driver) {
    this.plant.calls.begin();
    this.steps = 0;
    this.choose(driver);
  }

  // Another controller takes over; it knows nothing of what was before.
  choose(driver) {
    this.name = driver;
    this.driver = this.drivers[driver];
    if (!this.driver.calls.begin()) throw new Error("the memory of the solver is too small");
    this.applied = Float64Array.from(this.plant.inputs);
    this.measured = Float64Array.from(this.plant.outputs);
    this.status = 0;
  }

  get time() {
    return this.steps * this.data.step;
  }

  // A period of the controller. reference: of the outputs, held over the horizon; bias: what acts beside the inputs;
  // noise: of the sensors. Without noise a sensor of a rig at rest would look frozen.
  period(reference, bias, noise) {
    const { plant, driver, data } = this;
    for (let k = 0; k < noise.length; k++) this.measured[k] = plant.outputs[k] + noise[k];
    driver.outputs.set(this.measured);
    driver.applied.set(this.applied);
    for (let k = 0; k < driver.preview.length; k++) driver.preview[k] = reference[k % reference.length];
    this.status = driver.calls.step(this.time);
    driver.calls.prepare(data.period);
    this.applied.set(driver.command);
    plant.inputs.set(driver.command);
    plant.bias.set(bias);
    plant.calls.step(data.steps);
    this.steps += data.steps;
  }
}

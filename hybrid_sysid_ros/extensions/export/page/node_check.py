"""Node: runs what a page runs, to compare it with Python."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

MAIN = """
const task = JSON.parse(require("fs").readFileSync("task.json"));
Rig.of(task.data).then((rig) => {
  rig.begin(task.driver);
  const found = task.references.map((reference, k) => {
    rig.period(reference, task.biases[k], task.noises[k]);
    return [...rig.applied, ...rig.plant.state, ...rig.driver.state];
  });
  process.stdout.write(JSON.stringify(found));
});
"""


def run(
    code: str, data: Mapping[str, Any], driver: str, references: Array, biases: Array, noises: Array
) -> Array | None:
    """Commands, states and estimates (periods, m + n + n) of a page's code; None without node."""
    node = shutil.which("node")
    if node is None:
        return None
    course = {"references": references, "biases": biases, "noises": noises}
    task = {"data": data, "driver": driver, **{name: rows.tolist() for name, rows in course.items()}}
    with TemporaryDirectory() as scratch:
        (Path(scratch) / "task.json").write_text(json.dumps(task), encoding="utf-8")
        (Path(scratch) / "page.js").write_text(code + MAIN, encoding="utf-8")
        done = compiler.run([node, "page.js"], folder=Path(scratch))
    if done.returncode or not done.stdout:
        last = (done.stderr.strip().splitlines() or ["it says nothing"])[-1]
        raise UserError(f"export: node can't run the page's code: {last}; report this")
    return np.array([[np.nan if item is None else item for item in row] for row in json.loads(done.stdout)])


def in_python(simulation: Simulation, loop: PythonLoop, references: Array, biases: Array, noises: Array) -> Array:
    """The same in Python."""
    plant = Plant(simulation.rig, seed=0, bias=simulation.bias, noisy=False, disturbed=False)
    period, horizon = loop.estimator.period, loop.mpc.horizon
    loop.command = np.array([actuator.rest for actuator in simulation.rig.actuators])
    loop.reset()
    applied, found = loop.command.copy(), []
    for reference, bias, noise in zip(references, biases, noises, strict=True):
        answer = loop.step(plant.time, plant.sensed() + noise, applied, np.tile(reference, (horizon, 1)))
        loop.prepare(period)
        plant.bias[:] = bias
        for _ in range(round(period / plant.step)):
            plant.advance(answer.inputs)
        applied = answer.inputs
        found.append(np.concatenate([applied, plant.state, answer.state]))
    return np.array(found)


def course(
    low: Sequence[float], high: Sequence[float], push: Array, noise: Sequence[float], periods: int, every: int
) -> tuple[Array, Array, Array]:
    """References (periods, p) that step within their ranges, pushes (periods, m) in a fifth of the time, and white
    noise (periods, p) of given deviations.
    """
    random = np.random.default_rng(0)
    levels = random.uniform(low, high, (periods // every + 1, len(low)))
    pushes = np.where(np.arange(periods)[:, None] % (5 * every) < every, push, 0.0)
    return np.repeat(levels, every, axis=0)[:periods], pushes, noise * random.normal(size=(periods, len(noise)))

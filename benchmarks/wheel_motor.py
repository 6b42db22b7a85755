"""The speed of a wheel on steps and sines, under the exact MPC, its policy and the supervised policy.

Judged by the true speed of the simulated rig, which has the dead zone, the delay and the encoder; nobody knows of a
step before it comes. Lockstep over three seeds of the sensor's noise, and once with plant, estimator and controller as
processes.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import picture, result, step_response
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import Controller, ExactMpc
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, simulate_loop
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import check_tolerances
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.arrays import Array

RIG, STEPS, SINES, PERIOD = "wheel_motor", "steps", "sines", 0.01
BAND = 0.02
SEEDS = (0, 1, 2)
PICTURE, SHOWN = Path(__file__).parents[1] / "docs" / "results" / "wheel_motor_steps.svg", (0.8, 10.0)
UNFORESEEN = {"reference": {"preview_seconds": 0.01, "publish_period": 0.005, "point_spacing": 0.005}}
"""Of the nodes, for the steps: no reference is known more than 10 ms ahead."""


def simulated(rig: Rig, model: Model, controller: Controller, reference: str, *, seed: int) -> ClosedLoop:
    """A loop in lockstep."""
    tuning = configuration.estimator_tuning(configuration.defaults(rig, "estimator"), rig, model.system)
    schedule, scales = rig.schedule(reference), np.array([display.scale for display in rig.display])
    wanted = step_response.unforeseen(schedule, scales, controller.period, lead=model.system.delay)
    controller.reset()
    return simulate_loop(
        Plant(rig, seed=seed, bias=rig.bias),
        ExtendedKalmanFilter(model.system, tuning, period=PERIOD, latency=0.0),
        controller,
        wanted if reference == STEPS else lambda times: np.asarray(scales * schedule(times)),
        inputs=len(rig.actuators),
        duration=schedule.duration,
        period=PERIOD,
        lead=model.system.delay,
    )


def judged(rig: Rig, reference: str, time: Array, speed: Array) -> Array:
    """Of each step its settling time [s], overshoot and steady error; of each sine its error's rms over its amplitude;
    speed [SI].
    """
    schedule, shown = rig.schedule(reference), speed / rig.display[0].scale
    if reference == STEPS:
        return step_response.settled(schedule, 0, time, shown, band=BAND)
    wanted, found = schedule(time)[:, 0], []
    for start, stop in schedule.windows.values():
        inside = (time >= start) & (time < stop)
        found.append(np.sqrt(np.mean((shown - wanted)[inside] ** 2)) / np.max(np.abs(wanted[inside])))
    return np.array(found)


def summary(steps: Sequence[Array], sines: Sequence[Array], names: Sequence[str]) -> dict[str, Any]:
    """Over seeds: (steps, 3) and (sines,) of each."""
    rows, shares = np.array(steps), np.array(sines)
    return {
        "settling_longest": result.spread(rows[:, :, 0].max(axis=1)),
        "overshoot_largest": result.spread(rows[:, :, 1].max(axis=1)),
        "steady_error_largest": result.spread(rows[:, :, 2].max(axis=1)),
        "sine_rmse": {name: result.spread(shares[:, k]) for k, name in enumerate(names)},
    }


def lockstep(rig: Rig, model: Model, make: Callable[[], Controller]) -> dict[str, Any]:
    """Steps and sines under a controller, over SEEDS."""
    found: dict[str, list[Array]] = {STEPS: [], SINES: []}
    statuses = Counter[str]()
    for reference, rows in found.items():
        for seed in SEEDS:
            loop = simulated(rig, model, make(), reference, seed=seed)
            rows.append(judged(rig, reference, loop.time, loop.outputs[:, 0]))
            statuses.update({status.value: count for status, count in loop.statuses.items()})
    return {**summary(found[STEPS], found[SINES], [*rig.schedule(SINES).windows]), "statuses": dict(statuses)}


def processes(rig: Rig, name: str) -> dict[str, Any]:
    """Steps and sines once with processes; the true speed is the rig's under the commands that the bag holds."""
    rows, timing = {}, {}
    for reference in (STEPS, SINES):
        with tempfile.TemporaryDirectory() as folder:
            outcome = Run(
                rig=rig.source,
                policy=name,
                reference=reference,
                bag=Path(folder) / "bag",
                parameters=UNFORESEEN if reference == STEPS else {},
                tell=lambda line: None,
            ).go()
            if outcome.interrupted or outcome.bag is None:
                raise KeyboardInterrupt
            loop = LoopRecord.from_bag(outcome.bag, rig)
        rows[reference] = [judged(rig, reference, loop.time, replayed(rig, loop.inputs))]
        plant = outcome.diagnostics["plant"]
        timing[reference] = {
            "rate_hz": plant["measurement_rate_hz"],
            "delay_ms": {key: plant[f"delay_ms_{key}"] for key in ("p50", "p99", "max")},
            "missed_commands": plant["missed_commands"],
            "measurements": plant["measurements"],
        }
    return {**summary(rows[STEPS], rows[SINES], [*rig.schedule(SINES).windows]), "timing": timing}


def replayed(rig: Rig, inputs: Array) -> Array:
    """True speed [SI] at each sample under the inputs since it (samples, 1)."""
    plant, found = Plant(rig, seed=0, bias=rig.bias, noisy=False), []
    for u in inputs:
        found.append(plant.outputs()[0])
        for _ in range(round(PERIOD / rig.step)):
            plant.advance(u)
    return np.array(found)


def draw(rig: Rig, model: Model, made: Mapping[str, Callable[[], Controller]]) -> Path:
    """The steps of one seed under each."""
    speeds, inputs, time = {}, {}, np.zeros(0)
    for name, make in made.items():
        loop = simulated(rig, model, make(), STEPS, seed=SEEDS[0])
        time, inside = loop.time, (loop.time >= SHOWN[0]) & (loop.time <= SHOWN[1])
        speeds[name], inputs[name] = loop.outputs[inside, 0] / rig.display[0].scale, loop.inputs[inside, 0]
    lines = {"reference": rig.schedule(STEPS)(time[inside])[:, 0], **speeds}
    panels = [
        picture.Panel(label="wheel [rpm]", height=240, lines=lines),
        picture.Panel(label="PWM [counts]", height=160, held=True, lines=inputs),
    ]
    return picture.draw(PICTURE, time[inside], panels, title="Steps of the wheel's speed")


def table(rows: Mapping[str, Mapping[str, Any]]) -> Table:
    """Beside what was asked."""
    sines = [*next(iter(rows.values()))["sine_rmse"]]
    found = Table("", "settling [s]", "overshoot [%]", "steady error [%]", *(f"{name} [%]" for name in sines))
    found.add_row("asked", "< .5", "< 10", "< 2", *("< 5" for _ in sines))
    for name, row in rows.items():
        shares = (row["overshoot_largest"], row["steady_error_largest"], *(row["sine_rmse"][item] for item in sines))
        found.add_row(name, _shown(row["settling_longest"]), *(_shown(item, 100.0) for item in shares))
    return found


def _shown(values: Mapping[str, float], times: float = 1.0) -> str:
    mean, low, high = (times * values[key] for key in ("mean", "min", "max"))
    return f"{mean:.3g}" if low == high else f"{mean:.3g} ({low:.3g}-{high:.3g})"


def main() -> int:
    """Measure, print and write."""
    machine, rig = result.machine(), load(RIG)
    model = load_model(configuration.shipped(RIG, "model"))
    values = configuration.defaults(rig, "controller")
    problem = configuration.mpc_problem(values, rig, model.system)
    imitation = policy.load(configuration.shipped(RIG, "policy"), model=model)
    tolerances = check_tolerances(values, rig, problem)
    made: dict[str, Callable[[], Controller]] = {
        "exact MPC": lambda: ExactMpc(model.system, problem),
        "policy": lambda: imitation,
        "supervised policy": lambda: Supervisor(imitation, ExactMpc(model.system, problem), tolerances),
    }
    rows = {name: lockstep(rig, model, make) for name, make in made.items()}
    for name in ("exact", "supervised"):
        rows[f"processes, {name}"] = processes(rig, name)
    draw(rig, model, {name: made[name] for name in ("exact MPC", "policy")})
    print_table(table(rows))
    print(result.write(RIG, rows, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)

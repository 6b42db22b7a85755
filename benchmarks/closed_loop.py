"""Controllers on the same noisy plant, not their model, under the same references: docs/results/comparison.md.

The rig's own P law on its filtered position, that law about the input that balances the beam, a linear quadratic
regulator, the exact MPC, its imitation by a network, and that network under its supervisor. All but the P laws get the
Kalman filter's estimate at the MPC's period; the P laws run at the rig's 1 kHz. References: the author's hardware run,
random steps and a multisine; the seed makes the noise and the last two. The rig itself reached 1.080 V on the steps of
the hardware run and .500 V on its sine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import picture, result
from benchmarks.linear_quadratic_regulator import LinearQuadraticRegulator
from benchmarks.timed import Timed
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import Controller, ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.excitation import (
    Reference,
    multisine,
    random_steps,
)
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import check_tolerances
from hybrid_sysid_ros.runtime.simulated_loop import simulated_loop
from hybrid_sysid_ros.support.arrays import Array

RIG = "cam_beam"
NAME = "closed_loop"
SEEDS = (0, 1, 2)
REPEATS = 2
"""Of each loop, which goes the same way again: of each call the faster one counts, for the machine has other work."""

PICTURE = Path(__file__).parents[1] / "docs" / "results" / "comparison.svg"
SHOWN = (12.5, 16.5)
"""Seconds of the hardware reference in the picture."""

ITERATED, SUPERVISED = "exact MPC, one iteration", "supervised policy"
"""Not in the picture: they can't be told from the exact MPC there."""

BALANCE = 1.0
"""Input that balances the beam in the records, .9 to 1.2 V: what the P law lacks [V]."""

REGULATOR_SMOOTHING = 0.1
"""What the regulators take dry friction for [rad/s]: of .005, .01, .02, .05, .1, .2, .5 and 1000 the one of the lowest
cost over other seeds and references than those measured here (100 and 101, 20 s of random steps and a multisine), with
preview and without."""

Drive = Callable[..., ClosedLoop]
"""drive(reference, seed=..., duration=...): a loop under one of the controllers."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """A reference, made by a seed, and the windows of it that are scored, by name [s]."""

    reference: Callable[[int], Reference]
    duration: float
    windows: Mapping[str, tuple[float, float]]


HARDWARE = load(RIG).schedule()
COURSES = {
    "hardware": Course(
        reference=lambda seed: HARDWARE.of(0),
        duration=HARDWARE.duration,
        windows={f"hardware {name}": window for name, window in HARDWARE.windows.items()},
    ),
    "random steps": Course(
        reference=lambda seed: random_steps(seed, amplitude=4.0, hold=1.0, duration=30.0),
        duration=30.0,
        windows={"random steps": (0.0, 30.0)},
    ),
    "multisine": Course(
        reference=lambda seed: multisine(seed, amplitude=4.0, low=0.1, high=1.0, lines=10, period=30.0),
        duration=30.0,
        windows={"multisine": (0.0, 30.0)},
    ),
}


def proportional_loop(
    rig: Rig, reference: Reference, *, balance: float, seed: int, duration: float, period: float
) -> ClosedLoop:
    """The law u = balance + gain (q - yf) at the rig's own rate, as its experiments were driven; a row each period.

    It estimates no state: its loop has the true one.
    """
    plant = Plant(rig, seed=seed, bias=rig.bias)
    scale, every = rig.display[0].scale, round(period / rig.step)
    rows = []
    for k in range(round(duration / rig.step)):
        wanted, filtered = float(reference(plant.time)), float(plant.measure().filtered[0])
        u = balance + rig.experiments.loops[0].gain * (wanted - filtered / scale)
        u = min(max(u, -rig.actuators[0].high), rig.actuators[0].high)
        if k % every == 0:
            rows.append((plant.time, plant.outputs(), plant.state.copy(), [scale * wanted], [u]))
        plant.advance(u)
    time, outputs, states, references, inputs = (np.array(part, dtype=float) for part in zip(*rows, strict=True))
    statuses = Counter({Status.FEEDBACK: len(rows)})
    return ClosedLoop(
        time=time, outputs=outputs, estimates=states, references=references, inputs=inputs, statuses=statuses
    )


def competitors(rig: Rig, model: Model) -> tuple[ControlProblem, dict[str, Timed], dict[str, Drive]]:
    """The problem of the MPC, the controllers, and how each controller or law drives a loop, by name."""
    imitation = policy.load(configuration.shipped(RIG, "policy"), model=model)
    problem, system = imitation.problem, model.system
    tolerances = check_tolerances(configuration.defaults(RIG, "controller"), rig, problem)
    timed = {
        "LQR": Timed(
            LinearQuadraticRegulator(system, problem, smoothing=REGULATOR_SMOOTHING, preview=False),
        ),
        "LQR with preview": Timed(LinearQuadraticRegulator(system, problem, smoothing=REGULATOR_SMOOTHING)),
        "exact MPC": Timed(ExactMpc(system, problem)),
        ITERATED: Timed(ExactMpc(system, problem, real_time=True)),
        "policy": Timed(imitation),
        SUPERVISED: Timed(Supervisor(imitation, ExactMpc(system, problem), tolerances)),
    }

    def proportional(balance: float) -> Drive:
        def drive(reference: Reference, *, seed: int, duration: float) -> ClosedLoop:
            return proportional_loop(
                rig, reference, balance=balance, seed=seed, duration=duration, period=problem.period
            )

        return drive

    def controlled(controller: Controller) -> Drive:
        def drive(reference: Reference, *, seed: int, duration: float) -> ClosedLoop:
            return simulated_loop(
                rig, model, controller, lambda t: reference(t)[..., None], duration=duration, seed=seed
            )

        return drive

    drives = {"P law of the rig": proportional(0.0), "P law, balanced": proportional(BALANCE)}
    return problem, timed, drives | {name: controlled(controller) for name, controller in timed.items()}


def measured(rig: Rig, runs: Mapping[str, list[ClosedLoop]], costs: Array, seconds: list[float]) -> dict[str, Any]:
    """What is published of a controller: ``runs`` by course, one of each seed; ``costs`` to those of the exact MPC."""
    every = [[runs[course][index].inputs[:, 0] for course in COURSES] for index in range(len(SEEDS))]
    inputs = [np.concatenate(applied) for applied in every]
    changes = [np.concatenate([np.diff(u) for u in applied]) for applied in every]
    statuses: Counter[Status] = sum((loop.statuses for loops in runs.values() for loop in loops), Counter())
    scale, limit = rig.display[0].scale, rig.actuators[0].high
    calls = 1e6 * np.reshape(seconds, (REPEATS, -1)).min(axis=0) if seconds else None
    return {
        "rmse_volts": {
            window: result.spread([float(loop.tracking_rmse(*span)[0]) / scale for loop in runs[name]])
            for name, course in COURSES.items()
            for window, span in course.windows.items()
        },
        "cost_ratio_to_exact": result.spread(costs),
        "input_rms_volts": result.spread([np.sqrt(np.mean(u**2)) for u in inputs]),
        "change_rms_volts": result.spread([np.sqrt(np.mean(change**2)) for change in changes]),
        "share_saturated": result.spread([np.mean(np.abs(u) >= limit) for u in inputs]),
        "bound_violations": int(sum(np.sum(~(np.abs(u) <= limit)) for u in inputs)),
        "call_microseconds": None if calls is None else result.percentiles(calls),
        "statuses": {status.value: count for status, count in statuses.items()},
    }


def main() -> int:
    """Run, print the tables, write the results and the picture."""
    machine = result.machine()
    rig = load(RIG)
    model = load_model(configuration.shipped(RIG, "model"))
    problem, timed, drives = competitors(rig, model)
    runs: dict[str, dict[str, list[ClosedLoop]]] = {}
    for name, drive in drives.items():
        drive(HARDWARE.of(0), seed=0, duration=1.0)  # what is compiled at first use
        if name in timed:
            timed[name].seconds.clear()
        for _ in range(REPEATS):
            runs[name] = {
                key: [drive(course.reference(seed), seed=seed, duration=course.duration) for seed in SEEDS]
                for key, course in COURSES.items()
            }
    costs = {
        name: np.array([sum(loops[key][index].cost_by(problem) for key in COURSES) for index in range(len(SEEDS))])
        for name, loops in runs.items()
    }
    results = {
        name: measured(rig, loops, costs[name] / costs["exact MPC"], timed[name].seconds if name in timed else [])
        for name, loops in runs.items()
    }
    for table in tables(results):
        print_table(table)
    print(result.write(NAME, results, on=machine))
    print(draw(rig, {name: loops["hardware"][0] for name, loops in runs.items() if name not in (ITERATED, SUPERVISED)}))
    return 0


def tables(results: Mapping[str, Mapping[str, Any]]) -> list[Table]:
    """Tracking; then cost, effort and time."""
    windows = [window for course in COURSES.values() for window in course.windows]
    tracking = Table("controller", *windows, title="tracking RMSE [V]: mean (range over seeds)")
    headings = ("cost to exact MPC", "rms u [V]", "rms change [V]", "saturated [%]", "out of bounds", "p50 [us]", "p99")
    effort = Table("controller", *headings, title="cost, effort and time of a call")
    for name, values in results.items():
        tracking.add_row(name, *(_shown(values["rmse_volts"][window]) for window in windows))
        times = values["call_microseconds"]
        effort.add_row(
            name,
            *(_shown(values[key]) for key in ("cost_ratio_to_exact", "input_rms_volts", "change_rms_volts")),
            _shown({key: 100.0 * share for key, share in values["share_saturated"].items()}, digits=1),
            str(values["bound_violations"]),
            *((f"{times['p50']:.1f}", f"{times['p99']:.1f}") if times else ("", "")),
        )
    return [tracking, effort]


def draw(rig: Rig, loops: Mapping[str, ClosedLoop]) -> Path:
    """The same seconds of all controllers: positions and inputs."""
    any_loop = next(iter(loops.values()))
    inside = (any_loop.time >= SHOWN[0]) & (any_loop.time <= SHOWN[1])
    scale = rig.display[0].scale
    positions = {name: loop.outputs[inside, 0] / scale for name, loop in loops.items()}
    return picture.draw(
        PICTURE,
        any_loop.time[inside],
        [
            picture.Panel(
                label="position [V]",
                height=280,
                lines={"reference": any_loop.references[inside, 0] / scale, **positions},
            ),
            picture.Panel(
                label="input [V]",
                height=180,
                held=True,
                lines={name: loop.inputs[inside, 0] for name, loop in loops.items()},
            ),
        ],
        title="The hardware reference under every controller, the same noise",
    )


def _shown(values: Mapping[str, float], *, digits: int = 3) -> str:
    return f"{values['mean']:.{digits}f} ({values['min']:.{digits}f}-{values['max']:.{digits}f})"


if __name__ == "__main__":
    result.run(main)

"""The MPC above its estimator and stabiliser on many plants: both commands step at once, and nobody knows before.

Each plant has its own uncertain parameters, all corners among them; the model is the one that ships. The estimator
finds out about the plant in level flight, then speed and height step. The same problem is solved by IPOPT.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import islice, product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.timed import Timed
from benchmarks.winged_cone import flights
from benchmarks.winged_cone.autopilot import ANGLE_OF_ATTACK, STATES, STEPS, judged
from benchmarks.winged_cone.flights import RIG
from hybrid_sysid_ros.control import Controller, ControlProblem, ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import controller_model, wrap_for_rig
from hybrid_sysid_ros.runtime.simulated_loop import simulated_loop
from hybrid_sysid_ros.support.arrays import Array

PLANTS = 1000
SETTLING, FLOWN = 12.0, 40.0
"""Seconds of level flight, in which the estimator learns of the plant, and seconds from the steps on."""
END = 5.0
"""Seconds at the end whose mean is the final error."""
MEASURES = (
    "speed settling", "speed overshoot", "speed final", "height settling", "height overshoot", "height final",
    "lowest angle", "highest angle", "failed", "not converged",
)  # fmt: skip
CHUNK, KEPT = 10, Path("out/winged_cone_mpc")
"""Plants between two looks, and where finished flights are kept until the end."""
TIMED, EVERY, REPEATS = 3, 4, 4
"""Plants on which solutions are timed; every which problem of them is IPOPT's as well; and how often each flight goes
the same way again: of each call the fastest counts, for the machine has other work."""


def plant(system: System, number: int) -> System:
    """One of the plants: the corners first, then any."""
    corners = 2 ** len(flights.UNCERTAIN)
    if number >= corners:
        return flights.plant(system, number)
    corner = next(islice(product((-1.0, 1.0), repeat=len(flights.UNCERTAIN)), number, None))
    return flights.with_values(system, dict(zip(flights.UNCERTAIN, corner, strict=True)))


def commands(rig: Rig, begin: float, ahead: float) -> Callable[[Array], Array]:
    """Both steps from a moment on [s], of which nobody knows before; ahead: of the first point of a preview [s]."""
    values = np.array([STEPS.get(item.name, 0.0) for item in rig.system.outputs])

    def reference(times: Array) -> Array:
        now = times[0] - (ahead if len(times) > 1 else 0.0)
        return np.tile(values * (now > begin), (len(times), 1))

    return reference


def flown(rig: Rig, model: Model, controller: Controller, seed: int) -> ClosedLoop:
    """A flight of a rig under a controller of the model's problem, from the steps on, which come at any moment between
    two plans.
    """
    system, sample = controller_model(rig, model.system), 1.0 / configuration.defaults(rig, "estimator")["rate"]
    begin = SETTLING + sample * (seed % round(controller.period / sample))
    reference = commands(rig, begin - 0.5 * sample, controller.period + system.delay)
    loop = simulated_loop(
        rig,
        model,
        wrap_for_rig(rig, system, controller),
        reference,
        duration=begin + FLOWN,
        plant=Plant(rig, seed=seed),
    )
    after = loop.time > begin - 0.5 * sample
    return replace(
        loop,
        time=loop.time[after] - begin,
        outputs=loop.outputs[after],
        estimates=loop.estimates[after],
        references=loop.references[after],
        inputs=loop.inputs[after],
    )


def problem_of(rig: Rig, system: System) -> ControlProblem:
    """Of the rig's file."""
    return configuration.mpc_problem(configuration.defaults(rig, "controller"), rig, system)


def mpc_of(rig: Rig, model: Model, *, real_time: bool = True, **changes: Any) -> ExactMpc:
    """The exact MPC of a model as the rig's file has it; changes: of its problem."""
    system = controller_model(rig, model.system)
    return ExactMpc(system, replace(problem_of(rig, system), **changes), real_time=real_time)


def measures(rig: Rig, loop: ClosedLoop) -> list[float]:
    """What is judged of a flight, in the order of MEASURES."""
    found: list[float] = []
    for name, step in STEPS.items():
        values = loop.outputs[:, STATES[name]]
        final = abs(float(np.mean(values[loop.time >= FLOWN - END])) - step)
        found += [*judged(loop.time, values, step), final]
    angles = np.degrees(loop.outputs[:, ANGLE_OF_ATTACK] + rig.system.operating_point["angle_of_attack"])
    failed = loop.statuses[Status.FAILED] + loop.statuses[Status.HELD]
    return [*found, float(angles.min()), float(angles.max()), failed, loop.statuses[Status.NOT_CONVERGED]]


def flights_of(numbers: tuple[int, int]) -> dict[str, Array]:
    """The flights of some plants, in a process of its own."""
    rig, model = load(RIG), load_model(configuration.shipped(RIG, "model"))
    controller, rows = mpc_of(rig, model), []
    for number in range(*numbers):
        other = replace(rig, system=plant(rig.system, number))
        rows.append(measures(rig, flown(other, model, controller, seed=number)))
    return {"measures": np.array(rows)}


def monte_carlo(rig: Rig, *, plants: int = PLANTS) -> dict[str, Any]:
    """Both steps at once on all plants."""
    pieces = [(first, min(first + CHUNK, plants)) for first in range(0, plants, CHUNK)]
    model = load_model(configuration.shipped(RIG, "model"))
    purpose = f"{model.seal} {problem_of(rig, controller_model(rig, model.system))} {SETTLING} {FLOWN}"
    store: parallel.Store[dict[str, Array]] = parallel.Store(KEPT, purpose)  # an interrupted run goes on
    found = parallel.run(flights_of, pieces, store=store)
    store.remove()
    table = dict(zip(MEASURES, np.concatenate([part["measures"] for part in found]).T, strict=True))
    lost = ~np.isfinite(np.sum(list(table.values()), axis=0)) | (np.abs(table["height final"]) > 100.0)
    reported = {
        name: {"median": float(np.median(values)), "min": float(values.min()), "max": float(values.max())}
        for name, values in table.items()
    }
    failed = int(np.sum(table["failed"]))
    return {"plants": plants, "unstable": int(np.sum(lost)), "problems_failed": failed, **reported}


def exact_inside(rig: Rig) -> dict[str, float]:
    """Both steps where the model in the MPC is the plant, whose engine needs steps of .1 s."""
    model = replace(load_model(configuration.shipped(RIG, "model")), system=rig.system)
    return dict(zip(MEASURES, measures(rig, flown(rig, model, mpc_of(rig, model, substeps=10), seed=0)), strict=True))


class Beside(Timed):
    """A controller whose problems another one solves as well, now and then."""

    def __init__(self, controller: Controller, other: Controller) -> None:
        super().__init__(controller)
        self.other = other
        self.others: list[float] = []
        self.apart: list[Array] = []

    def control(self, state: Any, disturbance: Any, previous_input: Any, preview: Any) -> Any:
        """Both answer, and the first one drives."""
        plan = super().control(state, disturbance, previous_input, preview)
        if len(self.seconds) % EVERY == 0:
            began = perf_counter()
            answer = self.other.control(state, disturbance, previous_input, preview)
            self.others.append(perf_counter() - began)
            if answer.status is Status.SOLVED and plan.status is Status.SOLVED:
                self.apart.append(np.abs(answer.input - plan.input))
            self.other.prepare(EVERY * self.period)
        return plan


def fastest(rig: Rig, model: Model, controller: Controller, *clocks: list[float]) -> list[dict[str, float]]:
    """Percentiles [ms] of what each clock of a controller shows, call by call the fastest of some equal flights."""
    flown(rig, model, controller, seed=0)  # compiles
    rounds = []
    for _ in range(REPEATS):
        for clock in clocks:
            clock.clear()
        for number in range(TIMED):
            flown(replace(rig, system=plant(rig.system, 100 + number)), model, controller, seed=number)
        rounds.append([np.array(clock) for clock in clocks])
    return [result.percentiles(1e3 * np.min(each, axis=0)) for each in zip(*rounds, strict=True)]


def timing(rig: Rig) -> dict[str, Any]:
    """How long a solution takes: converged, the feedback phase of real-time iterations, and IPOPT's."""
    from hybrid_sysid_ros.extensions.ipopt.interior_point import InteriorPointMpc

    model = load_model(configuration.shipped(RIG, "model"))
    system = controller_model(rig, model.system)
    problem = problem_of(rig, system)
    beside = Beside(mpc_of(rig, model, real_time=False), InteriorPointMpc(system, problem, tolerance=1e-8))
    quick = Timed(mpc_of(rig, model))
    exact, ipopt = fastest(rig, model, beside, beside.seconds, beside.others)
    (feedback,) = fastest(rig, model, quick, quick.seconds)
    apart = zip(system.inputs, np.max(beside.apart, axis=0), strict=True)
    return {
        "exact": exact,
        "real-time iteration": feedback,
        "ipopt": ipopt,
        "first_input_apart": {item.name: float(value) for item, value in apart},
        "times_faster": {key: ipopt[key] / exact[key] for key in ("p50", "p99")},
    }


def measured(rig: Rig) -> dict[str, Any]:
    """The flights."""
    return {"exact_model": exact_inside(rig), "monte_carlo": monte_carlo(rig)}


def flight_table(found: Mapping[str, Any]) -> Table:
    """How they went."""
    reported = found["monte_carlo"]
    title = (
        f"{reported['plants']} plants: {reported['unstable']} unstable, {reported['problems_failed']} problems failed"
    )
    shown = Table("both steps at once", "median", "from", "to", "exact model", title=title)
    for name in MEASURES:
        row, exact = reported[name], found["exact_model"][name]
        shown.add_row(name, *(f"{row[key]:.3g}" for key in ("median", "min", "max")), f"{exact:.3g}")
    return shown


def timing_table(found: Mapping[str, Any]) -> Table:
    """How long solutions take."""
    shown = Table("one solution [ms]", "p50", "p99", "max")
    for name in ("exact", "real-time iteration", "ipopt"):
        shown.add_row(name, *(f"{found[name][key]:.3f}" for key in ("p50", "p99", "max")))
    return shown

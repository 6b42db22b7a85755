"""Shots: closed loops along a reference of a rig, each of another plant, and how far from it they end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.accuracy.guarded_loop import guarded_loop
from hybrid_sysid_ros.extensions.accuracy.loop_measures import loop_numbers, quantities
from hybrid_sysid_ros.extensions.accuracy.node_loop import node_loop
from hybrid_sysid_ros.extensions.accuracy.statistics import ShotQuantity, Shots
from hybrid_sysid_ros.extensions.shared import drawn_scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import plant_near
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError

SAME, NEAR = 0.95, 0.02
"""Share of a recorded loop's samples, and of the largest reference, within which its reference is the same: a preview
has points, between which steps are lines.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """Where shots are fired: a reference of a rig, followed by the exact MPC on a model by the rig's parameters.

    A shot's plant is the rig, or what stands in for it. Its beginning (push) and a constant offset of its inputs
    (disturbance) are drawn by the deviations of the rig's policy_training; in a fleet so is each physical parameter.
    """

    rig: Rig
    model: Model
    """What estimator and controller know."""
    schedule: ReferenceSchedule
    seed: int
    reality: System | None = None
    """What the rig is; its own system by default."""
    predicted: bool = False
    """Whether the model stands in for the rig, as in a simulation of what will happen."""
    stand_in: System | None = None
    """Stands in for the rig in place of the model's system."""
    fleet: bool = False
    """Whether each shot is of another plant, as of a series; one plant by default."""
    latency: float | None = None
    """Time from a reading to its command [s] in the loop of the nodes, whose outputs are readings, as those of a bag.
    By default it is the controller's own loop: at its period, at once, outputs without noise.
    """
    doubted: bool = False
    """Whether it does so with parameters drawn from the covariance of its identification."""

    def __call__(self, numbers: Sequence[int]) -> NamedArrays:
        """Fire shots by their numbers: arrays with a row for each; see :class:`MonteCarloRuns`."""
        loop = self.loop()
        rows = [self._row(*self.fire(number, loop)) for number in numbers]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def loop(self) -> Callable[[Plant], ClosedLoop]:
        """What runs a shot. The MPC takes its time, so that a shot repeats."""
        schedule, settings = self.schedule, {"policy": "exact", "policy_path": "", "lockstep": True}
        if self.latency is not None:
            guarded = guarded_loop(self.rig, self.model, {**settings, "latency": self.latency})
            return partial(node_loop, self.rig, guarded, schedule, latency=self.latency)
        made = controller_of(self.rig, self.model, {**configuration.defaults(self.rig, "controller"), **settings})
        return lambda plant: simulated_loop(
            self.rig, self.model, made.controller, schedule, duration=schedule.duration, plant=plant
        )

    def fire(self, number: int, loop: Callable[[Plant], ClosedLoop]) -> tuple[ClosedLoop, Plant]:
        """One shot, as it went."""
        plant = self.plant(number)
        return loop(plant), plant

    @property
    def real(self) -> System:
        """What the rig is."""
        return self.rig.system if self.reality is None else self.reality

    def plant(self, number: int) -> Plant:
        """Of a shot."""
        random, stands_in = np.random.default_rng((self.seed, number)), self.predicted or self.doubted
        system = (self.stand_in or self.model.system) if stands_in else self.real
        spread = drawn_scenarios.spread_of(self.rig, system).sized(system)
        if self.doubted:
            system = drawn(self.model, random)
        if self.fleet:
            system = plant_near(system, spread.parameters, random)
        offset = random.normal(size=len(spread.disturbance)) * np.array(spread.disturbance)
        initial = random.normal(size=len(spread.push)) * np.array(spread.push)
        if stands_in:
            plant = predicted_plant(self.rig, system, disturbance=offset, seed=number, noisy=True)
        else:
            plant = Plant(replace(self.rig, system=system), seed=number, bias=np.array(self.rig.bias) + offset)
        plant.reset(initial)
        return plant

    def _row(self, loop: ClosedLoop, plant: Plant) -> NamedArrays:
        numbers = loop_numbers(self.rig, self.schedule, loop.time, loop.outputs, loop.references, loop.inputs)
        sound = [bool(np.all(np.isfinite(loop.outputs))), plant.stopped == 0, self._valid(loop)]
        return {**numbers, "sound": np.array(sound)}

    def _valid(self, loop: ClosedLoop) -> bool:
        """Whether the states that are outputs stayed where the rig's equations mean something."""
        if self.rig.validity is None:
            return True
        names = [item.name for item in self.rig.system.states]
        shown = [(k, names.index(item.name)) for k, item in enumerate(self.rig.system.outputs) if item.name in names]
        low, high = self.rig.validity
        return all(
            bool(np.all((loop.outputs[:, k] >= low[state]) & (loop.outputs[:, k] <= high[state]))) for k, state in shown
        )

    def content(self) -> dict[str, Any]:
        """All that its shots depend on, as plain data."""
        return {
            "rig": [repr(self.real), dict(self.rig.content)],
            "model": [self.model.structure, self.model.system.values.tolist(), self.model.system.weights.tolist()],
            "schedule": self.schedule.name,
            "seed": self.seed,
            "in_its_place": None if self.stand_in is None else [repr(self.stand_in), self.stand_in.values.tolist()],
            "stands_in": [self.predicted, self.doubted, self.fleet],
            "latency": self.latency,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class MonteCarloRuns:
    """Shots of a range."""

    where: Range
    rows: NamedArrays
    """A row for each shot: the numbers of :func:`loop_numbers`, and sound (3): ended in numbers, touched no stop,
    stayed where the equations mean something.
    """

    @property
    def tracking_error(self) -> Array:
        """(shots, windows), mean error at the end of each window of the reference, as the output is shown."""
        return self.rows["miss"]

    @property
    def rmse(self) -> Array:
        """(shots, windows), over the window."""
        return self.rows["rmse"]

    @property
    def sound(self) -> Array:
        """(shots, 3)."""
        return self.rows["sound"]

    def quantities(self) -> dict[str, list[ShotQuantity]]:
        """All quantities of the shots."""
        return quantities(self.where.rig, self.where.schedule, self.rows)

    @property
    def windows(self) -> Mapping[str, str]:
        """Units by name."""
        display = self.where.rig.display
        return {segment.name: display[segment.output].unit for segment in self.where.schedule.segments}

    def shots(self, name: str) -> Shots:
        """Their misses. Raises UserError where a loop ran away, and left no numbers."""
        lost = np.count_nonzero(~np.isfinite(self.tracking_error).all(axis=1))
        if lost:
            raise UserError(
                f"{name}: {lost} of {len(self.tracking_error)} shots ended in no numbers, as the loop ran away: lower "
                f"steps of {self.where.schedule.name}, or correct the controller's weights and limits, "
                f"in {self.where.rig.file}"
            )
        return Shots(
            name=name, names=tuple(self.windows), units=tuple(self.windows.values()), values=self.tracking_error
        )


def recorded_runs(where: Range, loops: Sequence[LoopRecord]) -> MonteCarloRuns:
    """Recorded loops of the real rig as its shots. Raises UserError where one did not follow the whole reference."""
    rig, schedule, rows = where.rig, where.schedule, []
    low, high = limits(rig)
    for loop in loops:
        wanted = schedule(loop.time) * [display.scale for display in rig.display]
        slack = 2.0 * float(np.median(np.diff(loop.time)))
        if loop.time[0] > slack or loop.time[-1] < schedule.duration - slack:
            raise UserError(
                f"{loop.source}: holds {loop.time[0]:.3g} to {loop.time[-1]:.3g} s of a loop, but {schedule.name} "
                f"lasts {schedule.duration:g} s: record it whole"
            )
        followed = loop.within(0.0, schedule.duration)
        off = np.nanquantile(np.abs(loop.reference - wanted)[followed][:, loop.tracked], SAME, axis=0)
        if np.any(off > NEAR * np.max(np.abs(wanted[:, loop.tracked]), axis=0)):
            raise UserError(
                f"{loop.source}: followed another reference than {schedule.name}: record that, or name "
                f"the other one in demo.reference of {rig.file}"
            )
        inside = bool(np.all((loop.outputs >= low) & (loop.outputs <= high)))
        sound = [bool(np.all(np.isfinite(loop.outputs))), inside, inside]
        numbers = loop_numbers(rig, schedule, loop.time, loop.outputs, wanted, loop.inputs)
        rows.append({**numbers, "sound": np.array(sound)})
    return MonteCarloRuns(where=where, rows={name: np.array([row[name] for row in rows]) for name in rows[0]})


def limits(rig: Rig) -> tuple[Array, Array]:
    """Lowest and highest value (p,) of the outputs that are states, by travel and validity."""
    names = [item.name for item in rig.system.states]
    low, high = np.full(len(rig.system.outputs), -np.inf), np.full(len(rig.system.outputs), np.inf)
    for k, item in enumerate(rig.system.outputs):
        for bounds in (rig.travel, rig.validity):
            if item.name in names and bounds is not None:
                state = names.index(item.name)
                low[k], high[k] = max(low[k], bounds[0][state]), min(high[k], bounds[1][state])
    return low, high


def batches(count: int, size: int) -> Iterator[tuple[int, ...]]:
    """Numbers of so many shots in batches, each the work of one process at a time."""
    for start in range(0, count, size):
        yield tuple(range(start, min(start + size, count)))


def drawn(model: Model, random: np.random.Generator) -> System:
    """The model's system with physical parameters drawn from the covariance of its identification, in their bounds."""
    known = {item.name: item for item in model.system.parameters if not item.learned}
    rows = [k for k, name in enumerate(model.names) if name in known]
    names, values = [model.names[k] for k in rows], dict(model.system.named)
    moved = random.multivariate_normal([values[name] for name in names], model.covariance[np.ix_(rows, rows)])
    for name, value in zip(names, moved, strict=True):
        values[name] = min(max(float(value), known[name].low), known[name].high)
    return model.system.with_values(np.array([values[item.name] for item in model.system.parameters]))

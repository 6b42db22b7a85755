"""Shots: closed loops along a reference of a rig, each of another plant, and how far from it they end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.scenarios import plant_near
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.accuracy.loop_measures import loop_numbers, quantities
from hybrid_sysid_ros.extensions.accuracy.statistics import ShotQuantity, Shots
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.controllers import ConfiguredController, controller_of
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """Where shots are fired: a reference of a rig, followed by the exact MPC on a model.

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
    sensed: bool = False
    """Whether outputs have the sensors' noise, as recorded ones are."""
    doubted: bool = False
    """Whether it does so with parameters drawn from the covariance of its identification."""

    def __call__(self, numbers: Sequence[int]) -> NamedArrays:
        """Fire shots by their numbers: arrays with a row for each; see :class:`MonteCarloRuns`."""
        controller = self.controller()
        rows = [self._row(number, *self.fire(number, controller)) for number in numbers]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def controller(self) -> ConfiguredController:
        """The exact MPC by the rig's parameters, which takes its time, so that a shot repeats."""
        settings = configuration.defaults(self.rig, "controller")
        return controller_of(self.rig, self.model, {**settings, "policy": "exact", "policy_path": "", "lockstep": True})

    def fire(self, number: int, made: ConfiguredController) -> tuple[ClosedLoop, Plant]:
        """One shot, as it went."""
        plant = self.plant(number)
        duration = self.schedule.duration
        return simulated_loop(
            self.rig, self.model, made.controller, self.schedule, duration=duration, plant=plant
        ), plant

    @property
    def real(self) -> System:
        """What the rig is."""
        return self.rig.system if self.reality is None else self.reality

    def plant(self, number: int) -> Plant:
        """Of a shot."""
        random, stands_in = np.random.default_rng((self.seed, number)), self.predicted or self.doubted
        system = (self.stand_in or self.model.system) if stands_in else self.real
        spread = configuration.spread_of(self.rig, system).sized(system)
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

    def _row(self, number: int, loop: ClosedLoop, plant: Plant) -> NamedArrays:
        outputs = loop.outputs
        if self.sensed:
            noise = [sensor.noise * sensor.scale for sensor in self.rig.sensors]
            outputs = outputs + np.random.default_rng((self.seed, number, 1)).normal(size=outputs.shape) * noise
        numbers = loop_numbers(self.rig, self.schedule, loop.time, outputs, loop.references, loop.inputs)
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
            "stands_in": [self.predicted, self.doubted, self.fleet, self.sensed],
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
        wanted = np.stack([d.si(schedule(loop.time)[:, k]) for k, d in enumerate(rig.display)], axis=1)
        if loop.time[0] > 0.0 or loop.time[-1] < schedule.duration - 2.0 * float(np.median(np.diff(loop.time))):
            raise UserError(
                f"{loop.source}: holds {loop.time[0]:.3g} to {loop.time[-1]:.3g} s of a loop, but {schedule.name} "
                f"lasts {schedule.duration:g} s: record it whole"
            )
        off = [float(np.nanmedian(np.abs(loop.reference[:, k] - wanted[:, k]))) for k in loop.tracked]
        if any(part > 1e-3 * float(np.max(np.abs(wanted))) for part in off):
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

"""Shots: closed loops along a reference of a rig, each of another plant, and how far from it they end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.scenarios import plant_near
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.accuracy.statistics import Shots
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule, Segment
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.controllers import ConfiguredController, controller_of
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError

END = 1.0
"""Horizons of the controller before the end of a window over which a miss is averaged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """Where shots are fired: a reference of a rig, followed by the exact MPC on a model.

    A shot's plant is the rig, or what stands in for it, each physical parameter moved by the deviation of the
    rig's policy_training; so are its beginning (push) and a constant offset of its inputs (disturbance).
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
    doubted: bool = False
    """Whether it does so with parameters drawn from the covariance of its identification."""

    def __call__(self, numbers: Sequence[int]) -> NamedArrays:
        """Fire shots by their numbers: arrays with a row for each; see :class:`MonteCarloRuns`."""
        controller = self.controller()
        rows = [self._row(self.fire(number, controller)) for number in numbers]
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
        system = self.model.system if stands_in else self.real
        spread = configuration.spread_of(self.rig, system).sized(system)
        if self.doubted:
            system = drawn(self.model, random)
        system = plant_near(system, spread.parameters, random)
        offset = random.normal(size=len(spread.disturbance)) * np.array(spread.disturbance)
        initial = random.normal(size=len(spread.push)) * np.array(spread.push)
        if stands_in:
            plant = predicted_plant(self.rig, system, disturbance=offset, seed=number, noisy=True)
        else:
            plant = Plant(replace(self.rig, system=system), seed=number, bias=np.array(self.rig.bias) + offset)
        plant.reset(initial)
        return plant

    def _row(self, runs: tuple[ClosedLoop, Plant]) -> dict[str, Any]:
        loop, plant = runs
        judged = [self._judged(loop, segment) for segment in self.schedule.segments]
        return {
            "miss": [tracking_error for tracking_error, _ in judged],
            "rmse": [rmse for _, rmse in judged],
            "sound": [bool(np.all(np.isfinite(loop.outputs))), plant.stopped == 0, self._valid(loop)],
        }

    def _judged(self, loop: ClosedLoop, segment: Segment) -> tuple[float, float]:
        """Mean error at the end of a window, and its root mean square over the window, as the output is shown."""
        settings = configuration.defaults(self.rig, "controller")
        end = END * settings["horizon"] * settings["period"]
        display = self.rig.display[segment.output]
        error = display.shown(loop.outputs[:, segment.output] - loop.references[:, segment.output])
        stop = min(segment.stop, self.schedule.duration)
        inside = (loop.time >= segment.start) & (loop.time < stop)
        last = inside & (loop.time >= stop - end)
        with np.errstate(over="ignore", invalid="ignore"):
            return float(np.mean(error[last])), float(np.sqrt(np.mean(error[inside] ** 2)))

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
            "stands_in": [self.predicted, self.doubted],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class MonteCarloRuns:
    """Shots of a range."""

    where: Range
    tracking_error: Array
    """(shots, windows), mean error at the end of each window of the reference, as the output is shown."""
    rmse: Array
    """(shots, windows), over the window."""
    sound: Array
    """(shots, 3): ended in numbers, touched no stop, stayed where the equations mean something."""

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

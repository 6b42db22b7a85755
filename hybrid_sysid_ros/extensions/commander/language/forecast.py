"""Forecasts: a plan simulated on the model, with the estimator and controller of the loop, before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.closed_loop import ClosedLoop
from hybrid_sysid_ros.control.controller import Status
from hybrid_sysid_ros.extensions.commander.language.draft import JUMP
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability, ReferencePlan
from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.validity import check_valid
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SETTLING = 1.0
"""Horizons of the controller that are simulated beyond a plan's end."""
TRIED = 5.0
"""Horizons in which a rig shows its speed and acceleration."""
FOLLOWED = 0.3
"""Of a plan's span, rms, which the outputs may lie off it."""
TROUBLED = 0.1
"""Share of answers without a sound plan that is reported."""
UNTRAINED = 0.05
"""Of its range in training, by which an output that leaves it is reported."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """Where a loop is: states (n,) of the model, inputs (m,) as applied, and their estimated offsets (m,)."""

    state: Array
    inputs: Array
    disturbance: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Forecast:
    """What will happen, or why not."""

    loop: ClosedLoop
    refusal: str
    """Why the plan is not carried out; "" if it is."""
    values: Mapping[str, float]
    """What there is to know of it, by name and unit."""

    @property
    def line(self) -> str:
        """The same in words."""
        return ", ".join(f"{name} {value:.3g}" for name, value in self.values.items())


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulator:
    """A rig's loop as it is configured, on its model.

    controller, estimator: parameters of those nodes.
    """

    rig: Rig
    model: Model
    controller: Mapping[str, Any]
    estimator: Mapping[str, Any]

    @classmethod
    def of(cls, rig: Rig, model: Model, *, policy: str = "") -> Simulator:
        """With the rig's own parameters; policy: another one than they say."""
        settings = configuration.defaults(rig, "controller")
        settings |= {"policy": policy} if policy else {}
        return cls(rig=rig, model=model, controller=settings, estimator=configuration.defaults(rig, "estimator"))

    @classmethod
    def configured(cls, rig: Rig, controller: Mapping[str, Any], estimator: Mapping[str, Any]) -> Simulator:
        """With the parameters of a loop's nodes, and the model that they name. Raises UserError where there is none."""
        model = load(controller["model"] or configuration.shipped(rig.name, "model"), rig=rig.source)
        return cls(rig=rig, model=model, controller=controller, estimator=estimator)

    @cached_property
    def made(self) -> Any:
        """The controller; it takes its time, so that a simulation repeats."""
        return controller_of(self.rig, self.model, {**self.controller, "lockstep": True})

    @property
    def rest(self) -> Start:
        """At 0, at rest."""
        states, inputs = len(self.model.system.states), len(self.model.system.inputs)
        rest = np.array([actuator.rest for actuator in self.rig.actuators])
        return Start(state=np.zeros(states), inputs=rest, disturbance=np.zeros(inputs))

    def simulate(self, plan: ReferencePlan, start: Start, *, duration: float) -> ClosedLoop:
        """The loop along a plan."""
        plant = predicted_plant(self.rig, self.model.system, disturbance=start.disturbance)
        plant.reset(start.state, inputs=start.inputs)
        return simulated_loop(
            self.rig, self.model, self.made.controller, plan, duration=duration, plant=plant, settings=self.estimator
        )

    @property
    def horizon(self) -> float:
        """Of the controller [s]."""
        return float(self.made.controller.horizon * self.made.controller.period)

    @cached_property
    def ability(self) -> Ability:
        """What the outputs reach: the peaks of a simulated step there and back between the ends of the set-points."""
        outputs = set_point_ranges(self.rig)
        found = np.full((2, len(outputs)), np.nan)
        for k, output in enumerate(outputs):
            if output.moves:
                found[:, k] = self._peaks(k, output.low, output.high)
        return Ability(speed=found[0], acceleration=found[1])

    def _peaks(self, k: int, low: float, high: float) -> Array:
        """Largest speed and acceleration of an output, as it is shown (2,)."""
        seconds = TRIED * self.horizon
        times = np.array([0.0, seconds, seconds + JUMP, 2.0 * seconds])
        values = np.zeros((4, len(self.rig.sensors)))
        values[:, k] = high, high, low, low
        loop = self.simulate(ReferencePlan(times=times, values=values, jumps=True), self.rest, duration=2.0 * seconds)
        shown = self.rig.display[k].shown(loop.outputs[:, k])
        period = float(loop.time[1] - loop.time[0])
        return np.array([np.abs(np.diff(shown, n)).max() / period**n for n in (1, 2)])

    def forecast(self, plan: ReferencePlan, start: Start) -> Forecast:
        """What the plan comes to from a start."""
        loop = self.simulate(plan, start, duration=max(plan.duration + SETTLING * self.horizon, 2.0 * self.horizon))
        values = self._values(plan, loop)
        return Forecast(loop=loop, refusal=self._refusal(plan, loop), values=values)

    def _values(self, plan: ReferencePlan, loop: ClosedLoop) -> dict[str, float]:
        found = {"seconds": plan.duration}
        for k, (item, actuator) in enumerate(zip(self.rig.system.inputs, self.rig.actuators, strict=True)):
            applied = loop.inputs[:, k]
            peak = float(applied[np.argmax(np.abs(applied - actuator.rest))])
            room = min(actuator.high - float(applied.max()), float(applied.min()) - actuator.low)
            span = 0.5 * (actuator.high - actuator.low)
            found[f"peak {item.name} [{item.unit}]"] = peak
            found[f"margin of {item.name} [%]"] = 100.0 * max(room, 0.0) / span
        for k, output in enumerate(set_point_ranges(self.rig)):
            if output.tracked:
                error = self.rig.display[k].shown(loop.outputs[:, k] - loop.references[:, k])
                found[f"error of {output.name} [{output.unit}]"] = float(np.sqrt(np.mean(error**2)))
        for k, (item, output) in enumerate(zip(self.model.system.outputs, set_point_ranges(self.rig), strict=True)):
            low, high = self.model.training_range.get(item.name, (-np.inf, np.inf))
            reached = loop.outputs[:, k]
            beyond = max(float(reached.max()) - high, low - float(reached.min()))
            if beyond > UNTRAINED * (high - low):
                shown = abs(float(self.rig.display[k].shown(np.float64(beyond))))
                found[f"{output.name} beyond what the model was trained on [{output.unit}]"] = shown
        unsound = sum(count for status, count in loop.statuses.items() if status not in SOUND)
        if unsound > TROUBLED * len(loop.time):
            found["answers without a sound plan [%]"] = 100.0 * unsound / len(loop.time)
        return found

    def _refusal(self, plan: ReferencePlan, loop: ClosedLoop) -> str:
        if not (np.isfinite(loop.outputs).all() and np.isfinite(loop.inputs).all()):
            return "its simulation ends in no numbers: say something gentler"
        outputs = set_point_ranges(self.rig)
        low, high = self.rig.travel_of_outputs
        for k, output in enumerate(outputs):
            reached = loop.outputs[:, k]
            if (reached <= low[k]).any() or (reached >= high[k]).any():
                return f"{output.name} would come to the end of its travel: take a smaller span, or go slower"
        try:
            check_valid(self.rig, loop.estimates, "the plan", system=self.model.system)
        except UserError as refusal:
            return str(refusal)
        if plan.jumps:
            return ""
        for k, output in enumerate(outputs):
            span = float(np.ptp(plan.values[:, k]))
            error = self.rig.display[k].shown(loop.outputs[:, k] - loop.references[:, k])
            rms = float(np.sqrt(np.mean(error**2)))
            if output.moves and span > 0.0 and rms > FOLLOWED * span:
                return (
                    f"{output.name} would lie {rms:.3g} {output.unit} off a plan over {span:.3g} {output.unit}: "
                    "give it more time, or a larger span"
                )
        return ""


SOUND = {Status.SOLVED, Status.ITERATED, Status.POLICY}

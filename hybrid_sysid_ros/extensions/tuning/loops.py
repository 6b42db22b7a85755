"""Closed loops by which a rig is tuned: what is varied of them, and what is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.control.closed_loop import ClosedLoop, OutputReference
from hybrid_sysid_ros.extensions.shared import drawn_scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import LENGTH, Spread, plant_near
from hybrid_sysid_ros.extensions.shared.reference_kinds import KINDS, references
from hybrid_sysid_ros.models import Model, Option, Options
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.parameters import check_rules
from hybrid_sysid_ros.runtime.simulated_loop import simulated_loop
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NODES = ("controller", "estimator")
FACTORS = {
    "controller.rate_weight": "weight of the inputs' changes",
    "controller.input_weight": "weight of the inputs",
    "estimator.process_noise": "noise of the states in the filter",
    "estimator.disturbance_noise": "drift of the input disturbance in the filter",
}
"""Parameters that are varied by a factor, for all inputs or states together."""
LEAST, MOST = 0.01, 100.0
"""Of a factor."""
HORIZON = "controller.horizon"
TUNING, UNSEEN = 7_401, 7_402
"""First numbers of the seeds of loops, which training, certificates and tests don't have: theirs have none before."""
MORE_UNSEEN = 8
"""Unseen loops for each one of a trial."""


@dataclass(frozen=True, kw_only=True)
class Measures:
    """What loops say, the mean of all."""

    settling: float
    """Mean of |output - reference| over the loop, in shares of the references' amplitude, of tracked outputs."""
    effort: float
    """Mean over the inputs of the rms of their changes from sample to sample, in shares of half their range."""
    inside: float
    """Share of the loops that stay within the rig's travel and validity."""


class DrawnLoop(NamedTuple):
    """What a loop has of its own."""

    plant: Plant
    reference: OutputReference
    seconds: float
    """Its length."""


@dataclass(frozen=True, kw_only=True)
class Loops:
    """Closed loops of the exact MPC on a model, with the estimator and the sensors' noise, on plants near the rig."""

    rig: Rig
    model: Model
    seed: int
    count: int
    """How many there are; the kinds of references take turns."""
    horizons: float
    """Length of a loop, in horizons of the shipped problem."""

    @property
    def space(self) -> dict[str, Option]:
        """What may be varied: factors of those parameters that are not 0, and the horizon, where the file's section mpc
        has nothing that fits its own alone, such as intervals.
        """
        found = {
            name: Option(default=1.0, low=LEAST, high=MOST, kind="log", description=f"factor of the {what}")
            for name, what in FACTORS.items()
            if np.any(np.atleast_1d(self.shipped[name.split(".")[0]][name.split(".")[1]]))
        }
        own = int(self.shipped["controller"]["horizon"])
        low, high = max(own // 3, 2), 2 * own
        if not (self._takes(low) and self._takes(high)):
            return found
        return found | {
            HORIZON: Option(default=own, low=low, high=high, kind="int", description="intervals of the MPC")
        }

    def values(self, options: Options) -> dict[str, dict[str, Any]]:
        """What options make of the parameters, by node. Raises UserError for values that the nodes don't take."""
        found: dict[str, dict[str, Any]] = {node: {} for node in NODES}
        for name, value in options.items():
            node, _, key = name.partition(".")
            given = self.shipped[node][key]
            scaled = [value * item for item in given] if isinstance(given, list | tuple) else value * given
            known = configuration.parameters(self.rig, node)
            found[node][key] = known[key].checked(int(value) if name == HORIZON else scaled)
            check_rules(known, {**self.shipped[node], **found[node]})
        return found

    def measures(self, options: Options, *, unseen: bool = False) -> tuple[Measures, Array]:
        """What all loops say, and settling and effort of each, (loops, 2). unseen: of others, never tuned on, and more
        of them, since a gain is a small difference.
        """
        values = {node: {**self.shipped[node], **more} for node, more in self.values(options).items()}
        numbers = range(self.count * (MORE_UNSEEN if unseen else 1))
        rows = np.array([self._loop(values, number, unseen) for number in numbers])
        settling, effort, inside = rows.mean(axis=0).tolist()
        return Measures(settling=settling, effort=effort, inside=inside), rows[:, :2]

    @cached_property
    def spread(self) -> Spread:
        """Sizes of references and offsets, and how far plants are from the rig, as in the training of policies."""
        return drawn_scenarios.spread_of(self.rig).sized(self.rig.system)

    @cached_property
    def shipped(self) -> dict[str, dict[str, Any]]:
        """Parameters of the nodes that ship, for a loop of the exact MPC in lockstep."""
        found = {node: configuration.defaults(self.rig, node) for node in NODES}
        for own in found.values():
            own["lockstep"] = True
        found["controller"] |= {"policy": "exact", "certificate": "ignore"}
        return found

    def drawn(self, number: int, unseen: bool) -> DrawnLoop:
        """What is drawn of a loop, which depends on the seed and its number alone."""
        rig, random = self.rig, np.random.default_rng([UNSEEN if unseen else TUNING, self.seed, number])
        spread = self.spread
        shipped = configuration.mpc_problem(self.shipped["controller"], rig, self._system)
        wanted = references(random, spread, shipped, [*KINDS][number % len(KINDS)])
        seconds = self.horizons * shipped.horizon * shipped.period
        start = random.uniform(0.0, max(LENGTH * shipped.horizon * shipped.period - seconds, 0.0))
        moved = replace(rig, system=plant_near(rig.system, spread.parameters, random))
        bias = np.asarray(rig.bias) + random.normal(size=len(rig.actuators)) * np.array(spread.disturbance)
        plant = Plant(moved, seed=int(random.integers(2**31)), bias=bias)
        return DrawnLoop(plant, lambda times: wanted(start + np.asarray(times)), seconds)

    def judged(self, loop: ClosedLoop) -> tuple[float, float, float]:
        """Settling and effort of a loop, and whether it stays inside."""
        rig = self.rig
        tracked = (
            np.array(configuration.mpc_problem(self.shipped["controller"], rig, self._system).output_weights) > 0.0
        )
        amplitude = np.maximum(np.array(self.spread.amplitude), 1e-12)
        errors = np.abs(loop.outputs - loop.references)[:, tracked] / amplitude[tracked]
        low, high = rig.limits
        changes = np.diff(loop.inputs, axis=0) / (0.5 * (high - low))
        inside = np.isfinite(loop.states).all() and all(
            np.all((loop.states >= ends[0]) & (loop.states <= ends[1]))
            for ends in (rig.travel, rig.validity)
            if ends is not None
        )
        return float(errors.mean()), float(np.sqrt((changes**2).mean(axis=0)).mean()), float(inside)

    def _loop(self, values: Mapping[str, Mapping[str, Any]], number: int, unseen: bool) -> Sequence[float]:
        rig, drawn = self.rig, self.drawn(number, unseen)
        scales = np.array([display.scale for display in rig.display])
        loop = simulated_loop(
            rig,
            self.model,
            controller_of(rig, self.model, values["controller"], lambda line: None).controller,
            lambda times: drawn.reference(times) / scales,
            duration=drawn.seconds,
            plant=drawn.plant,
            settings=values["estimator"],
        )
        return self.judged(loop)

    def _takes(self, horizon: int) -> bool:
        """Whether the MPC's problem can have a horizon."""
        try:
            configuration.mpc_problem(self.shipped["controller"] | {"horizon": horizon}, self.rig, self._system)
        except UserError:
            return False
        return True

    @cached_property
    def _system(self) -> Any:
        return configuration.controller_model(self.rig, self.model.system)

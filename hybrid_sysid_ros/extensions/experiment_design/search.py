"""The search for an experiment: a model in its rig's limits, whose excitation is exchanged piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.extensions.experiment_design.information import by_secants, run_of
from hybrid_sysid_ros.extensions.experiment_design.looped import looped
from hybrid_sysid_ros.extensions.experiment_design.segments import REST, PlanSegment, SegmentLibrary, stretches
from hybrid_sysid_ros.identification.validation.bands import drawn_systems, uncertainty_of
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

DRAWS = 6
"""Systems drawn from what the model does not know, in which an experiment must stay within limits, too."""
STEPS = 30_000_000
"""Steps of an experiment in all trials of a search, of which there are between FEWEST and MOST."""
FEWEST, MOST = 300, 2500
PIECE, PIECES = 5.0, (4, 24)
"""Length of a segment [s], and the least and most of them."""
TRIED = 8
"""Segments that are tried in one place before the search goes on to the next."""

SHRUNK = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Factors by which the rig's own experiments are among the first plans: a whole one may leave the limits."""
POINTS, SLACK = 3, 0.05
"""Systems at which a criterion is taken, the model and two draws that mirror each other, so that an experiment suits
what the model could be as well; and by how much it may grow at the model. Secants cover this by themselves.
"""
FEWEST_SAMPLES = 20
"""Scored samples of an experiment."""
ASTRAY = 1e6
"""In the largest output of training: beyond, a system does not run."""
BEYOND = 0.15
"""Share of the trained range of an output by which an experiment may leave it, if the law ends there or was learned:
further out it is a guess, and a fit to what happens there finds other minima.
"""
SHARE = 0.1
"""Of the rate of samples, those that drive or those that a fit sees, up to which frequencies are tried."""
DesignCriterion = Callable[[System, Array], float]
"""Of a system and inputs (steps, inputs); the search makes it small."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """A model's simulation in its rig's limits, driven as the rig's experiments are."""

    model: Model
    rig: Rig
    seconds: float
    period: float
    """From one sample of the drive to the next [s]."""
    amplitude: float
    """Share of the actuators' range, and of the reach of a loop's output, that is used."""
    known: bool = False
    """Whether outputs of a law that is known where it was trained stay near that, see BEYOND."""
    systems: Sequence[System] = field(init=False)
    """The model, and what it could be as well."""
    _samples: WeakKeyDictionary[PlanSegment, Array] = field(init=False, default_factory=WeakKeyDictionary)

    def __post_init__(self) -> None:
        """Raises UserError for an unstable rig, one whose feedback follows commands, and too short an experiment."""
        if self.rig.experiments.stabiliser is not None or self.rig.experiments.feedback is not None:
            raise UserError(
                f"{self.rig.name} is driven by a feedback or a stabiliser, under which no experiment is designed: "
                "write the commands by hand (experiments in rig.yaml)"
            )
        if self.seconds < FEWEST_SAMPLES * self.sampling.period:
            raise UserError(
                f"an experiment of {self.seconds:g} s has fewer than {FEWEST_SAMPLES} samples, which are "
                f"{self.sampling.period:g} s apart for this model: ask for {FEWEST_SAMPLES * self.sampling.period:g} s "
                "or more"
            )
        drawn = drawn_systems(self.model.system, uncertainty_of(self.model), DRAWS)
        pairs = [pair for pair in zip(drawn[::2], drawn[1::2], strict=True) if all(map(self._runs, pair))]
        object.__setattr__(self, "systems", [self.model.system, *(system for pair in pairs for system in pair)])

    def _runs(self, system: System) -> bool:
        """Whether a system runs at the model's step: one with a mode that is too fast for it is none that could be."""
        given = np.tile(sum(self.spans), (self.steps, 1))
        ranges = [self.model.training_range[item.name] for item in system.outputs]
        most = ASTRAY * max(abs(end) for pair in ranges for end in pair)
        return bool((np.abs(self.run(system, given)[1]) <= most).all())

    @property
    def sampling(self) -> Sampling:
        return self.model.sampling

    @property
    def points(self) -> int:
        """Systems at which a criterion is taken."""
        return 1 if by_secants(self.model.system, self.rig) else min(POINTS, len(self.systems))

    @property
    def fastest(self) -> float:
        """Highest frequency [Hz] that is tried."""
        return SHARE / max(self.period, self.sampling.period)

    @property
    def steps(self) -> int:
        """Integration steps of the experiment, a multiple of those of a scored period."""
        return round(self.seconds / self.sampling.period) * self.sampling.every

    @property
    def trials(self) -> int:
        """Of a search."""
        return int(np.clip(STEPS / self.steps, FEWEST, MOST))

    @property
    def spans(self) -> tuple[Array, Array]:
        """Middle and half of what each input, or its loop's reference, may do, (inputs,) each, in SI."""
        ends = np.array(self.rig.limits).T.copy()
        reach = self.rig.reach.T
        for index, loop in self.rig.experiments.loops.items():
            ends[index] = reach[loop.output]
            if not np.isfinite(ends[index]).all():
                numbers = [item[index].numbers for item in self.rig.experiments.excitations.values() if index in item]
                most = max((abs(n.get("amplitude", n.get("level", 0.0))) for n in numbers), default=0.0)
                if not most:
                    raise UserError(
                        f"{self.rig.file}: the reference of a loop has no limits: declare travel of "
                        f"{self.rig.system.outputs[loop.output].name}, or an excitation of it"
                    )
                ends[index] = np.array([-1.0, 1.0]) * most * abs(self.rig.sensors[loop.output].scale)
        both = (ends[:, 0] < 0.0) & (ends[:, 1] > 0.0)
        middle = np.where(both, 0.0, ends.mean(axis=1))
        half = np.where(both, np.abs(ends).min(axis=1), 0.5 * np.ptp(ends, axis=1))
        return middle, self.amplitude * half

    def driving(self, plan: Sequence[Sequence[PlanSegment]]) -> Array:
        """Samples of what drives each input at each step, (steps, inputs) in SI; each holds for a ``period``."""
        middle, half = self.spans
        shares = [np.concatenate([self._sampled(item) for item in row])[: self.steps] for row in plan]
        return self._at_their_rates(middle + half * np.stack(shares, axis=1))

    @property
    def count(self) -> int:
        """Segments of an input."""
        low, high = PIECES
        return int(np.clip(round(self.seconds / PIECE), low, high))

    @property
    def length(self) -> float:
        """Of a segment [s], whole samples of the drive and whole steps; the last one is cut at the end."""
        every = max(1, round(self.period / self.sampling.step))
        return float(np.ceil(self.steps / self.count / every) * every * self.sampling.step)

    def _sampled(self, item: PlanSegment) -> Array:
        """A segment at each of its steps, computed once."""
        if item not in self._samples:
            times = np.arange(round(self.length / self.sampling.step)) * self.sampling.step
            self._samples[item] = item.values(np.floor(times / self.period + 1e-6) * self.period, self.length)
        return self._samples[item]

    def _at_their_rates(self, driving: Array) -> Array:
        """What actuators with a rate make of commands."""
        for index, actuator in enumerate(self.rig.actuators):
            if np.isfinite(actuator.rate) and index not in self.rig.experiments.loops:
                value = actuator.rest
                for k, wanted in enumerate(driving[:, index].tolist()):
                    value = actuator.reached(wanted, value, self.sampling.step)
                    driving[k, index] = value
        return driving

    def run(self, system: System, driving: Array) -> tuple[Array, Array]:
        """Inputs (steps, inputs) and outputs (steps + 1, outputs) of a system from rest."""
        closed = looped(system, self.rig, self.sampling.step) if self.rig.experiments.loops else None
        used = closed or system
        starts, first = run_of(used, len(driving) + 1)
        with np.errstate(all="ignore"):
            states, outputs = rollouts(used, starts, first, driving, step=self.sampling.step)
        if closed is None:
            return driving, outputs
        return np.nan_to_num(closed.inputs_of(states[:-1], driving)), outputs

    def within(self, outputs: Array) -> bool:
        """Whether outputs stay within the rig's travel and what its equations are valid for, and near what is known."""
        low, high = self._ends
        return bool(np.isfinite(outputs).all() and (outputs >= low).all() and (outputs <= high).all())

    @cached_property
    def _ends(self) -> tuple[Array, Array]:
        """Lowest and highest value of each output, (outputs,). What is known has also been seen at rest."""
        low, high = self.rig.reach
        if not (self.known and is_known_where_trained(self.model.system)):
            return low, high
        trained = [self.model.training_range.get(item.name, (-np.inf, np.inf)) for item in self.rig.system.outputs]
        rests = [self.run(system, np.tile(self.spans[0], (self.steps, 1)))[1] for system in self.systems]
        seen = np.concatenate([np.array(trained).T, *rests])
        least, most = np.min(seen, axis=0), np.max(seen, axis=0)
        more = BEYOND * (most - least)
        return np.maximum(low, least - more), np.minimum(high, most + more)

    def feasible(self, driving: Array, systems: Sequence[System] | None = None) -> float:
        """Share of the systems that stay within limits."""
        used = self.systems if systems is None else systems
        return float(np.mean([self.within(self.run(system, driving)[1]) for system in used]))


def is_known_where_trained(system: System) -> bool:
    """Whether a law was learned, or ends where its training did, as one that is held constant further out."""
    most = np.ones(len(system.states))
    return len(system.weights) > 0 or not np.array_equal(system.trained_on(-most, most).values, system.values)


def exchanged(
    bench: Bench,
    criterion: DesignCriterion,
    *,
    seed: int,
    trials: int,
    progress: Callable[[int], None] = lambda done: None,
) -> list[list[PlanSegment]]:
    """Segments of each input, from the coordinate-exchange algorithm of Meyer & Nachtsheim (1995), Technometrics 37(1):
    one segment after another is exchanged for another one that makes the criterion smaller, over and over, beginning
    with the best of rest and the rig's own experiments; from the second round on half of the trials are near the
    segment in place. progress: is given the trials that are done.

    Raises UserError where even an experiment at rest leaves the limits, and where nothing is feasible.
    """
    count, random = bench.count, np.random.default_rng(seed)
    library = SegmentLibrary(length=bench.length, fastest=bench.fastest, random=random)
    plan = [[REST] * count for _ in bench.rig.actuators]
    least = _value(bench, criterion, plan)
    if least is None:
        raise UserError(f"{bench.rig.name} leaves its travel in the model's simulation at rest; design a shorter one")
    for own in own_plans(bench):
        value = _value(bench, criterion, own, least)
        if value is not None:
            plan, least = own, value
    done, round_number = 0, 0
    while done < trials:
        for place in random.permutation(count * len(plan)).tolist():
            row, at = divmod(place, count)
            for _ in range(TRIED):
                near = round_number and random.random() < 0.5
                trial = [list(item) for item in plan]
                trial[row][at] = library.changed(plan[row][at]) if near else library.drawn()
                value = _value(bench, criterion, trial, least)
                if value is not None:
                    plan, least = trial, value
            done += TRIED
            progress(min(done, trials))
            if done >= trials:
                break
        round_number += 1
    return plan


def own_plans(bench: Bench) -> Iterator[list[list[PlanSegment]]]:
    """Plans of the rig's own experiments, whole and smaller; without those of inputs that have limits on one side of 0,
    whose rest a plan has elsewhere.
    """
    (middle, half), rig = bench.spans, bench.rig
    units = np.ones(len(half))
    for index, loop in rig.experiments.loops.items():
        units[index] = abs(rig.sensors[loop.output].scale)
    for driven in rig.experiments.excitations.values():
        if not middle[list(driven)].any():
            for factor in SHRUNK:
                plan = [[REST] * bench.count for _ in rig.actuators]
                for index, signal in driven.items():
                    unit = factor * float(units[index] / half[index])
                    plan[index] = [*stretches(signal, unit=unit, count=bench.count, length=bench.length)]
                yield plan


def _value(
    bench: Bench, criterion: DesignCriterion, plan: Sequence[Sequence[PlanSegment]], least: Array | None = None
) -> Array | None:
    """The criterion of a plan at each of the points; None where some system leaves the limits, or where the plan is no
    better than ``least`` on average, or clearly worse for the model, of which the others are not asked then.
    """
    driving, found = bench.driving(plan), []
    for number, system in enumerate(bench.systems):
        inputs, outputs = bench.run(system, driving)
        if not bench.within(outputs):
            return None
        if number < bench.points:
            found.append(criterion(system, inputs))
        if number == 0 and least is not None and found[0] > least[0] + SLACK:
            return None
        if (
            number == min(bench.points, len(bench.systems)) - 1
            and least is not None
            and np.mean(found) >= np.mean(least)
        ):
            return None
    return np.array(found)

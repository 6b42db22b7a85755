"""Rehearsal: a loop of a rig on which faults are tried, one after the other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.false_alarms import acted, bounded, loop_of
from benchmarks.fault_rehearsal.best_course import best_course
from benchmarks.fault_rehearsal.known_fault import KnownActuators, sound_readings
from benchmarks.fault_rehearsal.signal_faults import LASTING, Fault, Moment
from benchmarks.faults.observation import LONGEST_LOOK, MOVING, RESTRAINED, ROOM, WINDOW
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.support.arrays import Array

SETTLING, AFTER = 2.0, 1.0
"""Time of the way to the reference, and after a fault [s]."""
INTERVAL = 5
"""Periods for which the best course holds its inputs."""


class Rehearsal:
    """A loop of a rig, of which each fault is tried on a fresh one.

    tolerance: of the tracking error's rms over WINDOW (p,) [SI], from a loop without a fault.
    """

    def __init__(self, rig: Rig, *, known: bool = False) -> None:
        """known: the loop knows each fault from its first sample on, and the guard has nothing to do."""
        self.rig, self.known = rig, known
        self.loop = loop_of(rig, **({"distrust": "tell"} if known else {}))
        self.estimator, self.period = self.loop.estimator, 1.0 / defaults(rig, "estimator")["rate"]
        self.tracked = np.array(defaults(rig, "controller")["output_weight"]) > 0.0
        self.turn = 1.0 / MOVING[rig.name]["frequency"]
        scales = np.array([display.scale for display in rig.display])
        self._peaks = scales * MOVING[rig.name]["amplitude"] * self.tracked
        names = [item.name for item in rig.system.states]
        self._at = [(k, names.index(item.name)) for k, item in enumerate(rig.system.outputs) if item.name in names]
        count = math.ceil(min(self.turn, LONGEST_LOOK) / WINDOW)
        sound = SETTLING + count * WINDOW
        errors = [error for _, _, error in self._course(Fault(), sound, sound, seed=0)]
        usual = np.max([self._rms(errors, SETTLING + k * WINDOW) for k in range(count)], axis=0)
        noise = np.array([sensor.scale * sensor.noise for sensor in rig.sensors])
        self.tolerance = np.where(self.tracked, ROOM * np.maximum(usual, noise), math.inf)

    def reference(self, times: Array) -> Array:
        """(times, p) [SI]."""
        return np.sin(2.0 * math.pi / self.turn * np.asarray(times))[..., None] * self._peaks

    def tried(self, fault: Fault, *, phase: float = 0.0, seed: int = 0) -> dict[str, Any]:
        """What the loop did. phase: share of the reference's period, or of LONGEST_LOOK where that is
        shorter, by which the fault begins later.
        """
        loop, begin = self.loop, SETTLING + phase * min(self.turn, LONGEST_LOOK)
        found: dict[str, Any] = {"state": "", "reason": "", "false": "", "most": 0.0}
        found |= dict.fromkeys(("after", "left", "restrained"), math.inf)
        errors = list[Array]()
        for since, plant, error in self._course(fault, begin, begin + LASTING + AFTER + WINDOW, seed=seed):
            errors.append(error)
            level = loop.level
            if since < 0.0 and level is not LoopState.DRIVING:
                found["false"] = level.word
            if since >= 0.0:
                if level is not LoopState.DRIVING and not found["state"]:
                    found |= {"state": level.word, "after": since, "reason": loop.guard.reason}
                if level.word in RESTRAINED:
                    found["restrained"] = min(found["restrained"], since)
                found["most"] = max(found["most"], *loop.guard.evidence.values())
                found["left"] = min(found["left"], since) if self._is_out(plant) else found["left"]
        during = np.abs(errors[round(begin / self.period) : round((begin + LASTING) / self.period)])
        found["during"] = float(np.max(during / self.tolerance))
        found["error"] = float(np.max(self._rms(errors, begin + LASTING + AFTER) / self.tolerance))
        found["kept"] = min(found["restrained"], LASTING + AFTER) <= found["left"]
        found["unnamed"] = self._is_out(plant) and loop.level.word not in RESTRAINED
        found["short"] = not found["kept"] or found["unnamed"] or not found["error"] <= 1.0
        return found

    def best(self, fault: Fault) -> tuple[float, bool]:
        """See :func:`.best_course.best_course`, from where the sound loop is when a fault begins."""
        *_, (_, plant, _) = self._course(Fault(), SETTLING, SETTLING, seed=0)
        window = LASTING + AFTER, LASTING + AFTER + WINDOW
        at = {"begin": SETTLING, "window": window, "period": INTERVAL * self.period}
        return best_course(self.rig, fault, plant.state, self.reference, self.tolerance, **at)

    def wrong_from_the_start(self, fault: Fault, seconds: float, *, seed: int = 0) -> dict[str, Any]:
        """What the loop did with a fault from its first sample on: when there was evidence, and whether travel and
        validity were kept; the error's rms over the last half, in tolerances.
        """
        found: dict[str, Any] = {"after": math.inf, "kept": True}
        errors = list[Array]()
        for since, plant, error in self._course(fault, 0.0, seconds, seed=seed, lasting=seconds):
            errors.append(error)
            if self.loop.level is not LoopState.DRIVING or self.estimator.doubt >= 1.0:
                found["after"] = min(found["after"], since)
            found["kept"] = found["kept"] and not self._is_out(plant)
        last = np.array(errors[len(errors) // 2 :]) / self.tolerance
        return {**found, "error": float(np.max(np.sqrt(np.mean(last**2, axis=0))))}

    def _rms(self, errors: list[Array], begin: float) -> Array:
        """Of the errors, over WINDOW from then on [s]: (p,)."""
        window = errors[round(begin / self.period) :][: round(WINDOW / self.period)]
        return np.sqrt(np.mean(np.square(window), axis=0))

    def _course(
        self, fault: Fault, begin: float, seconds: float, *, seed: int, lasting: float = LASTING
    ) -> Iterator[tuple[float, Plant, Array]]:
        """Time since the fault began [s], the plant, and the tracking error (p,) before it, sample by sample."""
        rig, loop, period = self.rig, self.loop, self.period
        plant, random = Plant(rig, seed=seed, bias=rig.bias), np.random.default_rng(seed)
        self.estimator.begin()
        loop.begin()
        steps, (low, high) = rig.steps(period, "the period"), rig.limits
        reads = fault.reads() if fault.reads else None
        acts = fault.acts() if fault.acts else None
        tells = fault.tells() if fault.tells else None
        told, known = loop.input.copy(), KnownActuators(fault, rig.limits, loop.guard.settings.alike)
        first, count = round(begin / period), round(lasting / period)
        for k in range(round(seconds / period)):
            time, number = k * period, k - first
            wrong, moment = 0 <= number < count, Moment(number * period, number, random)
            readings = plant.sensed().copy()
            error = (self.reference(np.array([time]))[0] - plant.outputs()) * self.tracked
            if wrong and reads is not None:
                shown = reads(moment, readings.copy())
                readings = sound_readings(readings, shown) if self.known else shown
            estimate = self.estimator.update(time, readings, told)
            now = time + loop.lead
            references = self.reference(np.array([now]))[0], self.reference(now + loop.times)
            applied = command = bounded(rig, loop.control(estimate, told, *references, period))
            if wrong and acts is not None:
                applied = known.command(moment, applied) if self.known else applied
                applied = np.clip(acts(moment, applied.copy()), low, high)
            told = acted(plant, applied, steps)
            if wrong and acts is not None and not (fault.told or self.known):
                told = command
            if wrong and tells is not None and not self.known:
                told = tells(moment, told)
            yield moment.since, plant, error

    def _is_out(self, plant: Plant) -> bool:
        """At a stop, too: the simulated rig does not leave its travel."""
        outputs = plant.outputs()
        bounds = [self.rig.travel, *([] if self.rig.validity is None else [self.rig.validity])]
        return any(not low[s] < outputs[k] < high[s] for low, high in bounds for k, s in self._at)

"""Rehearsal: a loop of a rig on which faults are tried, one after the other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.false_alarms import bounded, loop_of
from benchmarks.fault_rehearsal.signal_faults import LASTING, Fault, Moment
from benchmarks.faults.observation import LONGEST_LOOK, MOVING, RESTRAINED, ROOM, WINDOW
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.support.arrays import Array

SETTLING, AFTER = 2.0, 1.0
"""Time of the way to the reference, and after a fault [s]."""


class Rehearsal:
    """A loop of a rig, of which each fault is tried on a fresh one."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.loop = loop_of(rig)
        self.estimator, self.period = self.loop.estimator, 1.0 / defaults(rig, "estimator")["rate"]
        self.tracked = np.array(defaults(rig, "controller")["output_weight"]) > 0.0
        self.learned = math.ceil(min(1.0 / MOVING[rig.name]["frequency"], LONGEST_LOOK) / WINDOW) * WINDOW
        self.before = SETTLING + self.learned
        scales = np.array([display.scale for display in rig.display])
        amplitude, turns = MOVING[rig.name]["amplitude"], 2.0 * math.pi * MOVING[rig.name]["frequency"]
        self._peaks, self._turns = scales * amplitude * self.tracked, turns
        names = [item.name for item in rig.system.states]
        self._at = [(k, names.index(item.name)) for k, item in enumerate(rig.system.outputs) if item.name in names]

    def reference(self, times: Array) -> Array:
        """(times, p) [SI]."""
        return np.sin(self._turns * np.asarray(times))[..., None] * self._peaks

    def tried(self, fault: Fault, *, seed: int = 0) -> dict[str, Any]:
        """What the loop did."""
        rig, loop, estimator, period = self.rig, self.loop, self.estimator, self.period
        plant = Plant(rig, seed=seed, bias=rig.bias)
        estimator.begin()
        loop.begin()
        steps, random = rig.steps(period, "the period"), np.random.default_rng(seed)
        reads = fault.reads() if fault.reads else None
        acts = fault.acts() if fault.acts else None
        applied, told = loop.input.copy(), loop.input.copy()
        errors: list[Array] = []
        low, high = rig.limits
        found: dict[str, Any] = {
            "state": "",
            "after": math.inf,
            "left": math.inf,
            "restrained": math.inf,
            "most": 0.0,
            "reason": "",
        }
        tripped = ""
        for k in range(round((self.before + LASTING + AFTER + WINDOW) / period)):
            time = k * period
            since = time - self.before
            moment = Moment(since, k - round(self.before / period), random)
            wrong = 0.0 <= since < LASTING
            readings = plant.sensed().copy()
            errors.append((self.reference(np.array([time]))[0] - plant.outputs()) * self.tracked)
            if wrong and reads is not None:
                readings = reads(moment, readings)
            estimate = estimator.update(time, readings, told)
            now = time + loop.lead
            command = loop.control(
                estimate, told, self.reference(np.array([now]))[0], self.reference(now + loop.times), period
            )
            told = bounded(rig, command)
            applied = told.copy()
            if wrong and acts is not None:
                applied = np.clip(acts(moment, applied), low, high)
                told = applied.copy() if fault.told else told
            for _ in range(steps):
                plant.advance(applied)
            level = loop.level
            if since < 0.0 and level is not LoopState.DRIVING:
                tripped = level.word
            if since >= 0.0:
                if level is not LoopState.DRIVING and not found["state"]:
                    found |= {"state": level.word, "after": since, "reason": loop.guard.reason}
                if level.word in RESTRAINED:
                    found["restrained"] = min(found["restrained"], since)
                found["most"] = max(found["most"], *loop.guard.evidence.values())
                found["left"] = min(found["left"], since) if self._is_out(plant) else found["left"]
        rows, count = np.array(errors), round(WINDOW / period)

        def rms(begin: float) -> Array:
            return np.sqrt(np.mean(rows[round(begin / period) :][:count] ** 2, axis=0))

        usual = np.max([rms(SETTLING + j * WINDOW) for j in range(round(self.learned / WINDOW))], axis=0)
        noise = np.array([sensor.scale * sensor.noise for sensor in rig.sensors])
        tolerance = np.where(self.tracked, ROOM * np.maximum(usual, noise), math.inf)
        during = np.max(np.abs(rows[round(self.before / period) : round((self.before + LASTING) / period)]), axis=0)
        found["during"] = float(np.max(during / tolerance))
        found["error"] = float(np.max(rms(self.before + LASTING + AFTER) / tolerance))
        found["kept"] = min(found["restrained"], LASTING + AFTER) <= found["left"]
        found["false"] = tripped
        found["short"] = not found["kept"] or not found["error"] <= 1.0
        return found

    def _is_out(self, plant: Plant) -> bool:
        outputs = plant.outputs()
        bounds = [self.rig.travel, *([] if self.rig.validity is None else [self.rig.validity])]
        return any(not low[s] <= outputs[k] <= high[s] for low, high in bounds for k, s in self._at)

"""Guard: turns what a loop knows about its estimate, actuators and range into slower, held or resting inputs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.controller import Controller
from hybrid_sysid_ros.control.safety.failsafe import Failsafe, Ladder, LoopState
from hybrid_sysid_ros.control.safety.governor import ReferenceGovernor
from hybrid_sysid_ros.estimation.suspicion import CLEAREST, LONGEST
from hybrid_sysid_ros.support.arrays import Array

ESTIMATE, ACTUATOR, RANGE = "estimate", "actuator", "range"
REASONS = {
    ESTIMATE: "measurements contradict the model",
    ACTUATOR: "the actuator does not do what was commanded",
    RANGE: "the state is outside of the rig's travel or validity",
}
"""Kinds of evidence, in words."""
RECENT = 0.05
"""Time [s], beside its delay, for which an actuator may still be carrying out a command."""
REMEMBERED = 64
"""Commands: at 1 kHz those of RECENT and a little more."""
UNLIKE = 0.5
"""Share of what an actuator was commanded, as a root mean square, by which it may miss that."""
SMALL = 0.1
"""Share of the tolerance below which commands are too small to tell what an actuator makes of them."""
AVERAGE = 0.1
"""Time constant [s] of the mean squares of commands and of what they are missed by."""
RETURN = 0.3
"""Time [s] in which inputs get their whole range back: a sensor with the wrong sign looks right while a rig rests, and
must show itself again before much has moved."""
TRIAL = 0.025
"""Share of half their range that inputs have, a stabiliser's among them, when an actuator in doubt is tried again: just
enough to show what it makes of them. A flipped or disconnected one looks right at rest."""
OUTSIDE = 0.02  # of a state's range, by which it may be beyond the end without being evidence


@dataclass(frozen=True, kw_only=True, eq=False)
class GuardSettings:
    """Thresholds of a guard. n states, m inputs, p outputs."""

    act: bool
    """Whether the guard acts; otherwise it only says what it would do."""
    ladder: Ladder
    slow_share: float
    """Of half an input's range, by which it may leave its rest while slowed, and of ``resume_rate``."""
    resume_rate: Array
    """(p,): by which the reference moves on when the loop comes back [output unit/s]."""
    reach: tuple[Array, Array]
    """Lowest and highest set-points (p,), NaN where there is no limit."""
    recent: float
    """Time [s] after which an actuator does not carry out a command any more that another one has replaced."""
    tolerance: float
    """Share of its range by which an actuator may differ from its commands."""
    low: Array
    """(m,), the lowest inputs."""
    high: Array
    """(m,), the highest."""
    rate: Array
    """(m,), the fastest changes [input unit/s], infinite where there is no limit."""
    state_low: Array
    """(n,), the lowest states that the rig's travel and validity allow, minus infinity where nothing is said."""
    state_high: Array
    """(n,)."""


class Guard:
    """Stands between estimate, controller and actuator: judges, governs the reference and limits the command.

    The evidence: ``doubt`` of the estimator; the distance of the applied inputs from the hull of the recent commands,
    over the tolerance or, squared, over the mean square of the commands; the distance of the state from its range over
    OUTSIDE of that range.
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.settings = settings
        self.failsafe = Failsafe(settings.ladder, list(REASONS))
        self.governor = ReferenceGovernor(len(settings.resume_rate))
        self._span = settings.high - settings.low
        self._middle = np.clip(0.0, settings.low, settings.high)
        self._limited = bool(np.isfinite(settings.rate).any())
        width = settings.state_high - settings.state_low
        self._outside = OUTSIDE * np.where(np.isfinite(width), width, np.maximum(1.0, np.abs(self._finite())))
        self._recent, self._replaced = np.zeros((REMEMBERED, len(self._span))), np.zeros(REMEMBERED)
        self.evidence = dict.fromkeys(REASONS, 0.0)
        self.begin()

    def _finite(self) -> Array:
        """The end of a range that has only one, else 0 (n,)."""
        low, high = self.settings.state_low, self.settings.state_high
        return np.asarray(np.where(np.isfinite(low), low, np.where(np.isfinite(high), high, 0.0)))

    def begin(self) -> None:
        """Forget the past."""
        self.failsafe.reset()
        self.governor.release()
        self._recent[:], self._replaced[:] = self._middle, math.inf  # [s] ago; the newest one never was
        self._row, self._share, self._tried = 0, 1.0, 1.0
        self._replaced[self._row] = -math.inf
        self._missed, self._asked = np.zeros(len(self._span)), np.zeros(len(self._span))

    def go_on(self, other: Guard) -> None:
        """Go on where another guard of the loop is, which this one replaces."""
        self.failsafe.go_on(other.failsafe)
        self.governor, self._recent, self._row = other.governor, other._recent, other._row
        self._replaced = other._replaced
        self._missed, self._asked = other._missed, other._asked
        self._share, self._tried = other._share, other._tried

    def judge(self, doubt: float, without: float, applied: Array, state: Array, elapsed: float) -> LoopState:
        """The level from an estimate. doubt, without: of the estimator, NaN where it says nothing. applied (m,): inputs
        that acted, NaN where that is not known. state (n,). elapsed: since the last estimate [s].
        """
        settings, evidence = self.settings, self.evidence
        evidence[ESTIMATE] = doubt
        evidence[ACTUATOR] = self._actuators(applied, elapsed)
        beyond = np.maximum(settings.state_low - state, state - settings.state_high) / self._outside
        evidence[RANGE] = float(beyond.max(initial=0.0, where=beyond == beyond))
        level = self.failsafe.judge(evidence, min(elapsed, LONGEST))
        if without > 0.0 and level < LoopState.SLOWED:
            level = LoopState.SLOWED
        level = level if settings.act else LoopState.DRIVING
        slow = settings.slow_share
        self._share = slow if level else min(self._share + (1.0 - slow) * elapsed / RETURN, 1.0)
        doubted = settings.act and self.failsafe.suspects(ACTUATOR, LoopState.HOLDING)
        self._tried = TRIAL if doubted else min(self._tried + (1.0 - TRIAL) * elapsed / RETURN, 1.0)
        return level

    def within_reach(self, outputs: Array) -> Array:
        """Where a reference begins when the loop comes back: the outputs (p,), or the nearest set-points. A rig that is
        beyond all of these has been driven there, and is brought back as fast as it may.
        """
        low, high = self.settings.reach
        return np.fmin(np.fmax(outputs, low), high)

    def _actuators(self, applied: Array, elapsed: float) -> float:
        """Evidence that actuators don't do what was commanded."""
        tolerance, share = self.settings.tolerance * self._span, min(elapsed / AVERAGE, 1.0)
        self._replaced += elapsed
        recent = self._recent[self._replaced <= self.settings.recent]
        asked = recent.mean(axis=0) - self._middle
        away = np.abs(applied - np.clip(applied, recent.min(axis=0), recent.max(axis=0)))
        known = away == away
        self._missed += share * (np.where(known, away, 0.0) ** 2 - self._missed)
        self._asked += share * (np.where(known, asked, 0.0) ** 2 - self._asked)
        enough = (self._asked > (SMALL * tolerance) ** 2) & (away > UNLIKE * np.abs(asked))
        unlike = self._missed / np.where(enough, UNLIKE**2 * self._asked, np.inf)
        return float(max((away / tolerance).max(initial=0.0, where=known), min(unlike.max(), CLEAREST)))

    def rest_of(self, controller: Controller, state: Array, rest: Array) -> Array:
        """Inputs (m,) while the loop rests: ``rest``, or those of the stabiliser below the controller for a state (n,),
        without which an unstable rig diverges.
        """
        if isinstance(controller, Cascade) and self.trusts_actuators and np.isfinite(state).all():
            return self._on_trial(controller.held(state))
        return rest

    @property
    def trusts_actuators(self) -> bool:
        """Whether a stabiliser may act while the loop rests: one whose inputs are not obeyed drives the rig away."""
        return not self.failsafe.suspects(ACTUATOR, LoopState.RESTING)

    @property
    def reason(self) -> str:
        """Why the level is what it is, in words."""
        if self.failsafe.reason:
            return REASONS[self.failsafe.reason]
        return "a sensor is missing or left out"

    def reference(self, level: LoopState, now: Array, preview: Array, times: Array, elapsed: float) -> Array:
        """The preview (points, p) that the controller gets; see :meth:`.governor.ReferenceGovernor.follow`."""
        rate, slow = self.settings.resume_rate, level is not LoopState.DRIVING
        if slow and self.governor.free:
            self.governor.begin(now)
        if self.governor.free:
            return preview
        share = 0.0 if level >= LoopState.HOLDING else self.settings.slow_share if slow else 1.0
        return self.governor.follow(now, preview, times, share * rate, elapsed, keep=slow)

    @property
    def slows(self) -> bool:
        """Whether inputs must stay near rest, now or still."""
        return self._share < 1.0 or self._tried < 1.0

    def slowed(self, inputs: Array, rest: Array) -> Array:
        """A command (m,) that stays as near to the inputs at rest (m,) as it must."""
        room = 0.5 * self._share * self._span
        return self._on_trial(np.clip(inputs, rest - room, rest + room))

    def _on_trial(self, inputs: Array) -> Array:
        """Inputs (m,) within their bounds, and as small as they must be where an actuator is on trial."""
        room = 0.5 * self._tried * self._span if self._tried < 1.0 else self._span
        return np.clip(np.clip(inputs, self._middle - room, self._middle + room), self.settings.low, self.settings.high)

    def followed(self, inputs: Array, before: Array, elapsed: float) -> Array:
        """What the actuators can follow of a command (m,), ``elapsed`` [s] after another one (m,)."""
        if not self._limited:
            return inputs
        reach = self.settings.rate * max(elapsed, 0.0)
        return np.clip(inputs, before - reach, before + reach)

    def commanded(self, inputs: Array) -> None:
        """Remember a command (m,) that was sent."""
        self._replaced[self._row] = 0.0
        self._row = (self._row + 1) % REMEMBERED
        self._recent[self._row], self._replaced[self._row] = inputs, -math.inf

"""Sensor monitor: which sensors contradict the model, which one is left out for that, and how much doubt remains."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.estimation.observability import check_observable
from hybrid_sysid_ros.estimation.suspicion import CLEAREST, Suspicion
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

AVERAGE, LONG_AVERAGE = 0.1, 0.4
"""Time constants [s] of the mean squares that are compared with the largest and with the least that is plausible."""
LASTING = 2.0
"""Weight of the longer mean square: a load or a reversal that the model does not know is soon over."""
MISSING = 2.0
"""Evidence that a sensor gives which shows nothing, where the others do not tell the state."""
AGREES = 0.5
"""Share of the largest mean square within which a sensor that was left out agrees with the estimate again."""
BLAMELESS = 3.0
"""Time [s] for which the other sensors must have been beyond doubt before one is left out: where two contradict the
model at once, it is more likely that the model or an actuator is wrong. One after the other may well fail."""
SUDDEN = 2.0
"""Multiple of the largest mean square that is still plausible, by which a first suspicious reading has jumped: what an
actuator does shows in a sensor by and by. Found by trial on rehearsed faults."""
STILL = 0.05
"""Share of the variance that differences of white noise have, below which a sensor is frozen."""
ENOUGH = 20
"""Readings that this takes at least. Of white noise, one in 17 million runs of 20 is as still, but one in 260 of 5."""
BLIND = 1e15
"""Factor on the deviation of a sensor's noise that makes it tell nothing."""


def spare_sensors(system: System, tuning: Tuning, *, step: float) -> NDArray[np.bool_]:
    """Which outputs (outputs,) can be left out because the others tell the state without them."""
    tuning = tuning.checked(system)
    noise = tuning.measurement_noise

    def is_spare(k: int) -> bool:
        if len(noise) + len(tuning.channels) == 1:
            return False
        without = tuple(BLIND * value if j == k else value for j, value in enumerate(noise))
        try:
            check_observable(system, replace(tuning, measurement_noise=without), step=step)
        except UserError:
            return False
        return True

    return np.array([is_spare(k) for k in range(len(noise))])


class FrozenSensorDetector:
    """Detects a sensor that stays at a number, or dithers about it by less than its noise does.

    The mean square of the differences of ``after`` readings, or of ENOUGH, is 2 s^2 for white noise of deviation s,
    whatever moves slowly beneath it; a frozen sensor is below STILL times that.
    """

    def __init__(self, noise: float, *, after: int) -> None:
        """noise: its deviation, 0 where the sensor has none that would tell. after: readings, 0: never."""
        after = max(after, ENOUGH) if after else 0
        self.count = 0
        """Readings that were found frozen."""
        self._least = STILL * 2.0 * noise**2 * after
        self._squares, self._last = deque[float](maxlen=after), math.nan

    def is_frozen(self, reading: float) -> bool:
        """Whether this reading and those before it have been too still for too long."""
        square, self._last = (reading - self._last) ** 2, reading
        if not square < math.inf:
            self._squares.clear()
            return False
        self._squares.append(square)
        full = 0 < len(self._squares) == self._squares.maxlen
        found = self._least > 0.0 and full and sum(self._squares) <= self._least
        self.count += found
        return found


class SensorMonitor:
    """Judges each sensor by its normalised innovations, whose mean square is 1 where model and noise are right.

    Evidence against a sensor is r = max(m / largest, LASTING M / largest, least / M), of the mean squares m over
    AVERAGE and M over LONG_AVERAGE, and its suspicion grows as :class:`~.suspicion.Suspicion` says. A sensor under
    suspicion for ``leave_after`` is left out where the others tell the state and were beyond doubt themselves, and
    comes back when it has agreed with the estimate for as long, or by :meth:`readmit`.

    left_out: which sensors are left out now (outputs,). counts: how often each was. away: which jumped off what was
    expected, and not back: these lie, even where an estimate that believes them explains the others, too.
    """

    def __init__(
        self,
        spare: Sequence[bool] | NDArray[np.bool_],
        noise: Sequence[float],
        *,
        largest: Sequence[float],
        least: Sequence[float],
        leave_after: float,
        timeout: float,
        covered: Sequence[bool] = (),
    ) -> None:
        """spare: see :func:`spare_sensors`. noise: deviation of each sensor with its hum [output unit]. largest,
        least (outputs,): mean squares that are still plausible; least 0: none is too small. leave_after, timeout [s]:
        of suspicion, and without a reading after which a sensor counts as missing. covered: outputs that a further
        channel shows, too.
        """
        count = len(noise)
        self._covered = list(covered) or [False] * count
        self.left_out, self.counts, self.away = [False] * count, [0] * count, [False] * count
        self._beside = [(math.nan, math.nan)] * count
        self._spare, self._noise = list(map(bool, spare)), list(noise)
        self._largest, self._least = list(largest), list(least)
        self._leave_after, self._timeout = leave_after, timeout
        self._suspicion = [Suspicion(2.0 * leave_after) for _ in noise]
        self._silent, self._blamed = [0.0] * count, [BLAMELESS] * count
        self.renew()
        self.evidence = [0.0] * count
        """r of each sensor that is used."""

    def renew(self) -> None:
        """Forget the innovations of an estimate that has begun anew."""
        count = len(self._noise)
        self._mean, self._long, self._large = [1.0] * count, [1.0] * count, [0.0] * count

    def screen(self, outputs: Array) -> None:
        """Take the readings of the sensors that are left out from outputs (outputs,), in place."""
        for k, out in enumerate(self.left_out):
            if out:
                outputs[k] = math.nan

    def judge(self, readings: Array, normalised: Array, expected: Array | None, elapsed: float) -> None:
        """Take in an update after ``elapsed`` [s]: readings (outputs,), NaN where there is none, the parts (outputs,)
        of the normalised innovation, and, where a sensor is left out, what the estimate expects (outputs,).
        """
        for k, out in enumerate(self.left_out):
            reading = float(readings[k])
            self._silent[k] = self._silent[k] + elapsed if math.isnan(reading) else 0.0
            self._blamed[k] += elapsed
            if out:
                self._compare(k, reading, math.nan if expected is None else float(expected[k]), elapsed)
            else:
                if self._suspicion[k].seconds == 0.0:
                    self.away[k] = float(normalised[k]) > SUDDEN * self._largest[k]
                self.evidence[k] = r = self._evidence(k, float(normalised[k]), elapsed)
                if self._suspicion[k].add(r, elapsed) > 0.0 and r > 1.0:
                    self._blamed[k] = 0.0
        if any(self.left_out) and self._is_vain():
            self.readmit()
            # The model or an actuator is to blame: none is left out for a while.
            self._blamed = [0.0] * len(self._blamed)
        worst = max(range(len(self.evidence)), key=lambda k: self._suspicion[k].seconds if self._spare[k] else -1.0)
        if self._suspicion[worst].seconds >= self._leave_after and self._may_leave(worst):
            self.left_out[worst], self.evidence[worst] = True, 0.0
            self._mean[worst], self._beside[worst] = CLEAREST * self._largest[worst], (math.nan, math.nan)
            self.counts[worst] += 1

    def _evidence(self, k: int, square: float, elapsed: float) -> float:
        if self.is_missing(k):
            return MISSING if not self._spare[k] else 0.0
        if math.isfinite(square):
            square = min(square, CLEAREST * self._largest[k])  # so that one wild reading is no evidence
            self._mean[k] += min(elapsed / AVERAGE, 1.0) * (square - self._mean[k])
            square = min(square, LASTING * self._largest[k])  # so that it is forgotten soon
            self._long[k] += min(elapsed / LONG_AVERAGE, 1.0) * (square - self._long[k])
        large = self._large[k] = max(self._mean[k], LASTING * self._long[k]) / self._largest[k]
        small = self._least[k] / self._long[k] if self._long[k] > 0.0 else CLEAREST * (self._least[k] > 0.0)
        return max(large, small)

    def _compare(self, k: int, reading: float, expected: float, elapsed: float) -> None:
        """Let a sensor back that agrees with the estimate."""
        most = CLEAREST * self._largest[k]
        moved, came = reading - self._beside[k][0], reading - expected - self._beside[k][1]
        self._beside[k] = reading, reading - expected
        back = min(abs(moved), abs(came)) > self._noise[k] * math.sqrt(2.0 * self._largest[k])
        self.away[k] &= not back and not self.is_missing(k)
        square = min(((reading - expected) / self._noise[k]) ** 2, most)
        if math.isfinite(square):
            self._mean[k] += min(elapsed / AVERAGE, 1.0) * (square - self._mean[k])
        agrees = math.isfinite(square) and self._mean[k] < AGREES * self._largest[k]
        if self._suspicion[k].add(0.0 if agrees else CLEAREST, elapsed) == 0.0:
            self._admit(k)

    def readmit(self) -> None:
        """Use all sensors again."""
        for k, out in enumerate(self.left_out):
            if out:
                self._admit(k)

    def _admit(self, k: int) -> None:
        self.left_out[k], self._suspicion[k].seconds = False, 0.0
        self._mean[k], self._long[k], self._large[k] = 1.0, 1.0, 0.0

    def _is_vain(self) -> bool:
        """Whether a sensor that is used contradicts the model as long as it may: then it was wrong to leave another one
        out, and the model or an actuator is.
        """
        used = (k for k, out in enumerate(self.left_out) if not out)
        return any(self._large[k] > 1.0 and self._suspicion[k].seconds >= 2.0 * self._leave_after for k in used)

    def _may_leave(self, k: int) -> bool:
        others = [j for j in range(len(self._spare)) if j != k]
        return (
            self._spare[k]
            and not self.left_out[k]
            and all(self._blamed[j] >= BLAMELESS and not self.left_out[j] and not self.is_missing(j) for j in others)
        )

    def is_missing(self, k: int) -> bool:
        """Whether a sensor has shown nothing for too long."""
        return self._silent[k] > self._timeout

    @property
    def without(self) -> int:
        """How many sensors the estimate has to do without now."""
        lacking = [out or self.is_missing(k) for k, out in enumerate(self.left_out)]
        return sum(lack and not covered for lack, covered in zip(lacking, self._covered, strict=True))

    @property
    def is_contradicted(self) -> bool:
        """Whether innovations are too large, not only too small, which leads no estimate astray."""
        return any(r > 1.0 and not out for r, out in zip(self._large, self.left_out, strict=True))

    @property
    def doubt(self) -> float:
        """The strongest evidence against the estimate, as a multiple of its threshold."""
        used = (r for r, out in zip(self.evidence, self.left_out, strict=True) if not out)
        return max(used, default=CLEAREST)

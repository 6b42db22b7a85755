"""Estimators: their measurements, checks of these, and estimates."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.estimation.belief import GATED, USED
from hybrid_sysid_ros.estimation.initialisation import LONGEST_GAP, LONGEST_STEP, Initialisation, memory_of
from hybrid_sysid_ros.estimation.measurement_sequence import BEGIN, FINE, LATE, LOOK, LOST, MEASURE
from hybrid_sysid_ros.estimation.observability import check_observable, offset_gains
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class StateEstimate:
    """The estimate after a measurement."""

    time: float
    """Time of the newest measurement [s]."""
    state: Array
    """State at that time, (states,)."""
    ahead: Array
    """State when the next command acts, after the longest input delay and the latency, (states,)."""
    disturbance: Array
    """Offset of each input [its unit] with which the given system fits best, (inputs,)."""
    parameters: Array
    """Followed parameters in the tuning's order, (followed,)."""
    covariance: Array
    """(size, size) of [states, disturbance, sine and cosine of each hum, parameters]."""
    innovation: Array
    """(outputs,) of the measurement just given; NaN where an output was not measured."""
    normalised_innovation: float
    """e' V^-1 e of it: in the mean as much as there are values. NaN where there are none."""
    normalised: Array
    """(outputs,): the part of each output in that sum, in the mean 1; NaN where an output was not measured."""


@dataclass(kw_only=True)
class Counters:
    """Counters of an estimator; a measurement of two outputs has two values."""

    updates: int = 0
    """Number of values used."""
    delayed: int = 0
    """Number of used values that were older than the newest measurement, and inserted at their times."""
    late: int = 0
    """Number of stamps that were too old for that or repeated, and ignored."""
    missing: int = 0
    """Number of measurements that are missing by a gap in the stamps."""
    invalid: int = 0
    """Values that are NaN or infinite; not used."""
    unknown_inputs: int = 0
    """Inputs that are no numbers; in their place the last known ones hold."""
    gated: int = 0
    """Number of outliers by the innovation test, which are not used."""
    resets: int = 0
    """Number of re-initialisations after a run of outliers or a long gap."""


class Estimator(ABC):
    """States z = [x, d, hums, theta]: the system's states, an offset of each input, a hum of each output that has one,
    as a sine of known frequency, and the followed parameters.

        z+ = [step(x, u + d; theta), d, rotation(2 pi f dt) (s, c), theta] + noise,   y = h(x, u + d; theta) + s + r

    Outputs and the tuning's further channels may come out of order, within the tuning's window: the estimator goes back
    to the moment before and plays the rest again, so that the answer is that of the right order. Older ones are
    ignored, missing ones and NaN predicted over, outliers gated; each is counted. After a run of outliers a sensor
    wins, unless another one that was believed meanwhile contradicts it. All state stays in preallocated arrays.
    """

    windowed: ClassVar[bool] = False
    """Whether the method optimises over a window of moments."""
    _run: ClassVar[Callable[..., int]]
    """The kernel of the method: (memory, task, time, since, first, given, applied, out, P) -> what became of it.

    MEASURE: values ``given`` of the channels from ``first`` on, at ``time`` [s], with the mean inputs ``applied`` from
    ``since`` to there where that is earlier. BEGIN: forget what was before the moment ``first``, whose belief is
    written, and bring the others up to date. All write ``out`` and ``P``: see :func:`~.measurement_sequence.answer`.
    """

    def __init__(
        self, system: System, tuning: Tuning, *, period: float, latency: float = 0.0, step: float = LONGEST_STEP
    ) -> None:
        """period: of the measurements [s]. latency: from a measurement to its command at the rig [s]. step: longest one
        of a prediction [s].

        Raises UserError where no estimator can be made of these.
        """
        tuning = tuning.checked(system)
        if system.sampling_time is not None:
            steps = round(period / system.sampling_time)
            if steps < 1 or abs(period - steps * system.sampling_time) > 1e-9 or tuning.channels:
                raise UserError(
                    f"{type(system).__name__} steps by {system.sampling_time:g} s: measurements must come whole steps "
                    f"apart, not {period:g} s (set the estimator's rate), and from no further channels"
                )
            self._window, step = 0.0, system.sampling_time
        else:
            self._window = self._window_of(tuning, period)
        check_observable(system, tuning, step=step)
        self._offsets = offset_gains(system, tuning, step=step)
        self.system = system
        self.tuning = tuning
        self.period = period
        self.counters = Counters()
        lead = system.delay + latency
        self._memory, self._arrays = memory_of(
            system, tuning, period=period, step=step, span=self._window, lead=lead, windowed=self.windowed
        )
        self._given = tuple(self._memory)
        n, m, p = len(system.states), len(system.inputs), len(system.outputs)
        self._initialisation = Initialisation(system=system, tuning=tuning, memory=self._memory, arrays=self._arrays)
        named = system.named
        self._as_given = np.array([named[name] for name in tuning.followed])
        self._channels = {name: p + k for k, name in enumerate(tuning.channels)}
        self._size = len(self._arrays["start"])
        self._parts = np.cumsum([n, n, m, len(tuning.followed), p, 1, p]).tolist()
        self._outputs, self._applied, self._value = np.empty(p), np.empty(m), np.empty(1)
        self.reset()

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the covariance's rows, with units, (size,)."""
        system, channels = self.system, self._memory.channels
        hums = [item for item, hum in zip(system.outputs, channels["hum"], strict=False) if hum >= 0]
        units = {item.name: item.unit for item in system.parameters}
        return (
            *(str(item) for item in system.states),
            *(f"offset of {item}" for item in system.inputs),
            *(f"{part} of hum of {item}" for item in hums for part in ("sine", "cosine")),
            *(f"{name} [{units[name]}]" for name in self.tuning.followed),
        )

    def _window_of(self, tuning: Tuning, period: float) -> float:
        """Largest age [s] of a measurement that is still used."""
        return tuning.window

    def reset(self) -> None:
        """Forget everything; the next valid measurement initialises the estimator."""
        self._started = False
        self._last = self._newest = math.nan
        self._arrays["applied"][:] = 0.0

    def loosen(self) -> None:
        """Doubt the newest estimate as much as a first one, for a sensor that lied has a part in it; its mean stays."""
        row = self._memory.moments["row"][self._memory.core["count"][0] - 1]
        root = self._arrays["roots"][row]
        root[:] = np.diag(np.hypot(np.linalg.norm(root, axis=1), self._arrays["start"]))

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """Measured outputs (outputs,) at ``time`` [s], NaN where one is missing, and the mean inputs (inputs,) since
        the measurement before.

        Raises UserError where there is nothing to hold on to yet and no output is a number, for a stamp that is none,
        and for another number of outputs or inputs.
        """
        if len(outputs) != len(self._outputs) or len(applied) != len(self._applied):
            raise UserError(
                f"estimator: {len(outputs)} outputs and {len(applied)} inputs were given: {type(self.system).__name__} "
                f"has {len(self._outputs)} and {len(self._applied)}"
            )
        self._outputs[:], self._applied[:] = outputs, applied
        time = float(time)
        elapsed = time - self._last
        if 0.0 < elapsed < 1.5 * self.period:
            since, self._last = self._last, time
            return self._take(time, since, 0, self._outputs)
        return self._update_oddly(time, elapsed)

    def update_ungated(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """The same without the gate: no innovation is too large, so that all of them are linear in what acts."""
        core = self._memory.core[0]
        core["gate"] = math.inf
        try:
            return self.update(time, outputs, applied)
        finally:
            core["gate"] = self.tuning.gate

    def _update_oddly(self, time: float, elapsed: float) -> StateEstimate:
        """Update with the first measurement, one after a gap, or one that is late."""
        valid = np.isfinite(self._outputs)
        if not math.isfinite(time):
            raise UserError(f"estimator: a measurement is stamped {time}; stamps are seconds")
        if not self._started:
            if not np.any(valid):
                self.counters.invalid += len(valid)
                raise UserError(f"estimator: the first measurement (t = {time:g} s) is not a number; check the sensor")
            self.counters.updates += int(valid.sum())
            self.counters.invalid += int((~valid).sum())
            return self._start(time, 0, self._outputs)
        if math.isnan(elapsed):  # only a further channel has reported something
            since, self._last = float(self._memory.inputs[-1, 0]), time
            return self._take(time, min(since, time), 0, self._outputs)
        if not elapsed > 0.0:
            if not np.any(valid):
                self.counters.invalid += len(valid)
                return self._look()
            return self._take(time, time, 0, self._outputs)
        if elapsed > LONGEST_GAP and not np.any(valid):
            # Nothing to start from and, a clock may have jumped, years to predict over: wait for a number.
            self.counters.invalid += len(valid)
            return self._look()
        self.counters.missing += max(round(elapsed / self.period) - 1, 0)
        if elapsed > LONGEST_GAP:
            self.counters.resets += 1
            return self._start(time, 0, self._outputs)
        since, self._last = self._last, time
        return self._take(time, since, 0, self._outputs)

    def correct(self, time: float, value: float, channel: str) -> StateEstimate:
        """A measurement of a further channel at ``time`` [s], the moment that it is of, in whatever order it comes.

        Further than the window from the newest measurement it is ignored (late). The first one of all starts the
        estimator. Raises UserError where there is no such channel, or nothing to hold on to yet and no number.
        """
        if channel not in self._channels:
            known = ", ".join(self._channels) or "none"
            raise UserError(f"estimator: no channel {channel}: known are {known}")
        first = self._channels[channel]
        self._value[0], time = value, float(time)
        valid = math.isfinite(value)
        if not self._started:
            if not (valid and math.isfinite(time)):
                self.counters.invalid += 1
                raise UserError(f"estimator: the first measurement, of channel {channel}, is not a number")
            self.counters.updates += 1
            self._applied[:] = 0.0
            return self._start(time, first, self._value)
        if not time <= self._newest + self._window:
            self.counters.late += 1
            return self._look()
        if not valid and time <= self._newest:
            self.counters.invalid += 1
            return self._look()
        return self._take(time, time, first, self._value)

    def _take(self, time: float, since: float, first: int, given: Array) -> StateEstimate:
        """Values of the channels from ``first`` on in their place; ``applied`` counts where ``since`` is before."""
        out, P = np.empty(self._parts[-1]), np.empty((self._size, self._size))
        code = self._run(self._given, MEASURE, time, since, first, given, self._applied, out, P)
        delayed = bool(time <= self._newest)
        if not delayed:
            self._newest = time
        if code == FINE:
            self.counters.updates += len(given)
            if delayed:
                self.counters.delayed += len(given)
            return self._estimate(out, P)
        if code == LATE:
            self.counters.late += 1
            return self._estimate(out, P)
        if code == LOST:
            # Numbers that no rig has were given, as an input of 1e300, and nothing is left but the last measurement.
            self.counters.resets += 1
            self._applied[:] = 0.0
            return self._start(max(time, self._newest), 0, self._initialisation.last_outputs())
        return self._sort_out(first, given, delayed, out, P)

    def _sort_out(self, first: int, given: Array, delayed: bool, out: Array, P: Array) -> StateEstimate:
        """Count unused values, and begin again where a sensor has been an outlier for too long."""
        core, counters = self._memory.core[0], self.counters
        index = int(core["at"])
        readings = self._memory.readings[self._memory.moments["row"][index], first : first + len(given)]
        fates, valid = readings["fate"], np.isfinite(given)
        used = int((valid & (fates == USED)).sum())
        counters.updates += used
        counters.delayed += used * delayed
        counters.invalid += int((~valid).sum())
        counters.unknown_inputs += int(core["wrong"])
        gated = valid & (fates == GATED)
        counters.gated += int(gated.sum())
        patience = self.tuning.patience
        lost = [first + k for k in np.flatnonzero(gated & (readings["outliers"] > patience)).tolist()]
        if not lost or not self._initialisation.again(index, lost):
            return self._estimate(out, P)
        counters.resets += 1
        shown = out[self._parts[3] :].copy()
        self._run(self._given, BEGIN, 0.0, 0.0, index, given, self._applied, out, P)
        out[self._parts[3] :] = shown
        return self._estimate(out, P)

    def _look(self, task: int = LOOK) -> StateEstimate:
        """The current or the initial estimate."""
        out, P = np.empty(self._parts[-1]), np.empty((self._size, self._size))
        self._run(self._given, task, 0.0, 0.0, 0, self._outputs, self._applied, out, P)
        return self._estimate(out, P)

    def _estimate(self, out: Array, P: Array) -> StateEstimate:
        a, b, c, d, e, f, _ = self._parts
        disturbance, parameters = out[b:c], out[c:d]
        if self._offsets is not None:
            disturbance = disturbance + (parameters - self._as_given) @ self._offsets
        return StateEstimate(
            time=self._newest,
            state=out[:a],
            ahead=out[a:b],
            disturbance=disturbance,
            parameters=parameters,
            covariance=P,
            innovation=out[d:e],
            normalised_innovation=float(out[e]),
            normalised=out[f:],
        )

    def _start(self, time: float, first: int, values: Array) -> StateEstimate:
        """Begin with values of the channels from ``first`` on, without other knowledge."""
        self._initialisation.fresh(time, self._applied, first, values)
        self._newest, self._started = time, True
        self._last = time if first == 0 else math.nan
        return self._look(BEGIN)

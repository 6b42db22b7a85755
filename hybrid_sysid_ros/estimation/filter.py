"""What all estimators share: what they are told, what may be wrong with it, and what they answer."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Recurrence, System
from hybrid_sysid_ros.estimation.augmented import offset_gains
from hybrid_sysid_ros.estimation.estimate import Counters, Estimate
from hybrid_sysid_ros.estimation.kernels import LATE, LOST, Kernels
from hybrid_sysid_ros.estimation.memory import GATED, LONGEST_GAP, MAIN, NONE, RESET, USED, memory_of
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]


class Filter(ABC):
    """States z = [x, d, s, c, theta]: the model's state, an input disturbance, a hum s that turns with its own
    frequency, and the followed parameters.

        z+ = [step(x, u + d; theta), d, rotation(w dt) (s, c), theta] + noise
        y = H z + r, H = [output row, 0, 1, 0, 0] for the main channel, [row of the state, 0...] for the others

    Measurements may come out of order, within the tuning's window: the estimator goes back to the node before and
    plays the rest again, so that the answer is that of the right order. Older ones are ignored, missing ones and NaN
    predicted over, outliers gated; each is counted. The estimate also carries the state after the model's input delay
    and ``latency``, the one that the next command meets. All state stays in compiled code's preallocated arrays.
    """

    windowed: ClassVar[bool] = False
    """Whether the method optimises over a window of nodes."""

    def __init__(self, system: System, tuning: Tuning, *, period: float, latency: float = 0.0) -> None:
        """period: of the measurements [s]. latency: from a measurement to its command at the rig [s].

        Raises UserError where no estimator can be made of these.
        """
        tuning.check(system)
        if isinstance(system, Recurrence):
            if abs(period - system.period) > 1e-9 or tuning.channels:
                raise UserError(
                    f"{type(system).__name__} steps by {system.period:g} s: give it one measurement for each step"
                )
            self._window = 0.0
        else:
            self._window = self.window_of(tuning, period)
        self.system = system
        self.tuning = tuning
        self.period = period
        self.counters = Counters()
        self._channels = {name: MAIN + 1 + k for k, name in enumerate(tuning.channels)}
        self._lead = system.delay + latency
        self._states = len(system.states)
        self._size = self._states + 3 + len(tuning.followed)
        self._offsets = offset_gains(system, tuning)
        self._memory = memory_of(system, tuning, period=period, span=self._window, window=self.windowed)
        self._kernels = self.kernels(system)
        self.reset()

    @abstractmethod
    def kernels(self, system: System) -> Kernels:
        """The compiled code of the method."""

    def window_of(self, tuning: Tuning, period: float) -> float:
        """How far back [s] a measurement may lie that is still used."""
        return tuning.window

    def reset(self) -> None:
        """Forget everything; the next valid measurement starts afresh."""
        self._started = False
        self._applied = self._output = 0.0

    def _start(self, time: float, output: float, applied: float) -> Estimate:
        self._kernels.begin(*self._memory, time, output, applied)
        self._newest = self._last = time
        self._started = True
        return self._estimate(None, 0.0, 0.0)

    def update(self, time: float, output: Array, applied: Array) -> Estimate:
        """One measurement (outputs,) at ``time`` [s] with the mean input (inputs,) since the one before.

        Raises UserError when the very first measurement is not a number: there is nothing to hold on to yet; and when
        the stamp is not a number.
        """
        y, u = float(output[0]), float(applied[0])
        valid = math.isfinite(y)
        if not math.isfinite(time):
            raise UserError(f"estimator: a measurement is stamped {time}; stamps are seconds")
        if math.isfinite(u):
            self._applied = u
        else:
            self.counters.invalid += 1
            u = self._applied
        if valid:
            self._output = y
        if not self._started:
            if not valid:
                self.counters.invalid += 1
                raise UserError(f"estimator: the first measurement (t = {time:g} s) is not a number; check the sensor")
            self.counters.updates += 1
            return self._start(time, y, u)
        elapsed = time - self._last
        if not elapsed > 0.0:
            return self._absorb(time, y, MAIN, time, math.nan)
        if elapsed > LONGEST_GAP and not valid:
            # Nothing to start from and, a clock may have jumped, years to predict over: wait for a number.
            self.counters.invalid += 1
            return self._estimate()
        self.counters.missing += max(round(elapsed / self.period) - 1, 0)
        if elapsed > LONGEST_GAP:
            self.counters.resets += 1
            return self._start(time, y, u)
        since, self._last = self._last, time
        return self._absorb(time, y, MAIN, since, u)

    def correct(self, time: float, value: float, channel: str) -> Estimate:
        """A measurement of a further channel at ``time`` [s], the moment that it is of, in whatever order it comes.

        Before the first :meth:`update`, and further than the window from the newest measurement, it is ignored (late).

        Raises:
            UserError: there is no such channel, or nothing yet to correct.
        """
        if channel not in self._channels:
            known = ", ".join(self._channels) or "none"
            raise UserError(f"estimator: no channel {channel}: known are {known}")
        if not self._started:
            raise UserError(f"estimator: channel {channel} has a measurement before the main sensor's first")
        if not time <= self._newest + self._window:
            self.counters.late += 1
            return self._estimate()
        return self._absorb(time, float(value), self._channels[channel], time, math.nan)

    def _absorb(self, time: float, value: float, channel: int, since: float, applied: float) -> Estimate:
        """A measurement in its place, and everything after ``since`` again."""
        valid, delayed = math.isfinite(value), time <= self._newest
        if not valid:
            self.counters.invalid += 1
            channel = NONE
        if applied != applied and delayed and not (valid and time >= self._newest - self._window):
            self.counters.late += valid
            return self._estimate()
        answer = self._answer()
        index = self._kernels.absorb(*self._memory, time, value, channel, since, applied, self._lead, *answer)
        self._newest = max(self._newest, time)
        if index == LOST:
            return self._recover(time)
        if index == LATE:
            self.counters.late += 1
            return self._estimate(answer)
        node = self._memory.nodes[index]
        fate = node["fate"]
        if fate == USED:
            self.counters.updates += 1
            self.counters.delayed += delayed
        elif fate >= GATED:
            self.counters.gated += 1
            self.counters.resets += int(fate == RESET)
        return self._estimate(answer, float(node["innovation"]), float(node["normalised"]))

    def _recover(self, time: float) -> Estimate:
        """Numbers that no rig has were given, as an input of 1e300 V, and nothing is left but the last measurement."""
        self.counters.resets += 1
        return self._start(max(time, self._newest), self._output, 0.0)

    def _answer(self) -> tuple[Array, Array]:
        """Where the compiled code writes the state ahead and the covariance."""
        return np.empty(self._states), np.empty((self._size, self._size))

    def _estimate(
        self, answer: tuple[Array, Array] | None = None, innovation: float = math.nan, normalised: float = math.nan
    ) -> Estimate:
        count, memory = self._states, self._memory
        if answer is None:
            answer = self._answer()
            self._kernels.answer(*memory, self._lead, *answer)
        z = memory.nodes["mean"][memory.core["count"][0] - 1].copy()
        disturbance, parameters = z[count : count + 1], z[count + 3 :]
        if self._offsets is not None:
            disturbance = disturbance + self._offsets @ (parameters - memory.core["given"][0, : len(parameters)])
        return Estimate(
            time=self._newest,
            state=z[:count],
            ahead=answer[0],
            disturbance=disturbance,
            parameters=parameters,
            covariance=answer[1],
            innovation=np.array([innovation]),
            normalised_innovation=normalised,
        )

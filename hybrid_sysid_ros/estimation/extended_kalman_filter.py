"""Extended Kalman filter on any model, with an input disturbance and the sensor's hum as states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.equations import Equation, kernels
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.estimation.estimate import Counters, Estimate
from hybrid_sysid_ros.estimation.history import InputHistory

Array = NDArray[np.float64]

LONGEST_STEP = 0.005
"""Longest integration step of a prediction [s]; the models are identified at this step or a shorter one."""

LONGEST_GAP = 1.0
"""Time without a measurement [s] over which a prediction is worth less than starting from the next measurement."""

HUM_OBSERVABLE = 0.1
"""Smallest |sin(pi f T)| at which a hum of f looks different from a position when sampled every T."""


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """measurement_noise: deviation of one measurement without hum [output unit]. process_noise: deviation of each state
    after one second [state unit / sqrt(s)], velocities dominate. disturbance_noise: the same of the input disturbance
    [drive unit / sqrt(s)], disturbance_limit: its bound. hum_hertz, hum_amplitude: a sine of known frequency in the
    sensor [Hz, output unit], 0 for none; hum_noise: its drift [output unit / sqrt(s)]. gate: largest normalised squared
    innovation of a measurement that is believed. patience: outliers in a row after which the measurement wins.
    """

    measurement_noise: float
    process_noise: tuple[float, ...]
    disturbance_noise: float
    disturbance_limit: float
    hum_hertz: float
    hum_amplitude: float
    hum_noise: float
    gate: float
    patience: int


class ExtendedKalmanFilter:
    """States z = [x, d, s, c]: the model's state, the input disturbance, and a hum s that turns with its own frequency.

        prediction   x+ = step(x, u + d), d+ = d, (s, c)+ = rotation(w dt) (s, c);  P+ = F P F' + Q dt
        correction   y = H z + r, H = [output rows, 0, 1, 0];  K = P H' / S;  z += K (y - H z)
        Joseph form  P = (I - K H) P (I - K H)' + K R K', which stays symmetric and positive

    F is the forward-difference Jacobian of the compiled step. Source: Sarkka (2013), Bayesian Filtering and Smoothing,
    algorithm 5.4; the Joseph form: Bar-Shalom, Li, Kirubarajan (2001), eq. (5.2.3-18).

    Measurements may be late (ignored), missing (predicted over), NaN (predicted over) or outliers (gated); each is
    counted. The estimate also carries the state after the model's input delay and ``latency``, the one that the next
    command meets.
    """

    def __init__(self, equation: Equation, tuning: Tuning, *, period: float, latency: float = 0.0) -> None:
        """period: of the measurements [s]. latency: from a measurement to its command at the rig [s]."""
        count = len(equation.states)
        if len(equation.outputs) != 1 or len(equation.inputs) != 1:
            raise UserError(f"{type(equation).__name__}: the filter takes one input and one output")
        if len(tuning.process_noise) != count:
            raise UserError(f"process_noise has {len(tuning.process_noise)} entries; the model has {count} states")
        self.equation = equation
        self.tuning = tuning
        self.period = period
        self.counters = Counters()
        self._lead = equation.delay + latency
        self._delay = equation.delay
        self._size = count + 3
        self._output_row = np.zeros(self._size)
        self._output_row[equation.outputs[0]] = 1.0
        # Sampled at a multiple of its period a hum looks like a position: then it can only count as noise.
        self._hum = tuning.hum_hertz > 0 and abs(np.sin(np.pi * tuning.hum_hertz * period)) > HUM_OBSERVABLE
        self._output_row[count + 1] = 1.0 if self._hum else 0.0
        self._noise = (
            tuning.measurement_noise if self._hum else np.hypot(tuning.measurement_noise, tuning.hum_amplitude)
        )
        hum = tuning.hum_noise if self._hum else 0.0
        self._process = np.array([*tuning.process_noise, tuning.disturbance_noise, hum, hum]) ** 2
        self._predict = _compiled(equation)
        self._history = InputHistory(1)
        self._parameters = equation.named
        self._weights = equation.weights
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next valid measurement starts afresh."""
        self._started = False
        self._outliers = 0

    def _start(self, time: float, output: float, applied: float, disturbance: float = 0.0) -> None:
        count = len(self.equation.states)
        self._time = time
        self._state = np.zeros(self._size)
        self._state[self.equation.outputs[0]] = output
        self._state[count] = disturbance
        sigma = np.array([*self.tuning.process_noise, 0.0, 0.0, 0.0])
        sigma[self.equation.outputs[0]] = np.hypot(self.tuning.measurement_noise, self.tuning.hum_amplitude)
        sigma[count] = 10 * self.tuning.disturbance_noise
        sigma[count + 1 :] = self.tuning.hum_amplitude if self._hum else 0.0
        self._covariance = np.diag(sigma**2)
        self._history.reset(time, np.array([applied]))
        self._outliers = 0
        self._started = True

    def update(self, time: float, output: Array, applied: Array) -> Estimate:
        """One measurement (outputs,) at ``time`` [s] with the mean input (inputs,) since the one before.

        Raises UserError when the very first measurement is not a number: there is nothing to hold on to yet.
        """
        y, u = float(output[0]), float(applied[0])
        valid = bool(np.isfinite(y))
        if not np.isfinite(u):
            self.counters.invalid += 1
            u = float(self._history.mean(self._time - 1e-3, self._time)[0]) if self._started else 0.0
        if not self._started:
            if not valid:
                self.counters.invalid += 1
                raise UserError(f"estimator: the first measurement (t = {time:g} s) is not a number; check the sensor")
            self._start(time, y, u)
            self.counters.updates += 1
            return self._estimate(np.zeros(1), 0.0)
        elapsed = time - self._time
        if elapsed <= 0.0:
            self.counters.late += 1
            return self._estimate(np.full(1, np.nan), np.nan)
        if elapsed > LONGEST_GAP and not valid:
            # Nothing to start from and, a clock may have jumped, years to predict over: wait for a number.
            self.counters.invalid += 1
            return self._estimate(np.full(1, np.nan), np.nan)
        self.counters.missing += max(round(elapsed / self.period) - 1, 0)
        if elapsed > LONGEST_GAP:
            self.counters.resets += 1
            self._start(time, y, u)
            return self._estimate(np.zeros(1), 0.0)
        self._history.append(time, np.array([u]))
        self._propagate(time, elapsed)
        if not valid:
            self.counters.invalid += 1
            return self._estimate(np.full(1, np.nan), np.nan)
        return self._correct(time, y, u)

    def _propagate(self, time: float, elapsed: float) -> None:
        steps = max(1, int(np.ceil(elapsed / LONGEST_STEP - 1e-6)))
        h = elapsed / steps
        begin = time - elapsed - self._delay
        for k in range(steps):
            drive = self._history.mean(begin + k * h, begin + (k + 1) * h)
            self._predict(
                self._state,
                self._covariance,
                drive,
                h,
                2 * np.pi * self.tuning.hum_hertz * h,
                self._process,
                self._parameters,
                self._weights,
            )
        self._time = time

    def _correct(self, time: float, y: float, u: float) -> Estimate:
        row, covariance = self._output_row, self._covariance
        innovation = y - float(row @ self._state)
        noise = self._noise**2
        column = covariance @ row
        variance = float(row @ column) + noise
        normalised = innovation * innovation / variance
        if normalised > self.tuning.gate:
            self.counters.gated += 1
            self._outliers += 1
            if self._outliers > self.tuning.patience:
                self.counters.resets += 1
                self._start(time, y, u, float(self._state[len(self.equation.states)]))
            return self._estimate(np.array([innovation]), normalised)
        self._outliers = 0
        self.counters.updates += 1
        gain = column / variance
        self._state += gain * innovation
        limit = self.tuning.disturbance_limit
        index = len(self.equation.states)
        self._state[index] = min(max(self._state[index], -limit), limit)
        keep = np.eye(self._size) - np.outer(gain, row)
        self._covariance = keep @ covariance @ keep.T + noise * np.outer(gain, gain)
        return self._estimate(np.array([innovation]), normalised)

    def _estimate(self, innovation: Array, normalised: float) -> Estimate:
        count = len(self.equation.states)
        return Estimate(
            time=self._time,
            state=self._state[:count].copy(),
            ahead=self._ahead(),
            disturbance=self._state[count : count + 1].copy(),
            covariance=self._covariance.copy(),
            innovation=innovation,
            normalised_innovation=normalised,
        )

    def _ahead(self) -> Array:
        """The state after the delay: every input that acts until then is known already."""
        count = len(self.equation.states)
        x = self._state[:count].copy()
        if self._lead <= 0.0:
            return x
        following = np.empty(count)
        steps = max(1, int(np.ceil(self._lead / LONGEST_STEP - 1e-6)))
        h = self._lead / steps
        step = kernels(self.equation).step
        begin = self._time - self._delay
        for k in range(steps):
            drive = self._history.mean(begin + k * h, begin + (k + 1) * h) + self._state[count]
            step(x, drive, self._parameters, self._weights, h, following)
            x[:] = following
        return x


_PREDICTIONS: dict[tuple[Any, ...], Any] = {}


def _compiled(equation: Equation) -> Any:
    """The prediction of state and covariance, compiled once for each form of equation; works in place."""
    if equation.form in _PREDICTIONS:
        return _PREDICTIONS[equation.form]
    step = kernels(equation).step
    count = len(equation.states)

    def predict(
        z: Array, covariance: Array, drive: Array, h: float, turn: float, process: Array, p: Any, w: Array
    ) -> None:
        size = count + 3
        base, moved, x, u = np.empty(count), np.empty(count), np.empty(count), np.empty(1)
        u[0] = drive[0] + z[count]
        for i in range(count):
            x[i] = z[i]
        step(x, u, p, w, h, base)
        transition = np.zeros((size, size))
        for i in range(size):
            transition[i, i] = 1.0
        for i in range(count):
            difference = 1e-6
            x[i] += difference
            step(x, u, p, w, h, moved)
            x[i] = z[i]
            for j in range(count):
                transition[j, i] = (moved[j] - base[j]) / difference
        u[0] += 1e-5
        step(x, u, p, w, h, moved)
        for j in range(count):
            transition[j, count] = (moved[j] - base[j]) / 1e-5
        cosine, sine = np.cos(turn), np.sin(turn)
        transition[count + 1, count + 1] = cosine
        transition[count + 1, count + 2] = sine
        transition[count + 2, count + 1] = -sine
        transition[count + 2, count + 2] = cosine
        s, c = z[count + 1], z[count + 2]
        for i in range(count):
            z[i] = base[i]
        z[count + 1] = cosine * s + sine * c
        z[count + 2] = cosine * c - sine * s
        product = np.empty((size, size))
        for i in range(size):
            for j in range(size):
                total = 0.0
                for m in range(size):
                    total += transition[i, m] * covariance[m, j]
                product[i, j] = total
        for i in range(size):
            for j in range(size):
                total = process[i] * h if i == j else 0.0
                for m in range(size):
                    total += product[i, m] * transition[j, m]
                covariance[i, j] = total

    _PREDICTIONS[equation.form] = numba.njit(predict, error_model="numpy", nogil=True)
    return _PREDICTIONS[equation.form]

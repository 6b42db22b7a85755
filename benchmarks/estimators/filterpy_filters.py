"""filterpy's extended and unscented Kalman filter on the model that ours have, z = [x, d, s, c], by its own means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.rollout import advance
from hybrid_sysid_ros.estimation import Tuning
from hybrid_sysid_ros.support.arrays import Array

DIFFERENCE = 1e-6
SIGMA_POINTS = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}
"""The better ones here of these, which are ours, and those of filterpy's documentation (.1, 2, -1)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """state (states,), covariance (5, 5), normalised_innovation: as an estimate of ours has them."""

    state: Array
    covariance: Array
    normalised_innovation: float


class Augmented:
    """The model and the noise as filterpy asks for them, for a system of two states whose first is measured.

    Our compiled step is what it calls for each point; the inputs are delayed here, as it knows no delay.
    """

    def __init__(self, system: System, tuning: Tuning, *, period: float) -> None:
        self.period = period
        self.step, self.parameters, self.weights = compiled(system).step, system.values, system.weights
        drift = np.array([*tuning.process_noise, *tuning.disturbance_noise, *tuning.hum_noise, *tuning.hum_noise])
        self.process = period * np.diag(drift**2)
        self.start = 100.0 * np.diag(drift**2)
        self.start[0, 0] = tuning.measurement_noise[0] ** 2 + tuning.hum_amplitude[0] ** 2
        self.start[3, 3] = self.start[4, 4] = tuning.hum_amplitude[0] ** 2
        self.measurement = np.array([[tuning.measurement_noise[0] ** 2]])
        self.push = tuning.input_noise[0] / np.sqrt(period)
        self.row = np.array([[1.0, 0.0, 0.0, 1.0, 0.0]])
        angle = 2.0 * np.pi * tuning.hum_hertz[0] * period
        self.turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        whole, self.part = divmod(system.delay / period, 1.0)
        self.past = [0.0] * (int(whole) + 2)

    def begin(self, filter: Any, output: Array, applied: Array) -> None:
        """Start ``filter`` from the first measurement."""
        filter.x = np.array([output[0], 0.0, 0.0, 0.0, 0.0])
        filter.P, filter.R = self.start.copy(), self.measurement
        self.past[:] = [float(applied[0])] * len(self.past)

    def delayed(self, applied: Array) -> float:
        """The mean input that acts over the interval whose own is ``applied``."""
        self.past = [float(applied[0]), *self.past[:-1]]
        return (1.0 - self.part) * self.past[-2] + self.part * self.past[-1]

    def advance(self, z: Array, period: float, drive: float) -> Array:
        """z+ = f(z, u)."""
        following = np.empty(5)
        u = np.array([drive + z[2]])
        advance(self.step, z[:2].copy(), u, self.parameters, self.weights, period, following[:2])
        following[2] = z[2]
        following[3:] = self.turn @ z[3:]
        return following

    def jacobian(self, z: Array, drive: float) -> Array:
        """dz+/dz by central differences, (5, 5)."""
        columns = []
        for direction in DIFFERENCE * np.eye(5):
            above, below = (self.advance(z + side * direction, self.period, drive) for side in (1.0, -1.0))
            columns.append((above - below) / (2.0 * DIFFERENCE))
        return np.column_stack(columns)

    def noise(self, jacobian: Array) -> Array:
        """Q dt + B B' U / dt, B the column of the input."""
        column = self.push * jacobian[:, 2:3] * (np.arange(5) < 2)[:, None]
        return self.process + column @ column.T


class Peer:
    """One of filterpy's filters behind the interface of ours."""

    filter: Any

    def __init__(self, system: System, tuning: Tuning, *, period: float) -> None:
        self.model = Augmented(system, tuning, period=period)
        self.started = False

    def step(self, drive: float, output: Array) -> None:
        """Predict and correct."""
        raise NotImplementedError

    def update(self, time: float, output: Array, applied: Array) -> Answer:
        """A measurement (1,), and the mean input (1,) since the one before."""
        filter, square = self.filter, np.nan
        if self.started:
            self.step(self.model.delayed(applied), output)
            square = float(filter.y[0] ** 2 * filter.SI[0, 0])
        else:
            self.model.begin(filter, output, applied)
            self.started = True
        return Answer(state=filter.x[:2], covariance=filter.P, normalised_innovation=square)


class Extended(Peer):
    """filterpy.kalman.ExtendedKalmanFilter, its prediction given as its documentation says."""

    def __init__(self, system: System, tuning: Tuning, *, period: float) -> None:
        super().__init__(system, tuning, period=period)
        self.filter = ExtendedKalmanFilter(dim_x=5, dim_z=1)
        self.filter.predict_x = self.advance

    def advance(self, u: float = 0.0) -> None:
        """In place of filterpy's linear prediction."""
        self.filter.x = self.model.advance(self.filter.x, self.model.period, u)

    def step(self, drive: float, output: Array) -> None:
        model, filter = self.model, self.filter
        filter.F = model.jacobian(filter.x, drive)
        filter.Q = model.noise(filter.F)
        filter.predict(u=drive)
        filter.update(output, lambda z: model.row, lambda z: model.row @ z)


class Unscented(Peer):
    """filterpy.kalman.UnscentedKalmanFilter with Merwe's scaled sigma points."""

    def __init__(self, system: System, tuning: Tuning, *, period: float) -> None:
        super().__init__(system, tuning, period=period)
        row, points = self.model.row, MerweScaledSigmaPoints(5, **SIGMA_POINTS)
        self.filter = UnscentedKalmanFilter(
            dim_x=5, dim_z=1, dt=period, hx=lambda z: row @ z, fx=self.model.advance, points=points
        )

    def step(self, drive: float, output: Array) -> None:
        model, filter = self.model, self.filter
        filter.Q = model.noise(model.jacobian(filter.x, drive))
        filter.predict(drive=drive)
        filter.update(output)


PEERS = {"filterpy EKF": Extended, "filterpy UKF": Unscented}

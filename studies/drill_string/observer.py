"""Stuck samples from what a driller has at the top: the extended Kalman filter, whose bit speed nobody measures.

Given are the top's speed and the torque at the bit. The bit's speed is read in the part that is learnt from, and to
judge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import curve_fit, lsq_linear

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar, absolute, clip, maximum, select, sign
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter, Tuning
from hybrid_sysid_ros.support.arrays import Array

PERIOD, STEP = 0.005, 0.0025
"""Of the measurements that the filter takes, and longest step of its prediction [s]."""
LATEST = 0.06
"""Largest delay of the torque that is tried [s]."""
SMOOTH = 0.005
"""Deviation of the Gaussian that the bit's speed is smoothed with before it is differentiated [s]."""
SLIDING = 0.5
"""Speed above which torque over speed tells the friction law [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class SlidingBit(System):
    """d' = wt - w,  J w' = k d + c (wt - w) - T,  T = [Tc + (Ts - Tc) exp(-(w / Vs)^2) + B] sgn w,  B' = -a B.

    wt: speed of the top, w of the bit; T: friction of the bit, which its brake measures; B: what the law lacks. A bit
    at rest shows the shaft's torque.
    """

    states = ("twist [rad]", "bit_speed [rad/s]", "brake [N m]")
    inputs = ("top_speed [rad/s]",)
    outputs = ("torque [N m]",)
    contacts = (Dry(on="bit_speed", level="level"),)

    inertia: float = bounded(0.01, 1e-4, 1.0, unit="kg m^2")
    """J, of the bit."""
    stiffness: float = bounded(4.0, 0.1, 10.0, unit="N m/rad")
    """k, of the shaft."""
    damping: float = bounded(0.01, 0.0, 1.0, unit="N m s/rad")
    """c, of the shaft."""
    coulomb: float = bounded(1.0, 0.0, 6.0, unit="N m")
    """Tc, at speed."""
    static_excess: float = bounded(1.0, 0.0, 6.0, unit="N m")
    """Ts - Tc, at rest above it."""
    stribeck_speed: float = bounded(10.0, 0.1, 60.0, unit="rad/s")
    """Vs."""
    fade: float = bounded(10.0, 0.0, 1000.0, unit="1/s")
    """a."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return u[0] - x[1], self.drive(x, u) / self.inertia, -self.fade * x[2]

    def drive(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Of the shaft on the bit [N m]."""
        return self.stiffness * x[0] + self.damping * (u[0] - x[1])

    def friction(self, x: Sequence[Scalar]) -> Scalar:
        """Largest one [N m]."""
        law = stribeck(x[1], self.coulomb, self.coulomb + self.static_excess, self.stribeck_speed)
        return maximum(law + x[2], 0.0)

    def level(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Friction level [rad/s^2]."""
        return self.friction(x) / self.inertia

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        most = self.friction(x)
        return (select(absolute(x[1]) > 0.0, most * sign(x[1]), clip(self.drive(x, u), -most, most)),)


@dataclass(frozen=True, kw_only=True)
class Balance:
    """T(t + delay) = k d + c d' - J w', by least squares over measured speeds and torque."""

    delay: float
    """Of the torque's channel behind those of the speeds [s]."""
    stiffness: float
    damping: float
    inertia: float
    explained: float
    """R2 of the torque."""


def balance(record: Record) -> Balance:
    """Of a record of top speed in, bit speed and torque out: of all delays up to LATEST the one that fits best."""
    period = record.sampling_time
    rows = _rows(record)
    found = []
    for late in range(round(LATEST / period) + 1):
        here, torque = rows[: len(rows) - late], record.output[late:, 1]
        solution = lsq_linear(here, torque, bounds=([0.0, 0.0, 0.0, -np.inf], np.inf)).x
        explained = 1.0 - float(np.var(here @ solution - torque) / np.var(torque))
        k, c, inertia, _ = solution.tolist()
        found.append(Balance(delay=late * period, stiffness=k, damping=c, inertia=inertia, explained=explained))
    return max(found, key=lambda item: item.explained)


def _rows(record: Record) -> Array:
    """[d, d', -w', 1], (samples, 4); what the twist was at first is the last one's."""
    period, bit = record.sampling_time, record.output[:, 0]
    twisting = record.input[:, 0] - bit
    rate = np.gradient(gaussian_filter1d(bit, SMOOTH / period), period)
    return np.column_stack([np.cumsum(twisting) * period, twisting, -rate, np.ones(len(bit))])


def aligned(record: Record, delay: float) -> Record:
    """The record with its torque earlier by the delay [s], and shorter by that."""
    late = round(delay / record.sampling_time)
    stop = len(record.time) - late
    output = np.column_stack([record.output[:stop, 0], record.output[late:, 1]])
    return replace(record, time=record.time[:stop], input=record.input[:stop], output=output)


def identified(record: Record) -> tuple[SlidingBit, Balance]:
    """The system of a record: the shaft and J from the balance, friction from torque over speed."""
    found = balance(record)
    speed, torque = aligned(record, found.delay).output.T
    slides = speed > SLIDING

    def law(w: Array, coulomb: float, excess: float, width: float) -> Array:
        return np.asarray(coulomb + excess * np.exp(-((w / width) ** 2)))

    start = SlidingBit()
    guess = start.coulomb, start.static_excess, start.stribeck_speed
    (coulomb, excess, width), _ = curve_fit(
        law, speed[slides], torque[slides], p0=guess, bounds=([0, 0, 0.1], [6, 6, 60])
    )
    system = SlidingBit(
        inertia=found.inertia,
        stiffness=found.stiffness,
        damping=found.damping,
        coulomb=float(coulomb),
        static_excess=float(excess),
        stribeck_speed=float(width),
    )
    return system, found


def estimated(system: SlidingBit, record: Record, tuning: Tuning) -> tuple[Array, Array]:
    """Speed of the bit, measured and as the filter has it from top speed and aligned torque alone, each PERIOD."""
    every = round(PERIOD / record.sampling_time)
    count = (len(record.time) - 1) // every
    top = record.input[: count * every].reshape(count, every, 1).mean(axis=1)
    torque = record.output[::every, 1:][: count + 1]
    follower = ExtendedKalmanFilter(system, tuning, period=PERIOD, step=STEP)
    applied = np.concatenate([top[:1], top])
    speeds = [
        follower.update(PERIOD * k, measured, given).state[1]
        for k, (measured, given) in enumerate(zip(torque, applied, strict=True))
    ]
    return record.output[::every, 0][: count + 1], np.array(speeds)

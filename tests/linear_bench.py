"""Records of a linear beam, simulated by its matrices, for tests of the identification."""

import numpy as np

from hybrid_sysid_ros.bags.record import Record


def record_of(inputs, outputs, period, name="bench"):
    return Record(name=name, time=period * np.arange(len(inputs)), input=inputs, output=outputs)


def held_levels(seed, samples, *, hold, low=-6.0, high=6.0):
    return np.random.default_rng(seed).uniform(low, high, samples // hold + 1).repeat(hold)[:samples, None]


def linear_run(values, u, x, h):
    """The linear model by matrices: semi-implicit Euler with trapezoidal damping and a delayed held input."""
    gain, centre, stiffness, damping, delay = values
    whole, part = divmod(delay / h, 1.0)
    shifted = [u[np.clip(np.arange(len(u)) - int(whole) - k, 0, None)] for k in (0, 1)]
    half = 0.5 * h * damping
    force = h * gain * ((1 - part) * shifted[0] + part * shifted[1] - centre) / (1 + half)
    velocity_row = np.array([-h * stiffness, 1 - half]) / (1 + half)
    matrix = np.array([np.array([1.0, 0.0]) + h * velocity_row, velocity_row])
    states = [x]
    for f in force:
        states.append(matrix @ states[-1] + f * np.array([h, 1.0]))
    return np.array(states)


def bench(samples=2001, period=0.005, name="bench", **changes):
    u = held_levels(0, samples, hold=40)
    y = linear_run(np.array([5.0, 0.0, 24.0, 22.0, 0.0]), u[:-1, 0], np.zeros(2), 0.005)[:, :1]
    return record_of(changes.get("u", u), changes.get("y", y), period, name=name)

"""Worlds that the project knows nothing of: eight simulated machines.

None has the equation that a rig of a record begins with. Each has a disturbance or a law that no record shows, a noisy
sensor, and a record for each kind of excitation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import butter, lfilter, sosfilt

from hybrid_sysid_ros.support.arrays import Array

KINDS = ("multisine", "steps", "sweep")
LINES = 25
"""Of a multisine."""


@dataclass(frozen=True, kw_only=True)
class World:
    """A machine: its answer to inputs at the samples, (samples, inputs) to (samples,), without the sensor."""

    period: float
    """Of the samples [s]."""
    samples: int
    lows: tuple[float, ...]
    """Of the inputs."""
    highs: tuple[float, ...]
    fastest: float
    """Frequency up to which the inputs move [Hz]."""
    noise: float
    """Deviation of the sensor, in the output's unit."""
    answer: Callable[[Array, float, np.random.Generator], Array]

    def record(self, kind: str, seed: int) -> Mapping[str, Array]:
        """Columns of a record: time, the inputs u0, u1 and so on, and y.

        kind: one of KINDS, of the first input; further inputs, such as the weather, are slow noise.
        """
        random = np.random.default_rng([seed, KINDS.index(kind)])
        time = np.arange(self.samples, dtype=np.float64) * self.period
        columns = [self._excitation(kind, time, random)]
        columns += [self._slow(random) for _ in self.lows[1:]]
        shares = zip(self.lows, self.highs, columns, strict=True)
        inputs = np.stack([low + (high - low) * share for low, high, share in shares], axis=1)
        clean = self.answer(inputs, self.period, random)
        measured = clean + self.noise * random.normal(size=self.samples)
        return {"time": time, **{f"u{k}": inputs[:, k] for k in range(inputs.shape[1])}, "y": measured}

    def _excitation(self, kind: str, time: Array, random: np.random.Generator) -> Array:
        """Values from 0 to 1."""
        if kind == "multisine":
            hertz = np.geomspace(2.0 / time[-1], self.fastest, LINES)
            waves = np.sin(2.0 * np.pi * (np.outer(time, hertz) + random.uniform(size=LINES))).sum(axis=1)
        elif kind == "sweep":
            low, length = 2.0 / time[-1], time[-1]
            rate = np.log(self.fastest / low) / length
            waves = np.sin(2.0 * np.pi * low * np.expm1(rate * time) / rate)
        else:
            waves, at = np.empty(len(time)), 0
            while at < len(time):
                held = int(random.uniform(0.5, 6.0) / (self.fastest * self.period)) + 1
                waves[at : at + held], at = random.uniform(), at + held
        return np.asarray((waves - waves.min()) / np.ptp(waves))

    def _slow(self, random: np.random.Generator) -> Array:
        wander = lowpassed(random, self.samples, self.fastest * self.period)
        return np.asarray((wander - wander.min()) / np.ptp(wander))


def lowpassed(random: np.random.Generator, samples: int, frequency: float) -> Array:
    """Noise of deviation 1 up to a frequency, in that of the samples."""
    found = sosfilt(butter(2, 2.0 * frequency, output="sos"), random.normal(size=samples + 1000))[1000:]
    return np.asarray(found / found.std())


def solved(
    law: Callable[[Array, Array], list[float]], first: list[float], inputs: Array, period: float, step: float
) -> Array:
    """States (samples, n) of x' = law(x, u) for held inputs."""
    found, state = np.empty((len(inputs), len(first))), np.array(first)
    for k, u in enumerate(inputs):
        found[k] = state
        over = (0.0, period)
        state = solve_ivp(lambda _, x, u=u: law(x, u), over, state, max_step=step, rtol=1e-5, atol=1e-8).y[:, -1]
    return found


def _quarter_car(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Travel of a suspension [m] by a force [N]: its spring stiffens, its damper is softer in one direction, and the
    road, which no sensor sees, moves the wheel.
    """
    road = 0.002 * lowpassed(random, len(inputs), 0.02)

    def law(x: Array, u: Array) -> list[float]:
        travel, rate = x[0] - x[2], x[1] - x[3]
        damping = (1500.0 if rate > 0.0 else 700.0) * rate
        force = 16e3 * travel + 4e6 * travel**3 + damping
        return [x[1], (u[0] - force) / 300.0, x[3], (force - u[0] - 180e3 * (x[2] - u[1])) / 40.0]

    x = solved(law, [0.0] * 4, np.column_stack([inputs, road]), period, period)
    return np.asarray(x[:, 0] - x[:, 2])


def _heat_exchanger(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Temperature of the heated water [deg C] by the flow of hot water [l/min], behind a pipe whose dead time goes with
    nothing; the cold water's temperature wanders.
    """
    cold = 12.0 + 1.0 * lowpassed(random, len(inputs), 0.0008)

    def law(x: Array, u: Array) -> list[float]:
        passed = 0.03 * u[0] ** 0.6 * (x[0] - x[1])
        return [0.02 * u[0] * (80.0 - x[0]) - passed, passed - 0.05 * (x[1] - u[1])]

    x = solved(law, [50.0, 25.0], np.column_stack([inputs, cold]), period, period)[:, 1]
    late = round(8.0 / period)
    return np.concatenate([np.full(late, x[0]), x[:-late]])


def _two_tanks(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Level of the lower of two tanks [cm] by the pump [1]; the upper one runs over, in part into the lower one."""
    leak = 0.03 * lowpassed(random, len(inputs), 0.002)

    def law(x: Array, u: Array) -> list[float]:
        out = 0.22 * np.sqrt(max(x[0], 0.0))
        over = 2.0 * max(x[0] - 10.0, 0.0)
        return [1.1 * u[0] - out - over, out + 0.5 * over - (0.2 + 0.1 * u[1]) * np.sqrt(max(x[1], 0.0))]

    return solved(law, [4.0, 4.0], np.column_stack([inputs, leak]), period, period)[:, 1]


def _building(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Temperature of a room [deg C] by its heating [kW] and the weather [deg C]; the sun shines unseen, by day."""
    time = period * np.arange(len(inputs)) / 86400.0
    clouds = 1.0 / (1.0 + np.exp(-lowpassed(random, len(inputs), 0.005)))
    sun = 1.5 * np.maximum(np.sin(2.0 * np.pi * time), 0.0) * clouds

    def law(x: Array, u: Array) -> list[float]:
        room = (u[0] + 0.6 * u[2] + 0.4 * (x[1] - x[0]) + 0.04 * (u[1] - x[0])) / 1.5e3
        return [room, (0.4 * (x[0] - x[1]) + 0.08 * (u[1] - x[1]) + 0.4 * u[2]) / 2e4]

    return solved(law, [20.0, 16.0], np.column_stack([inputs, sun]), period, period)[:, 0]


def _crane(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Angle of a load [deg] by the speed that a trolley is asked for [m/s]; its gear has a backlash, and wind blows."""
    position, gear = np.cumsum(inputs[:, 0]) * period, 0.0
    played = np.empty(len(inputs))
    for k, value in enumerate(position):
        gear = min(max(gear, value - 0.02), value + 0.02)
        played[k] = gear
    speed = lfilter([1.0 - np.exp(-period / 0.15)], [1.0, -np.exp(-period / 0.15)], np.gradient(played, period))
    pushed = np.gradient(speed, period) + 0.02 * lowpassed(random, len(inputs), 0.01)

    def law(x: Array, u: Array) -> list[float]:
        return [x[1], (-9.81 * np.sin(x[0]) - u[0] * np.cos(x[0])) / 1.5 - 0.15 * x[1] - 0.1 * x[1] * abs(x[1])]

    return np.asarray(np.rad2deg(solved(law, [0.0, 0.0], pushed[:, None], period, period)[:, 0]))


def _motor(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Speed of a motor [rad/s] by its voltage [V]: it sticks, and its load wanders."""
    load = 0.004 * lowpassed(random, len(inputs), 0.005)

    def law(x: Array, u: Array) -> list[float]:
        friction = (0.03 + 0.02 * np.exp(-((x[1] / 4.0) ** 2))) * np.tanh(x[1] / 0.5) + 2e-4 * x[1]
        return [(u[0] - 1.2 * x[0] - 0.06 * x[1]) / 0.02, (0.06 * x[0] - friction - u[1]) / 1.2e-3]

    return solved(law, [0.0, 0.0], np.column_stack([inputs, load]), period, 0.5 * period)[:, 1]


def _cell(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """Voltage of a lithium-ion cell [V] by its current [A]: its rest voltage bends with the charge, and its resistance
    with current and temperature.
    """
    warm = 1.0 + 0.1 * lowpassed(random, len(inputs), 0.001)

    def law(x: Array, u: Array) -> list[float]:
        return [-u[0] / (2.5 * 3600.0), u[0] / 1200.0 - x[1] / 30.0, u[0] / 12e3 - x[2] / 600.0]

    x = solved(law, [0.7, 0.0, 0.0], inputs, period, period)
    rest = 3.4 + 0.6 * x[:, 0] + 0.12 * np.tanh(8.0 * (x[:, 0] - 0.9)) - 0.25 * np.exp(-20.0 * x[:, 0])
    return np.asarray(rest - warm * (x[:, 1] + x[:, 2] + 0.03 * np.arcsinh(inputs[:, 0] / 1.5)))


def _wiener_hammerstein(inputs: Array, period: float, random: np.random.Generator) -> Array:
    """A filter, a diode, a filter; coloured noise is added at the end."""
    before = sosfilt(butter(3, 0.1, output="sos"), inputs[:, 0])
    bent = np.where(before > 0.3, 0.3 + 0.3 * (before - 0.3), before)
    after = sosfilt(butter(3, 0.06, output="sos"), bent)
    return np.asarray(after + 0.01 * lowpassed(random, len(inputs), 0.02))


WORLDS: Mapping[str, World] = {
    "quarter_car": World(
        period=0.01, samples=3000, lows=(-900.0,), highs=(900.0,), fastest=3.0, noise=2e-4, answer=_quarter_car
    ),
    "heat_exchanger": World(
        period=1.0, samples=4000, lows=(1.0,), highs=(6.0,), fastest=0.01, noise=0.1, answer=_heat_exchanger
    ),
    "two_tanks": World(
        period=1.0, samples=4000, lows=(0.1,), highs=(1.0,), fastest=0.02, noise=0.05, answer=_two_tanks
    ),
    "building": World(
        period=600.0,
        samples=3000,
        lows=(0.0, -5.0),
        highs=(3.0, 12.0),
        fastest=3e-5,
        noise=0.05,
        answer=_building,
    ),
    "crane": World(period=0.02, samples=3000, lows=(-0.5,), highs=(0.5,), fastest=0.8, noise=0.05, answer=_crane),
    "motor": World(period=0.005, samples=4000, lows=(-12.0,), highs=(12.0,), fastest=4.0, noise=0.5, answer=_motor),
    "cell": World(period=1.0, samples=4000, lows=(-3.0,), highs=(4.0,), fastest=0.02, noise=1e-3, answer=_cell),
    "wiener_hammerstein": World(
        period=1e-3, samples=4000, lows=(-1.0,), highs=(1.0,), fastest=40.0, noise=2e-3, answer=_wiener_hammerstein
    ),
}

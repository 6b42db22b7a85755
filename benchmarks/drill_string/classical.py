"""Three classical loops that turn a drill string, compiled with its plant, and how they are tuned.

All answer the measured speeds every period with a torque within the motor's limits; an integral stands still where the
torque is at a limit. e = w - wm, w the wanted speed, wm the top's, wd the bit's.

    PI              tau = kp e + ki int e
    Soft Torque     tau = kp e' + ki int e',  e' = w - wm - h H tau: the top gives way to torque as a matched
                    impedance does, so that waves from the bit are not reflected; H a first-order high-pass of rate r
                    (Halsey, Kyllingstad & Kylling 1988, SPE 18049; Jansen & van den Steen 1995, J. Sound Vib. 179(4))
    sliding mode    tau = cm wm + k p + c (wm - wd) + Jm (lambda e - gamma (wm - wd)) - K sat(s / b),
                    s = wm - w + lambda int (wm - w) + gamma int (wm - wd),  p = int (wm - wd) the shaft's twist
                    (Navarro-Lopez & Liceaga-Castro 2009; Vaziri, Kapitaniak & Wiercigroch 2020, Nonlinear Dynamics)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from benchmarks.drill_string import plants
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

PI, SOFT_TORQUE, SLIDING = 0, 1, 2
LAWS: Mapping[str, tuple[int, Mapping[str, tuple[float, float]]]] = {
    "PI": (PI, {"kp": (0.005, 2.0), "ki": (0.002, 10.0)}),
    "Soft Torque": (SOFT_TORQUE, {"kp": (0.005, 2.0), "ki": (0.002, 10.0), "h": (0.1, 100.0), "r": (0.01, 10.0)}),
    "sliding mode": (SLIDING, {"lambda": (0.05, 20.0), "gamma": (0.05, 20.0), "K": (0.01, 3.0), "b": (0.05, 20.0)}),
}
"""Of each law its number, and the range in which each gain is sought, by its logarithm."""


@inner
def _answer(
    law: int, g: Array, m: Array, known: Array, w: float, wd: float, wm: float, dt: float, most: float
) -> float:
    """The torque; g: gains, m: memory, known: k, c, cm, Jm of the nominal plant."""
    if law == SLIDING:
        slip, error = wm - wd, wm - w
        s = error + g[0] * m[0] + g[1] * m[1]
        free = known[2] * wm + known[0] * m[1] + known[1] * slip - known[3] * (g[0] * error + g[1] * slip)
        tau = free - g[2] * min(max(s / g[3], -1.0), 1.0)
        m[1] += dt * slip
        if abs(tau) <= most:
            m[0] += dt * error
    else:
        error = w - wm
        if law == SOFT_TORQUE:
            error -= g[2] * m[1]
        tau = g[0] * error + m[0]
        if abs(tau) <= most:
            m[0] += dt * g[1] * error
    tau = min(max(tau, -most), most)
    if law == SOFT_TORQUE:
        m[2] += dt * g[3] * (tau - m[2])  # what is not high
        m[1] = tau - m[2]
    return tau


@kernel
def _turned(
    step: int, x: Array, p: Array, weights: Array, h: float, hand: Array, late: int, noise: Array, wanted: Array,
    every: int, law: int, gains: Array, known: Array, most: float, found: Array,
) -> None:  # fmt: skip
    """Let a loop run: ``found`` receives the bit's speed at each period. hand: the brake in each step, wanted: that
    speed in each period, noise (periods, 2) of the sensors, every: steps in a period, late: steps of delay.
    """
    memory, u, following = np.zeros(3), np.zeros(1), np.empty(x.shape[0])
    past = np.zeros(late + 1)
    tau = 0.0
    for k in range(hand.shape[0]):
        if k % every == 0:
            n = k // every
            found[n] = x[1]
            tau = _answer(law, gains, memory, known, wanted[n], x[1] + noise[n, 0], x[2] + noise[n, 1], h * every, most)
        past[k % (late + 1)] = tau
        u[0] = past[(k + 1) % (late + 1)]
        x[3] = hand[k]
        call_value(step, x, u, p, weights, h, 0.0, following)
        for i in range(x.shape[0]):
            x[i] = following[i]


def nominal(system: System) -> Array:
    """What the sliding mode knows of the plant: k, c, cm, Jm."""
    named = system.named
    return np.array([named[name] for name in ("stiffness", "shaft_damping", "top_damping", "top_inertia")])


def loop(rig: Rig, known: Array, law: int, gains: Array, *, seed: int, period: float) -> tuple[Array, Array]:
    """Times and true speeds of the bit [rad/s] along the reference, every period [s]; the first command finds a rig at
    rest.
    """
    every, schedule = rig.steps(period, "period"), rig.schedule(plants.REFERENCE)
    steps = round(schedule.duration / rig.step)
    times, random = period * np.arange(steps // every, dtype=np.float64), np.random.default_rng(seed)
    noise = np.array([sensor.white_noise for sensor in rig.sensors]) * random.standard_normal((len(times), 2))
    found = np.empty(len(times))
    _turned(
        compiled(rig.system).step,
        np.zeros(len(rig.system.states)),
        rig.system.values,
        rig.system.weights,
        rig.step,
        plants.brake(rig, seed, rig.step * np.arange(steps, dtype=np.float64)),
        round(rig.system.delay / rig.step),
        noise,
        np.ascontiguousarray(schedule(times)[:, plants.BIT]),
        every,
        law,
        np.asarray(gains, dtype=float),
        known,
        rig.actuators[0].high,
        found,
    )
    return times, found


def tuned(rig: Rig, name: str, seeds: Sequence[int], *, period: float) -> dict[str, Any]:
    """The gains of least mean settling time over the plants of the seeds, by differential evolution."""
    law, ranges = LAWS[name]
    strings = [(plants.drawn(rig, seed), plants.events(rig, seed), seed) for seed in seeds]
    known = nominal(rig.system)

    def cost(logarithms: Array) -> float:
        found = [
            plants.settling(happened, *loop(string, known, law, np.exp(logarithms), seed=seed, period=period)).times
            for string, happened, seed in strings
        ]
        return float(np.mean(np.concatenate(found)))

    bounds = [(np.log(low), np.log(high)) for low, high in ranges.values()]
    best = differential_evolution(cost, bounds, popsize=10, maxiter=25, seed=0, polish=False, tol=1e-3)
    gains = np.exp(best.x).tolist()
    return {"gains": dict(zip(ranges, gains, strict=True)), "cost": float(best.fun), "loops": int(best.nfev)}

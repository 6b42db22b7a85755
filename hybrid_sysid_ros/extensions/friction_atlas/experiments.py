"""What tells laws of friction apart: four experiments on a block, simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.core.rollout import rollouts, simulate
from hybrid_sysid_ros.extensions.friction_atlas.laws import SlidingBlock
from hybrid_sysid_ros.support.arrays import Array

STEP = 1e-4
EVERY = 400
"""Steps from one drawn point to the next."""
STIFF, STIFF_DAMPER = 1e6, 1e3
"""N/m, N s/m per kg of a drive that leads the block."""
HEAVY, STIFFER = 1000.0, 100.0
"""kg per N of friction of a block that is led, and times as stiff as its bristles that its drive must be."""
LED, SETTLED = 1.0, 0.7
"""Seconds at a steady speed, and the part of them after which friction is read."""
SWING, FARTHEST = 4.0, 0.05
"""Way of a block that is led to and fro, in those by which bristles or elements bend, and at most [m]."""
SLID, WAYS = 0.02, 10.0
"""A block has broken away after so many m, or so many of those ways."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A line of a plot: points (samples,) of x and y."""

    x: Array
    y: Array


def friction_over_speed(system: SlidingBlock, *, top: float = 0.3, speeds: int = 41) -> Line:
    """Steady friction [N] at speeds up to ``top`` [m/s] both ways, the block led by a stiff drive."""
    tried = np.geomspace(top / 300.0, top, speeds)
    friction = np.array([_led_steadily(system, speed) for speed in tried])
    return Line(x=np.concatenate([-tried[::-1], tried]), y=np.concatenate([-friction[::-1], friction]))


def _led_steadily(system: SlidingBlock, speed: float) -> float:
    """It has slid for long already: what the drive's own beginning disturbs is over before SETTLED."""
    time = _times(LED)
    friction, _ = led(system, speed * time, np.full(len(time), speed), system.sliding(speed))
    return float(friction[int(SETTLED * len(friction)) :].mean())


def pre_sliding(system: SlidingBlock, *, period: float = 4.0) -> Line:
    """Friction [N] over the place [m] of a block that is led to and fro, the third time half as far."""
    time, amplitude = _times(3.0 * period), min(SWING * system.way, FARTHEST) or 0.5 * SLID
    swing = np.where(time < 2.0 * period, 1.0, 0.5) * amplitude
    phase = 2.0 * np.pi * time / period
    end, speed = swing * np.sin(phase), swing * 2.0 * np.pi / period * np.cos(phase)
    friction, places = led(system, end, speed)
    shown = slice(0, None, 250)
    return Line(x=places[shown], y=friction[shown])


def break_away(system: SlidingBlock, *, slowest: float = 0.3, fastest: float = 300.0, rates: int = 25) -> Line:
    """Largest dry friction [N] until a block that has just come to rest slides, over the rate [N/s] of the force."""
    tried = np.geomspace(slowest, fastest, rates)
    return Line(x=tried, y=np.array([_broken(system, rate) for rate in tried]))


def _broken(system: SlidingBlock, rate: float) -> float:
    named = system.named
    most = 3.0 * max(named.get("static", 0.0), named.get("coulomb", 0.0), 0.1)
    far = max(SLID, WAYS * system.way)
    inertia, viscous = (6.0 * system.mass * far / rate) ** (1.0 / 3.0), (2.0 * named["viscous"] * far / rate) ** 0.5
    seconds = most / rate + inertia + viscous + 1.0  # to leave friction behind, and to slide so far against the others
    h = max(seconds / 50_000, 1e-5)
    force = rate * _times(seconds, h)
    states = simulate(system, _just_stopped(system), _inputs(force=force), step=h)
    v = states[:, 1]
    friction = force - system.mass * np.diff(v) / h - named["viscous"] * 0.5 * (v[:-1] + v[1:])
    slid = np.flatnonzero(np.abs(states[1:, 0]) > far)
    return float(friction[: slid[0] + 1 if len(slid) else None].max())


def _just_stopped(system: SlidingBlock) -> Array:
    """At rest, a contact that ages just renewed."""
    names = [str(item).partition(" ")[0] for item in system.states]
    return np.array([1.0 if name == "renewed" else 0.0 for name in names])


def stick_slip(
    system: SlidingBlock, *, spring: float = 20.0, speed: float = 0.02, seconds: float = 12.0
) -> tuple[Line, Line]:
    """Place [m] over time [s] of a block on a spring [N/m] whose end a belt draws at a speed [m/s]; and the end's."""
    time = _times(seconds)
    end = speed * time
    drawn = replace(system, spring=spring, damper=0.0)
    inputs = _inputs(end=end, end_speed=np.full(len(time), speed))
    places = simulate(drawn, np.zeros(len(system.states)), inputs, step=STEP, every=EVERY)[:, 0]
    shown = _times(STEP * EVERY * len(places), STEP * EVERY)
    return Line(x=shown, y=places), Line(x=shown, y=speed * shown)


def led(system: SlidingBlock, end: Array, speed: Array, hidden: Sequence[float] = ()) -> tuple[Array, Array]:
    """Friction [N] and places [m] of a block that a stiff drive leads along ``end`` [m] with ``speed`` [m/s]; hidden:
    states at the beginning, zero by default. The block is so heavy that friction changes its motion by nothing.
    """
    named = system.named
    level, bristles = named.get("static", named.get("coulomb", 0.0)), named.get("stiffness", 0.0)
    mass = max(system.mass, HEAVY * level, STIFFER * bristles / STIFF)
    drive = replace(system, mass=mass, spring=STIFF * mass, damper=STIFF_DAMPER * mass)
    first = np.zeros((1, len(system.states)))
    first[0, 1] = speed[0]
    first[0, 2 : 2 + len(hidden)] = hidden
    inputs = _inputs(end=end, end_speed=speed)
    states, _ = rollouts(drive, np.array([[0, 0, len(end) + 1, 0]]), first, inputs, step=STEP)
    place, v = states[:-1, 0], states[:-1, 1]
    pull = drive.spring * (end - place) + drive.damper * (speed - v)
    return pull - mass * np.diff(states[:, 1]) / STEP, states[1:, 0]


def _times(seconds: float, h: float = STEP) -> Array:
    """[s], from 0 in steps of h."""
    return np.asarray(h * np.arange(round(seconds / h)), dtype=np.float64)


def _inputs(force: Array | None = None, end: Array | None = None, end_speed: Array | None = None) -> Array:
    given = next(item for item in (force, end, end_speed) if item is not None)
    none = np.zeros(len(given))
    return np.column_stack([none if item is None else item for item in (force, end, end_speed)])

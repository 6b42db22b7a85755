"""Random drill strings under a hand on the brake, and how a bit's speed settles on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

REFERENCE, BIT, BRAKE = "moves", 0, 3
"""Of the rig: its reference, the output that follows it, and the state that the hand moves."""
BAND = 0.05
"""Of the wanted speed, within which it has settled."""
SHORTEST = 1.0
"""Time to the next event [s] in which a bit that settles must have settled."""
STANDS = 0.01
"""Speed of a bit that stands [rad/s]."""
DEVIATION, WIDEST = 0.1, 0.2
"""Of each parameter of a random plant, relative: normal, and at most."""


def drawn(rig: Rig, seed: int) -> Rig:
    """The rig with other masses, springs, frictions and delay, all by the seed."""
    random = np.random.default_rng(seed)
    factors = 1.0 + np.clip(DEVIATION * random.standard_normal(len(rig.system.values)), -WIDEST, WIDEST)
    return replace(rig, system=rig.system.with_values(factors * rig.system.values))


def brake(rig: Rig, seed: int, times: Array) -> Array:
    """Torque of the brake [N m] in the plant of a seed."""
    return np.asarray(rig.disturbances[BRAKE].signal(seed=seed)(times))


@dataclass(frozen=True, kw_only=True)
class Event:
    """What disturbs the bit."""

    kind: str
    """step, apply or release."""
    time: float
    stop: float
    """When the next one comes [s]."""
    wanted: float
    """Speed of the bit [rad/s]."""


def events(rig: Rig, seed: int) -> list[Event]:
    """Steps of the reference, and the hand's pulls and releases, in order."""
    schedule = rig.schedule(REFERENCE)
    times = rig.step * np.arange(round(schedule.duration / rig.step) + 1, dtype=np.float64)
    slope = np.sign(np.diff(brake(rig, seed, times)))
    found = [("step", start) for start, _ in schedule.windows.values()]
    found += [("apply", times[k + 1]) for k in np.flatnonzero((slope[:-1] == 0) & (slope[1:] > 0)).tolist()]
    found += [("release", times[k + 1]) for k in np.flatnonzero((slope[:-1] >= 0) & (slope[1:] < 0)).tolist()]
    found = sorted(found, key=lambda item: item[1])
    ended = [*found, ("end", schedule.duration)]
    return [
        Event(kind=kind, time=time, stop=stop, wanted=float(schedule(np.array([time]))[0, BIT]))
        for (kind, time), (_, stop) in pairwise(ended)
    ]


@dataclass(frozen=True, kw_only=True)
class Settling:
    """How a run went."""

    kinds: Sequence[str]
    wanted: Array
    """Of each event, (events,) [rad/s]."""
    times: Array
    """Until it settled; all the time to the next event where it did not, (events,) [s]."""
    failed: NDArray[np.bool_]
    """Whether it did not although there was time, (events,)."""
    standing: dict[float, float]
    """By wanted speed: share of the time in which the bit stood still, the first second left out."""

    def suppressed(self, wanted: float) -> bool:
        """Whether the bit settled at a speed whenever there was time."""
        return not bool(np.any(self.failed & (self.wanted == wanted)))


def settling(found: Sequence[Event], time: Array, speed: Array) -> Settling:
    """Of a bit's speed (samples,) [rad/s]."""
    period = time[1] - time[0]
    times, failed = [], []
    standing: dict[float, list[NDArray[np.bool_]]] = {}
    for event in found:
        inside = (time >= event.time - 1e-9) & (time < event.stop - 1e-9)
        outside = np.flatnonzero(np.abs(speed[inside] - event.wanted) > BAND * event.wanted)
        last = (outside[-1] + 1) * period if len(outside) else 0.0
        times.append(min(last, event.stop - event.time))
        failed.append(last > event.stop - event.time - 2 * period and event.stop - event.time >= SHORTEST)
        standing.setdefault(event.wanted, []).append(np.abs(speed[inside & (time > 1.0)]) < STANDS)
    return Settling(
        kinds=[event.kind for event in found],
        wanted=np.array([event.wanted for event in found]),
        times=np.array(times),
        failed=np.array(failed),
        standing={wanted: float(np.mean(np.concatenate(parts))) for wanted, parts in standing.items()},
    )

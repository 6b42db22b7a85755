"""Judgement of a free run in a word, against the record's variance, the sensors' noise, and the run's bands.

The bounds of the words are conventions of this project, which its guide to reports states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_sysid_ros.rigs.rig import Rig

WELL, ROUGHLY = 0.9, 0.5
"""Least shares of a record's variance that a good and a fair run explain."""
NOISE = 2.0
"""Errors up to so many times the sensor's noise are little more than that."""
HELD = 0.7
"""Share of a record that its 90 % band is to hold, below which the model is too sure."""


def noise_floors(rig: Rig, period: float) -> dict[str, float]:
    """Errors that the sensors' noise alone would leave in samples of a period [s], by output, in its unit; 0 where a
    rig declares none.
    """
    pairs = zip(rig.system.outputs, rig.sensors, strict=True)
    return {item.name: sensor.floor_of(period) * abs(sensor.scale) for item, sensor in pairs}


def judgement(
    scores: Mapping[str, Any],
    rig: Rig,
    period: float,
    bands: Mapping[str, Mapping[str, Mapping[str, float]]],
    limits: Sequence[str] = (),
) -> dict[str, str]:
    """By output: good, fair or useless, and why. scores: of a free run, each period [s]; bands: what they hold, by
    level and output; limits: why no run is better than fair, however well it fits.
    """  # fmt: skip
    floors, found = noise_floors(rig, period), {}
    for name, floor in floors.items():
        own = scores.get("outputs", {}).get(name, scores)
        r2 = own["r2"]
        grade = "good" if r2 >= WELL else "fair" if r2 >= ROUGHLY else "useless"
        if r2 <= 0.0:
            why = [f"the mean of the record would be nearer (R2 {r2:.2f})"]
        else:
            why = [f"it explains {100.0 * r2:.1f} % of the variance"]
            if floor > 0.0:
                ratio = own["rmse"] / floor
                why.append(f"its error is {ratio:.2g} times the sensor's noise{' alone' if ratio <= NOISE else ''}")
        limited, wide = list(limits), bands.get("0.9", {}).get(name)
        if wide and wide["held"] < HELD:
            held = f"its 90 % band holds {100.0 * wide['held']:.0f} %"
            limited.append(f"{held}: the model is too sure of itself, or the record differs in rig, scale or time")
        grade = "fair" if limited and grade == "good" else grade
        why += limited
        found[name] = f"{grade}: {', '.join(why)}"
    return found

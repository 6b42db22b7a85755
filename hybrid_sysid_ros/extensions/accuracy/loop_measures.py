"""Numbers of a loop along a reference: how well it tracks each part, and its paths."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.extensions.accuracy.statistics import ShotQuantity
from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule, Segment
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.arrays import Array, NamedArrays

END = 1.0
"""Horizons of the controller before the end of a part over which its final error is averaged."""
POINTS = 40
"""Of a path: means over as many stretches of time."""
SETTLED = 0.05
"""Error, as a share of the reference's range, below which an output has settled."""
MEASURES = {"rmse": "RMSE", "peak": "largest error", "settling": "settling time", "path": "mean path"}


def loop_numbers(
    rig: Rig, schedule: ReferenceSchedule, time: Array, outputs: Array, references: Array, inputs: Array
) -> NamedArrays:
    """Tell numbers of a loop at times (samples,) [s], with outputs (samples, p) and inputs (samples, m) in SI units.

    miss, rmse, peak (parts,): mean error at the end of each part of the reference, root mean square and largest error;
    settling (parts,) [s]: for which it is not small, after all steps together; path (parts, POINTS):
    the output; input (m, POINTS).
    """
    time = np.round(time, 9)  # to the nanosecond, so that a stamp and a computed time are in the same part
    settings = configuration.defaults(rig, "controller")
    end = END * settings["horizon"] * settings["period"]
    found: dict[str, list[Array]] = {name: [] for name in ("miss", *MEASURES)}
    for segment in schedule.segments:
        for name, value in _of_part(rig, schedule, segment, time, outputs, references, end).items():
            found[name].append(value)
    through = (time >= 0.0) & (time < schedule.duration)
    paths = [_path(time[through], column, 0.0, schedule.duration) for column in inputs[through].T]
    return {**{name: np.array(values) for name, values in found.items()}, "input": np.array(paths)}


def _of_part(
    rig: Rig, schedule: ReferenceSchedule, segment: Segment, time: Array, outputs: Array, references: Array, end: float
) -> NamedArrays:
    display, k = rig.display[segment.output], segment.output
    stop = min(segment.stop, schedule.duration)
    inside = (time >= segment.start) & (time < stop)
    when, error = time[inside], display.shown(outputs[inside, k] - references[inside, k])
    reached = display.shown(outputs[inside, k])
    band = SETTLED * float(np.ptp(display.shown(references[(time >= 0.0) & (time < schedule.duration), k])))
    outside = float(np.mean(~(np.abs(error) <= band)))
    with np.errstate(over="ignore", invalid="ignore"):
        return {
            "miss": np.mean(error[when >= stop - end]),
            "rmse": np.sqrt(np.mean(error**2)),
            "peak": np.max(np.abs(error)),
            "settling": np.array(outside * (stop - segment.start)),
            "path": _path(when, reached, segment.start, stop),
        }


def _path(time: Array, values: Array, start: float, stop: float) -> Array:
    """Means over POINTS stretches from start to stop [s], of as many samples at least."""
    place = np.clip(((time - start) / (stop - start) * POINTS).astype(int), 0, POINTS - 1)
    counts = np.bincount(place, minlength=POINTS)
    with np.errstate(over="ignore", invalid="ignore"):
        means = np.bincount(place, values, minlength=POINTS) / np.maximum(counts, 1)
    return np.interp(np.arange(POINTS), np.flatnonzero(counts), means[counts > 0])


def quantities(rig: Rig, schedule: ReferenceSchedule, rows: NamedArrays) -> dict[str, list[ShotQuantity]]:
    """Of shots, by what they are of: each part of the reference, with its output, and the inputs.

    A difference of paths is a share of the part's RMSE, one of an input's path a share of how much the input moves.
    """
    found: dict[str, list[ShotQuantity]] = {}
    for j, segment in enumerate(schedule.segments):
        output = rig.system.outputs[segment.output].name
        unit = rig.display[segment.output].unit
        found[f"{segment.name}, {output}"] = [
            ShotQuantity(
                name=words,
                unit="s" if name == "settling" else unit,
                values=rows[name][:, j].reshape(len(rows[name]), -1),
                size=float(np.mean(rows["rmse"][:, j])) if name == "path" else None,
            )
            for name, words in MEASURES.items()
        ]
    found["inputs"] = [
        ShotQuantity(
            name=f"mean path of {item.name}",
            unit=item.unit,
            values=rows["input"][:, j],
            size=float(np.std(rows["input"][:, j].mean(axis=0))),
        )
        for j, item in enumerate(rig.system.inputs)
    ]
    return found

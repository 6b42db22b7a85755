"""Steps of a rig's reference: which there are, and how soon and how closely an output follows them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hybrid_sysid_ros.rigs.excitation import ReferenceSchedule
from hybrid_sysid_ros.support.arrays import Array


def levels(schedule: ReferenceSchedule, output: int) -> list[tuple[float, float, float, float]]:
    """Each step of a reference: when it comes, when the next one does [s], from and to which value, as shown."""
    last, found = 0.0, []
    for start, stop in schedule.windows.values():
        level = float(schedule(np.array([start]))[0, output])
        found.append((start, stop, last, level))
        last = level
    return found


def settled(schedule: ReferenceSchedule, output: int, time: Array, values: Array, *, band: float) -> Array:
    """Settling time [s], overshoot and steady error [of the step] of each step, (steps, 3); values as shown (samples,).

    A step has settled when the output stays within ``band`` of the step's size until the next one; the steady error is
    that of the mean over the second half.
    """
    rows, period = [], time[1] - time[0]
    for start, stop, before, after in levels(schedule, output):
        inside = (time >= start - 1e-9) & (time < stop - 1e-9)
        error = (values[inside] - after) / (after - before)
        outside = np.flatnonzero(np.abs(error) > band)
        last = time[inside][outside[-1]] + period - start if len(outside) else 0.0
        rows.append((last, max(0.0, float(error.max())), abs(float(error[len(error) // 2 :].mean()))))
    return np.array(rows)


def unforeseen(schedule: ReferenceSchedule, scales: Array, period: float, *, lead: float) -> Callable[[Array], Array]:
    """The reference [SI] for a controller of that period [s], whose inputs act a lead [s] later, who knows of no step
    before it comes.
    """

    def reference(times: Array) -> Array:
        if len(times) == 1:
            return np.asarray(scales * schedule(times))
        now = schedule(times[:1] - period - lead)  # what is wanted when the state is measured
        return np.asarray(scales * np.repeat(now, len(times), axis=0))

    return reference

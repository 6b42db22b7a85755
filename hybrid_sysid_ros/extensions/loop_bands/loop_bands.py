"""Loop bands: how far a measurement may be from a closed loop that is forecast from its commands.

The error of a free run acts in the loop as one of the output, e: the controller answers it. With S = 1 / (1 + G C), the
sensitivity of the loop of a model G under a controller C, the error of a forecast is S e (Skogestad & Postlethwaite
2005, Multivariable Feedback Control, section 2.2), exactly so where both are linear. So errors like those of training
records that were left out of the fit are drawn, and the loop is simulated with each in what its controller sees. Their
spectrum is that of an autoregressive process (Yule-Walker equations). Of how far a forecast goes and how other
parameters move it the larger one counts, as in bands of free runs, whose widths hold
(:mod:`~hybrid_sysid_ros.identification.validation.bands`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import correlate, lfilter

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.resimulation import resimulate
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.validation.bands import (
    LEVELS,
    bounded_errors,
    deviation_of,
    drawn_systems,
    excursion_of,
    uncertainty_of,
)
from hybrid_sysid_ros.identification.validation.left_out import LeftOut, free_run_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

NOTE = "loop_bands"
ORDER = 20
"""Samples of the past by which an error goes on."""
SHORTEST = 10 * ORDER
"""Samples of all blocks below which nothing is noted."""
DRAWS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopBands:
    """A closed loop that is forecast, and its bands; s samples."""

    name: str
    time: Array
    """(s,) [s]."""
    forecast: Array
    measured: Array
    """Of the output, (s,) each."""
    halves: dict[float, Array]
    """Half of the width by level, (s,)."""

    @property
    def held(self) -> dict[float, float]:
        """Share of the samples that lie within, by level."""
        away = np.abs(self.measured - self.forecast)
        return {level: float(np.mean(away <= half)) for level, half in self.halves.items()}

    @property
    def content(self) -> dict[str, Any]:
        """Plain data: by level the share that is held and the mean of half of the width."""
        held = self.held
        return {f"{level:g}": {"held": held[level], "half": float(half.mean())} for level, half in self.halves.items()}


def noted(system: System, experiments: Sequence[PreparedRecord], blocks: Sequence[LeftOut]) -> dict[str, Any] | None:
    """What a model keeps: how errors of left-out blocks go on; None where there are too few, or several outputs."""
    if len(system.outputs) != 1 or len(system.inputs) != 1:
        return None
    errors = []
    for block in blocks:
        experiment = experiments[block.record]
        away = experiment.outputs - free_run_of(block.system, experiment)
        errors.append(bounded_errors(away, experiment.outputs)[block.samples, 0])
    samples = sum(map(len, errors))
    if samples < SHORTEST:
        return None
    shared = np.zeros(ORDER + 1)
    for part in errors:
        sums = correlate(part, part, method="fft")[len(part) - 1 :][: ORDER + 1]
        shared[: len(sums)] += sums / samples
    if not shared[0] > 0.0:
        return None
    shared[0] *= 1.0 + 1e-9
    past = solve_toeplitz(shared[:-1], shared[1:])
    deviation = float(np.sqrt(max(shared[0] - past @ shared[1:], 0.0)))
    return {"past": past.tolist(), "deviation": deviation}


def loop_bands(model: Model, record: Record, rig: Rig, *, part: Part = Part()) -> LoopBands | None:  # noqa: B008
    """The forecast of a record's loop and its bands; None for a model without them: an older one, one of several
    outputs or of an unstable rig, or of a structure that no record can be left out of. Raises UserError as
    :func:`~hybrid_sysid_ros.extensions.shared.resimulation.resimulate` does.
    """
    known, free = model.note(NOTE), model.note("bands")
    if not (known and free):
        return None

    def again(system: System, error: Array | None = None) -> Any:
        return resimulate(system, record, rig, sampling=model.sampling, part=part, output_error=error)

    found = again(model.system)
    others = [again(system).simulated for system in drawn_systems(model.system, uncertainty_of(model))]
    moved = []
    for seed in range(DRAWS):
        error = drawn_error(known, found.time, model.sampling.period, seed)
        moved.append(again(model.system, error).simulated + error - found.simulated)
    own = free["outputs"][model.system.outputs[0].name]
    growth = max(float(excursion_of(found.simulated, own["centre"]) / own["excursion"]), 1.0)
    squares = np.zeros(found.time.shape)
    for other in others:
        squares += bounded_errors(other - found.simulated, found.measured) ** 2 / len(others)
    come_back = float(np.sqrt(np.mean(np.square(moved))))
    deviation = deviation_of(come_back, growth, squares)
    halves = {level: float(own["widths"][f"{level:g}"]) * deviation for level in LEVELS}
    return LoopBands(
        name=record.name, time=found.time, forecast=found.simulated, measured=found.measured, halves=halves
    )


def drawn_error(known: dict[str, Any], times: Array, period: float, seed: int) -> Array:
    """An error like those of left-out records, at times (s,) [s]. period: of the samples that it is known by [s]."""
    past = np.array(known["past"])
    count = int(np.ceil(times[-1] / period)) + 2
    first = 100 * len(past)  # until it has forgotten its beginning
    given = known["deviation"] * np.random.default_rng(seed).normal(size=first + count)
    error = lfilter([1.0], [1.0, *(-past)], given)[first:]
    return np.asarray(np.interp(times, period * np.arange(count), error))

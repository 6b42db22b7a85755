"""Bands: how far a measurement is from a free run, by what parameters, inputs and noise leave open.

A run's deviation at each sample is

    s^2 = max((growth floor)^2, floor^2 + s_parameters^2),

floor the root mean square of the errors of training records that were left out of the fit (:mod:`.left_out`). Errors
of a run that goes farther are larger, as what a law does not say grows with the motion, or as other parameters move it.
Both say how much larger, so that the larger one counts, and not their sum. growth is the excursion of the run, its root
mean square about the training's mean, in the largest of a training record, and at least 1. s_parameters is from runs
with parameters drawn from their covariance; how far runs of systems that were fitted without a block are apart says
less, since these know all but a block.

A band of level p is as many deviations wide as hold a share p of these errors, and wider by Student's factor t(n) / z
of 90 %, with n by how much the errors of one block are larger than those of another (:func:`freedom_of`).

Where no record can be left out, the training errors take their place. Those of n independent stretches to which p
numbers were fitted are smaller than those to come, and a band is wider by sqrt(n / (n - p) (1 + p / n)), too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.standard_errors import student_factor
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.left_out import LeftOut, free_run_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array

LEVELS = (0.5, 0.9)
FLOOR = ("floor", "centre", "excursion")
"""What is known of each output."""
OFFSET, OFFSETS = 0.001, (0.0005, 0.004)
"""Offset of the inputs that is simulated, and least and largest that errors are taken for, in the span of training."""
DRAWS = 4
"""Systems with other numbers, of which two mirror each other."""
MOST_USED = 0.5
"""Most of the independent errors that fitted numbers count for, since with all of them nothing is left to widen by."""
WINDOW = 5.0
"""Lags that count, in correlation times: enough for an exponential, few enough to keep their noise out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """What is not known of a system's numbers and inputs."""

    names: Sequence[str]
    """Of the free numbers: parameters, and ``weight_K``."""
    covariance: Array
    """(free, free)."""
    effective: float = 0.0
    """How many free numbers the data determined, since priors hold the others."""
    spans: Array
    """Highest less lowest value of each input in training, (inputs,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """A free run and its band at a level."""

    level: float
    run: Array
    """(samples, outputs)."""
    half: Array
    """Half of the band's width, (samples, outputs)."""

    def content(self, system: System, experiment: PreparedRecord) -> dict[str, dict[str, float]]:
        """By output, the share of scored samples that lie within, and the mean of half of the width, as plain data."""
        shares, halves = self.held(experiment.outputs, experiment.scored), self.half[experiment.scored].mean(axis=0)
        rows = zip(system.outputs, shares.tolist(), halves.tolist(), strict=True)
        return {item.name: {"held": share, "half": half} for item, share, half in rows}

    def held(self, measured: Array, scored: NDArray[np.bool_]) -> Array:
        """Share of the scored samples of each output that lie within, (outputs,)."""
        return np.asarray(np.mean(np.abs(measured - self.run)[scored] <= self.half[scored], axis=0))


def band_calibration(
    system: System, experiments: Sequence[PreparedRecord], known: Uncertainty, blocks: Sequence[LeftOut]
) -> dict[str, Any]:
    """By output floor, widths by level and the errors' correlation time in samples, and the offset of the inputs that
    moves runs as far as the errors are, as plain data; empty where a run diverges. blocks: those that were left out.
    """
    firsts = [initial_state(system, item) for item in experiments]
    runs = [free_run_of(system, item, first) for item, first in zip(experiments, firsts, strict=True)]
    if not all(np.isfinite(run).all() for run in runs):
        return {}
    fitted = [(item.outputs - run)[item.scored] for item, run in zip(experiments, runs, strict=True)]
    signed = [_errors_of(block, experiments[block.record]) for block in blocks] or fitted
    given, others = list(zip(experiments, firsts, runs, strict=True)), drawn_systems(system, known)
    drawn = np.concatenate([_moved_by_others(others, item, *of)[item.scored] for item, *of in given])
    offsets = OFFSET * known.spans
    moved = np.concatenate([_moved_by(system, item, offsets, *of)[item.scored] for item, *of in given])
    offset, found = [], dict[str, Any]()
    for column, item in enumerate(system.outputs):
        own = [part[:, column] for part in signed]
        together = np.concatenate(own)
        floor = max(float(np.sqrt(np.mean(together**2))), 1e-300)
        outputs = [record.outputs[record.scored, column] for record in experiments]
        centre = float(np.mean(np.concatenate(outputs)))
        excursion = float(max(excursion_of(part, centre) for part in outputs))
        ratios = np.abs(together) / deviation_of(floor, 1.0, drawn[:, column])
        wider = student_factor(freedom_of(own, len(experiments))) if blocks else widening_of(own, known.effective)
        offset.append(OFFSET * floor / max(float(np.sqrt(np.mean(moved[:, column]))), 1e-300))
        found[item.name] = {
            "floor": floor,
            "centre": centre,
            "excursion": excursion,
            "widths": {f"{level:g}": wider * float(np.quantile(ratios, level)) for level in LEVELS},
            "correlation": correlation_time([part[:, column] for part in fitted]),
        }
    return {"offset": float(np.clip(np.median(offset), *OFFSETS)), "outputs": found}


def bands_of(model: Model, experiment: PreparedRecord) -> list[Band]:
    """The bands of a model's free run at LEVELS, in the time of five runs; none for a model that was not calibrated,
    such as an older one, or one of an unstable rig.
    """
    calibration = model.note("bands")
    if not calibration or not all(set(FLOOR) <= set(item) for item in calibration["outputs"].values()):
        return []
    system, known = model.system, uncertainty_of(model)
    first = initial_state(system, experiment)
    run = free_run_of(system, experiment, first)
    drawn = _moved_by_others(drawn_systems(system, known), experiment, first, run)
    own = [calibration["outputs"][item.name] for item in system.outputs]
    floor, centre, excursion = (np.array([float(item[key]) for item in own]) for key in FLOOR)
    growth = np.maximum(excursion_of(run, centre) / excursion, 1.0)
    deviation = deviation_of(floor, growth, drawn)
    widths = [np.array([float(item["widths"][f"{level:g}"]) for item in own]) for level in LEVELS]
    return [Band(level=level, run=run, half=deviation * width) for level, width in zip(LEVELS, widths, strict=True)]


def uncertainty_of(model: Model) -> Uncertainty:
    """What is not known of a model."""
    ranges = [model.training_range[item.name] for item in model.system.inputs]
    spans = np.array([high - low for low, high in ranges])
    return Uncertainty(names=model.names, covariance=model.covariance, spans=spans)


def excursion_of(values: Array, centre: Array | float) -> Any:
    """Root mean square about a centre (outputs,) of values (samples, outputs), which may be columns alone."""
    return np.sqrt(np.mean((values - centre) ** 2, axis=0))


def deviation_of(floor: Array | float, growth: Array | float, parameters: Array) -> Array:
    """s: the root of the larger of (growth floor)^2 and floor^2 + parameters, the mean square that these leave open."""
    return np.sqrt(np.maximum(np.square(np.multiply(growth, floor)), np.square(floor) + parameters))


def freedom_of(blocks: Sequence[Array], records: int) -> float:
    """Degrees of freedom of the mean square of errors (samples,) in blocks of some records.

    A block has n = 2 m^2 / v, with m the mean and v the variance of their mean squares, as of m times a chi-square over
    n: Satterthwaite (1946), Biometrics Bulletin 2(6). The quantile of errors over records that differ so is that of
    Student's t(n) already; what is left open is its scale, the mean over so many records: blocks of one record do not
    say how another one differs.
    """
    squares = [float(np.mean(block**2)) for block in blocks if len(block)]
    if len(squares) < 2:
        return 0.0
    return records * 2.0 * float(np.mean(squares)) ** 2 / max(float(np.var(squares, ddof=1)), 1e-300)


def widening_of(errors: Sequence[Array], effective: float) -> float:
    """The factor of a band for errors to come, from those of an output in each training record, (samples,)."""
    count = sum(map(len, errors)) / correlation_time(errors, centred=False)
    used = min(effective, MOST_USED * count)
    return float(np.sqrt(count / max(count - used, 1.0) * (1.0 + used / count)) * student_factor(count - used))


def correlation_time(parts: Sequence[Array], *, centred: bool = True) -> float:
    """Samples of one independent error, at least 1, of the errors in some records, each (samples,).

        tau = 1 + 2 sum_{k=1}^{M} r(k),   M the smallest with M >= WINDOW tau(M)

    with r the autocorrelation over all records together, each without its mean if centred. N samples give a mean the
    variance that N / tau independent ones would: Bayley & Hammersley (1946), J. R. Stat. Soc. Suppl. 8(2); M: Sokal
    (1997), Monte Carlo methods in statistical mechanics, section 3. An AR(1) with pole a has tau = (1 + a) / (1 - a).
    """
    longest = max(len(part) for part in parts)
    sums = np.zeros(longest)
    for part in parts:
        own = part - part.mean() if centred else part
        sums[: len(part)] += scipy.signal.correlate(own, own, method="fft")[len(part) - 1 :]
    times = 2.0 * np.cumsum(sums / max(float(sums[0]), 1e-300)) - 1.0
    enough = np.flatnonzero(np.arange(longest) >= WINDOW * times)
    return float(np.clip(times[enough[0]] if len(enough) else times[-1], 1.0, longest))


def _errors_of(block: LeftOut, experiment: PreparedRecord) -> Array:
    """Errors (samples, outputs) of a record's free run, at the scored samples of a block that was left out."""
    errors = bounded_errors(experiment.outputs - free_run_of(block.system, experiment), experiment.outputs)
    return np.asarray(errors[block.samples][experiment.scored[block.samples]])


def _moved_by_others(systems: Sequence[System], experiment: PreparedRecord, first: Array, run: Array) -> Array:
    """Mean squares (samples, outputs) by which other systems move a run from a state (states,)."""
    return _squares([free_run_of(other, experiment, first) for other in systems], run, experiment)


def _moved_by(system: System, experiment: PreparedRecord, offsets: Array, first: Array, run: Array) -> Array:
    """Squared deviations (samples, outputs) by offsets of the inputs (inputs,) of a run from a state (states,)."""
    sides = [replace(experiment, inputs=experiment.inputs + side * offsets) for side in (-1.0, 1.0)]
    return _squares([free_run_of(system, side, first) for side in sides], run, experiment)


def _squares(others: Sequence[Array], run: Array, experiment: PreparedRecord) -> Array:
    """Mean squares of the differences of other runs from a run, (samples, outputs)."""
    squares = [bounded_errors(other - run, experiment.outputs) ** 2 for other in others]
    return np.mean(squares, axis=0) if squares else np.zeros_like(run)


def bounded_errors(errors: Array, outputs: Array) -> Array:
    """Errors (samples, outputs) of a run, which one that goes astray leaves as large as all that the record has."""
    most = np.ptp(outputs, axis=0)
    return np.asarray(np.clip(np.nan_to_num(errors, nan=np.inf), -most, most))


def drawn_systems(system: System, known: Uncertainty, count: int = DRAWS) -> list[System]:
    """Systems with numbers drawn from their covariance, an even number, of which two mirror each other."""
    if not len(known.names) or not np.any(known.covariance):
        return []
    values, vectors = np.linalg.eigh(known.covariance)
    random, roots = np.random.default_rng(0), np.sqrt(np.maximum(values, 0.0))
    places = {item.name: i for i, item in enumerate(system.parameters)}
    draws = [vectors @ (roots * random.normal(size=len(values))) for _ in range(count // 2)]
    return [_moved(system, places, known.names, side * draw) for draw in draws for side in (-1.0, 1.0)]


def _moved(system: System, places: Mapping[str, int], names: Sequence[str], changes: Array) -> System:
    """A system whose numbers are changed, within their bounds."""
    numbers, weights = system.values, system.weights.copy()
    for name, change in zip(names, changes, strict=True):
        if name in places:
            item = system.parameters[places[name]]
            numbers[places[name]] = np.clip(numbers[places[name]] + change, item.low, item.high)
        elif name.startswith("weight_") and int(name.removeprefix("weight_")) < len(weights):
            weights[int(name.removeprefix("weight_"))] += change
    changed = system.with_values(numbers)
    return changed.with_weights(weights) if len(weights) else changed

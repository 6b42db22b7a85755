"""Bands: how far a measurement is from a free run, by what parameters, inputs and noise leave open.

A run's deviation at each sample is s^2 = floor^2 + gain^2 (s_offset^2 + s_parameters^2): s_offset from two runs with an
offset of the inputs, s_parameters from two runs with parameters drawn from their covariance. Offset, floor and gain are
those with which the training records' own errors get the best interval score (Gneiting & Raftery 2007, J. Am. Stat.
Assoc. 102). A band of level p is as many deviations wide as hold a share p of these errors, widened as the prediction
of a regression is: errors of n independent stretches to which p numbers were fitted are smaller than those to come,

    sqrt(n / (n - p) (1 + p / n)) t(n - p) / z,   t / z at 90 % for both levels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from hybrid_sysid_ros.core import System, rollouts
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.standard_errors import student_factor
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array

LEVELS = (0.5, 0.9)
OFFSETS = (0.0005, 0.001, 0.002, 0.004)
"""Offsets of the inputs that are tried, in the span of their values in training."""
FLOORS, GAINS = (0.1, 0.25, 0.5, 1.0), (0.0, 0.5, 1.0, 2.0)
"""Floors, in the root mean square of the training errors, and gains that are tried."""
DRAWS = 2
"""Systems with other numbers, which mirror each other."""
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


def band_calibration(system: System, experiments: Sequence[PreparedRecord], known: Uncertainty) -> dict[str, Any]:
    """Offset, and by output floor, gain, widths by level and the errors' correlation time in samples, as plain data;
    empty where a run diverges.
    """
    runs = [_runs(system, item, known, OFFSETS) for item in experiments]
    if not all(np.isfinite(nominal).all() for nominal, _, _ in runs):
        return {}
    scored = [item.scored for item in experiments]
    signed = [(item.outputs - run[0])[use] for item, run, use in zip(experiments, runs, scored, strict=True)]
    moved = [
        np.concatenate([run[1][k][use] for run, use in zip(runs, scored, strict=True)]) for k in range(len(OFFSETS))
    ]
    drawn = np.concatenate([run[2][use] for run, use in zip(runs, scored, strict=True)])
    errors = np.abs(np.concatenate(signed))
    wider = [widening_of([part[:, k] for part in signed], known.effective) for k in range(len(system.outputs))]
    best, least = dict[str, Any](), np.inf
    for k, share in enumerate(OFFSETS):
        chosen, total = {}, 0.0
        for column, item in enumerate(system.outputs):
            own = errors[:, column]
            score, found = _best(own, moved[k][:, column] + drawn[:, column])
            widths = {level: value * wider[column] for level, value in found["widths"].items()}
            correlation = correlation_time([part[:, column] for part in signed])
            chosen[item.name] = {**found, "widths": widths, "correlation": correlation}
            total += score / max(float(np.sqrt(np.mean(own**2))), 1e-300)
        if total < least:
            best, least = {"offset": share, "outputs": chosen}, total
    return best


def bands_of(model: Model, experiment: PreparedRecord) -> list[Band]:
    """The bands of a model's free run at LEVELS, in the time of five runs; none for a model that was not calibrated,
    such as an older one, or one of an unstable rig.
    """
    calibration = model.note("bands")
    if not calibration:
        return []
    system, ranges = model.system, [model.training_range[item.name] for item in model.system.inputs]
    spans = np.array([high - low for low, high in ranges])
    known = Uncertainty(names=model.names, covariance=model.covariance, spans=spans)
    run, (moved,), drawn = _runs(system, experiment, known, (float(calibration["offset"]),))
    own = [calibration["outputs"][item.name] for item in system.outputs]
    floor, gain = (np.array([float(item[key]) for item in own]) for key in ("floor", "gain"))
    deviation = np.sqrt(floor**2 + gain**2 * (moved + drawn))
    widths = [np.array([float(item["widths"][f"{level:g}"]) for item in own]) for level in LEVELS]
    return [Band(level=level, run=run, half=deviation * width) for level, width in zip(LEVELS, widths, strict=True)]


def widening_of(errors: Sequence[Array], effective: float) -> float:
    """The factor of a band for errors to come, from those of an output in each training record, (samples,)."""
    count = sum(len(part) / correlation_time([part]) for part in errors)
    used = min(effective, MOST_USED * count)
    return float(np.sqrt(count / max(count - used, 1.0) * (1.0 + used / count)) * student_factor(count - used))


def correlation_time(parts: Sequence[Array]) -> float:
    """Samples of one independent error, at least 1, of the errors in some records, each (samples,).

        tau = 1 + 2 sum_{k=1}^{M} r(k),   M the smallest with M >= WINDOW tau(M)

    with r the autocorrelation over all records together, each without its mean. N samples give a mean the variance that
    N / tau independent ones would: Bayley & Hammersley (1946), J. R. Stat. Soc. Suppl. 8(2); M: Sokal (1997), Monte
    Carlo methods in statistical mechanics, section 3. An AR(1) with pole a has tau = (1 + a) / (1 - a).
    """
    longest = max(len(part) for part in parts)
    sums = np.zeros(longest)
    for part in parts:
        centred = part - part.mean()
        sums[: len(part)] += correlate(centred, centred, method="fft")[len(part) - 1 :]
    times = 2.0 * np.cumsum(sums / max(float(sums[0]), 1e-300)) - 1.0
    enough = np.flatnonzero(np.arange(longest) >= WINDOW * times)
    return float(np.clip(times[enough[0]] if len(enough) else times[-1], 1.0, longest))


def _best(errors: Array, squares: Array) -> tuple[float, dict[str, Any]]:
    """The least interval score of an output's errors (samples,), and what makes it; squares: deviations squared."""
    size, least, best = float(np.sqrt(np.mean(errors**2))), np.inf, dict[str, Any]()
    for floor, gain in product(FLOORS, GAINS):
        deviation = np.sqrt((floor * size) ** 2 + gain**2 * squares)
        ratios, score, widths = errors / np.maximum(deviation, 1e-300), 0.0, {}
        for level in LEVELS:
            width = float(np.quantile(ratios, level))
            beyond = np.maximum(errors - width * deviation, 0.0)
            score += float(np.mean(2.0 * width * deviation + 2.0 / (1.0 - level) * beyond))
            widths[f"{level:g}"] = width
        if score < least:
            least, best = score, {"floor": floor * size, "gain": gain, "widths": widths}
    return least, best


def _runs(
    system: System, experiment: PreparedRecord, known: Uncertainty, offsets: Sequence[float]
) -> tuple[Array, list[Array], Array]:
    """The free run (samples, outputs), and squared deviations of it by each offset and by parameters."""
    sampling = experiment.sampling
    starts, first = np.array([[0, 0, experiment.samples, 0]]), initial_state(system, experiment)[None]
    given: dict[str, Any] = {"step": sampling.step, "every": sampling.every}

    def run(changed: System, inputs: Array) -> Array:
        return rollouts(changed, starts, first, inputs, **given)[1]

    nominal, most = run(system, experiment.inputs), np.ptp(experiment.outputs, axis=0)

    def square(other: Array) -> Array:
        """A run that goes astray leaves everything open that the record has."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.minimum(np.nan_to_num(np.abs(other - nominal), nan=np.inf), most) ** 2

    moved = []
    for share in offsets:
        sides = [run(system, experiment.inputs + side * share * known.spans) for side in (-1.0, 1.0)]
        moved.append(0.5 * (square(sides[0]) + square(sides[1])))
    drawn = [square(run(changed, experiment.inputs)) for changed in drawn_systems(system, known)]
    return nominal, moved, np.mean(drawn, axis=0) if drawn else np.zeros_like(nominal)


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

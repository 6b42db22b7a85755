"""Trained range: which motions the training records have, as a set of typical ones and a distance from them.

A motion counts as trained where it is no farther from the nearest typical one than motions of a part of the training
records are from the rest of these, but for a share of them: that share of motions like the trained ones is accused
wrongly. (Novelty detection by nearest neighbours: Pimentel et al. 2014, Signal Processing 99, section 3.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hybrid_sysid_ros.core import Recurrence, System
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.extensions.trained_range.motion import PER_OUTPUT, MotionScales
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LONGEST, FEWEST = 100, 12
"""Samples of the longest displacement: 5 s at the usual 50 ms; and the fewest, below which nothing is said."""
TYPICAL = 150
"""Most typical motions."""
USED = 5000
"""Most motions of all records that are looked at; more would be alike."""
WRONGLY = 0.01
"""Share of motions like the trained ones that count as untrained."""
BEYOND = 0.1
"""Share of what was trained by which a value or an input may be beyond it: records that go on growing have no part like
the rest, so that no distance would be too far.
"""
PARTS = 8
"""Parts of the training records that are held against the rest."""
DIGITS = 20.0
"""Units of the stored features: their rounding is far below any distance."""


@dataclass(frozen=True, kw_only=True)
class TrainedRange:
    """The motions of training records."""

    scales: MotionScales
    typical: Array
    """Typical motions, (typical, features)."""
    reach: float
    """Distance up to which a motion is a trained one."""

    @classmethod
    def of(cls, system: System, experiments: Sequence[PreparedRecord]) -> TrainedRange | None:
        """Of the training records of a system; None where they are too short to tell motions."""
        longest = min(LONGEST, sum(item.samples for item in experiments) // 16) // 2 * 2
        used = [(item.outputs, mean_inputs(item)) for item in experiments if item.samples > 2 * longest]
        if longest < FEWEST or not used:
            return None
        noises = [item.noise for item in experiments if item.noise is not None]
        noise = np.mean(noises, axis=0) if noises else np.zeros(used[0][0].shape[1])
        outputs, inputs = (np.concatenate([pair[k] for pair in used]) for k in range(2))
        scales = MotionScales.of(outputs, inputs, noise, _places(system, experiments[0].sampling.step), longest)
        stride = -(-len(outputs) // USED)
        features = [scales.features(*pair)[::stride] for pair in used]
        whole = np.concatenate(features)
        typical = np.round(_spread_out(whole, TYPICAL) * DIGITS) / DIGITS
        return cls(scales=scales, typical=typical, reach=_reach(features))

    def distance(self, outputs: Array, inputs: Array) -> Array:
        """Distance of each motion from the nearest typical one, (samples,); NaN before a motion has its past.

        outputs (samples, p), inputs (samples, m): means from each sample to the next.
        """
        past, found = self.scales.samples[-1], np.full(len(outputs), np.nan)
        if len(outputs) > past:
            found[past:] = cKDTree(self.typical).query(self._features(outputs, inputs))[0]
        return found

    def outside(self, outputs: Array, inputs: Array) -> NDArray[np.bool_]:
        """Whether each motion is no trained one, (samples,), for what :meth:`distance` takes."""
        found, past = self.distance(outputs, inputs) > self.reach, self.scales.samples[-1]
        if len(outputs) > past:
            found[past:] |= self.beyond(self._features(outputs, inputs)).any(axis=1)
        return np.asarray(found)

    def beyond(self, features: Array) -> NDArray[np.bool_]:
        """Which features (samples, features) are values or inputs clearly beyond all that was trained."""
        low, high = self.typical.min(axis=0), self.typical.max(axis=0)
        room, outputs = BEYOND * (high - low), len(self.scales.outputs)
        moved = np.arange(features.shape[1]) < PER_OUTPUT * outputs
        moved[: PER_OUTPUT * outputs : PER_OUTPUT] = False
        return np.asarray(~moved & ((features < low - room) | (features > high + room)))

    def _features(self, outputs: Array, inputs: Array) -> Array:
        return np.nan_to_num(self.scales.features(outputs, inputs), nan=1e9, posinf=1e9, neginf=-1e9)

    @property
    def content(self) -> dict[str, Any]:
        """As plain data; a typical motion is a line of whole numbers."""
        rows = np.round(self.typical * DIGITS).astype(int)
        return {
            "outputs": self.scales.outputs.tolist(),
            "inputs": self.scales.inputs.tolist(),
            "none": self.scales.none.tolist(),
            "places": self.scales.places.tolist(),
            "samples": list(self.scales.samples),
            "reach": self.reach,
            "typical": [" ".join(map(str, row)) for row in rows.tolist()],
        }

    @classmethod
    def from_content(cls, content: Mapping[str, Any], system: System) -> TrainedRange:
        """What :attr:`content` made. Raises UserError where it is damaged, or of another system."""
        try:
            names = ("outputs", "inputs", "none", "places")
            arrays = {key: np.array(content[key], dtype=float) for key in names}
            first, second, third = (int(value) for value in content["samples"])
            typical = np.array([[int(part) for part in row.split()] for row in content["typical"]]) / DIGITS
            scales = MotionScales(**arrays, samples=(first, second, third))
            found, p, m = cls(scales=scales, typical=typical, reach=float(content["reach"])), *_channels(system)
            sizes = {key: (m if key == "inputs" else p,) for key in names}
            if any(arrays[key].shape != size for key, size in sizes.items()) or typical.shape[1:] != (
                PER_OUTPUT * p + m,
            ):
                raise ValueError(f"it is not of {p} outputs and {m} inputs")
            if not (0 < first < second < third <= LONGEST and third % 2 == 0 and len(typical)):
                raise ValueError(f"its samples are {content['samples']}, its typical motions {len(typical)}")
            scaled = np.concatenate([scales.outputs, scales.inputs, scales.none])
            if not (
                np.isfinite([*scaled, *scales.places, found.reach]).all() and scaled.min() > 0.0 and found.reach >= 0.0
            ):
                raise ValueError("a scale is no number above 0")
            return found
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise UserError(f"fit.trained_range of the model is malformed ({error!r}); fit again") from error


def _channels(system: System) -> tuple[int, int]:
    """Number of outputs and inputs."""
    return len(system.outputs), len(system.inputs)


def noted(system: System, experiments: Sequence[PreparedRecord], blocks: object = ()) -> dict[str, Any] | None:
    """The trained range as it stands in a model's file; None where records are too short."""
    found = TrainedRange.of(system, experiments)
    return None if found is None else found.content


def mean_inputs(experiment: PreparedRecord) -> Array:
    """Mean inputs from each scored sample to the next, the last one twice, (samples, inputs)."""
    inputs = experiment.inputs
    means = inputs.reshape(experiment.samples - 1, -1, inputs.shape[1]).mean(axis=1)
    return np.concatenate([means, means[-1:]])


def _places(system: System, step: float) -> Array:
    """1 for each output whose value means something, (outputs,); 0 for a position that the law does not read, alone or
    together with all others of its unit, so that the system does the same elsewhere. step: of the fit [s], in which
    slow systems move, too.
    """
    found = np.ones(len(system.outputs))
    positions = [] if isinstance(system, Recurrence) else sorted(system.kinematics)
    if not positions:
        return found
    move, random = symbolic_step(system, step=step), np.random.default_rng(0)
    states, inputs = random.normal(size=len(system.states)), random.normal(size=len(system.inputs))
    units = {system.states[state].unit for state in positions}
    groups = [{state} for state in positions]
    groups += [{state for state in positions if system.states[state].unit == unit} for unit in sorted(units)]
    shown = {state: column for state, (column, rate) in system.record_map().reconstructible.items() if not rate}
    for group in groups:
        moved = np.isin(np.arange(len(states)), list(group)).astype(float)
        change = np.array(move(states + moved, inputs) - move(states, inputs)).ravel()
        if np.allclose(change, moved, rtol=0.0, atol=1e-9):
            found[[shown[state] for state in group if state in shown]] = 0.0
    return found


def _spread_out(features: Array, most: int) -> Array:
    """Some of the features (samples, features), each the farthest from those before it (Gonzalez 1985, Theoretical
    Computer Science 38), at most ``most``.
    """
    chosen = [int(np.argmin(np.sum((features - features.mean(axis=0)) ** 2, axis=1)))]
    away = np.sum((features - features[chosen[0]]) ** 2, axis=1)
    while len(chosen) < min(most, len(features)) and away.max() > 0.0:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.sum((features - features[chosen[-1]]) ** 2, axis=1))
    return features[chosen]


def _reach(features: Sequence[Array]) -> float:
    """Distance of motions of a part of the records from the rest, which all but WRONGLY of them keep."""
    each = max(1, -(-PARTS // len(features)))
    parts = [part for item in features for part in np.array_split(item, each)]
    found = []
    for k, part in enumerate(parts):
        rest = np.concatenate([other for j, other in enumerate(parts) if j != k])
        found.append(cKDTree(_spread_out(rest, TYPICAL)).query(part)[0])
    return float(np.quantile(np.concatenate(found), 1.0 - WRONGLY))

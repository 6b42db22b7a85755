"""Words: what about motions was not trained on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.extensions.trained_range.motion import PER_OUTPUT, MotionScales
from hybrid_sysid_ros.extensions.trained_range.trained_range import TrainedRange
from hybrid_sysid_ros.support.arrays import Array

SLOW, REST = 0.5, 2.0
"""A range up to which motion is slow, in the output's deviation in training, and rest, in what counts as none."""
ONE_WAY = 0.5
"""Share of the range by which motion is up or down."""
EXPLAINED = 0.5
"""Share of untrained motions that a reason must explain to be named."""


def reason(trained: TrainedRange, features: Array, system: System, period: float) -> str:
    """Why most of some untrained motions, (samples, features), are so, as a sentence. period: of scored samples [s]."""
    beyond = trained.beyond(features)
    for columns, words in _reasons(trained, features, system, trained.scales.samples[-1] * period):
        distances = cKDTree(trained.typical[:, columns]).query(features[:, columns])[0]
        if np.mean((distances > trained.reach) | beyond[:, columns].any(axis=1)) >= EXPLAINED:
            return words
    names = [item.name for item in (*system.outputs, *system.inputs)]
    return f"no such motion of {', '.join(names[:-1])} under such {names[-1]} was trained on"


def _reasons(trained: TrainedRange, features: Array, system: System, seconds: float) -> Iterator[tuple[list[int], str]]:
    """Columns of features with what they would say, the simplest first."""
    p, typical, scales = len(system.outputs), trained.typical, trained.scales
    for k, item in enumerate(system.inputs):
        column = PER_OUTPUT * p + k
        yield [column], _beyond(item.name, item.unit, typical[:, column], features[:, column], scales.inputs[k])
    for k, item in enumerate(system.outputs):
        if scales.places[k]:
            column = PER_OUTPUT * k
            yield [column], _beyond(item.name, item.unit, typical[:, column], features[:, column], scales.outputs[k])
    for k, item in enumerate(system.outputs):
        first = PER_OUTPUT * k
        yield [first + 3, first + 4], _motion(item, scales, k, *scales.moved(features, k), seconds)
        yield [*range(first + 1, first + PER_OUTPUT)], f"no such speeds of {item.name} were trained on"


def _beyond(name: str, unit: str, typical: Array, values: Array, scale: float) -> str:
    """An input or output beyond its values in training, or in a gap of these."""
    low, high = typical.min() * scale, typical.max() * scale
    middle = float(np.median(values)) * scale
    if low <= middle <= high:
        return f"no {name} about {middle:.3g} {unit} was trained on"
    end, side = (high, "above") if middle > high else (low, "below")
    return f"no {name} {side} {end:.3g} {unit} was trained on"


def _motion(item: Variable, scales: MotionScales, k: int, moved: Array, spans: Array, seconds: float) -> str:
    """Motion of an output over the longest time [s]: its displacements and ranges (samples,)."""
    way, span = float(np.median(moved)), float(np.median(spans))
    if span < REST * scales.none[k]:
        return f"no rest of {item.name} for {seconds:.3g} s was trained on"
    if abs(way) < ONE_WAY * span:
        return f"no motion of {item.name} to and fro over {span:.2g} {item.unit} in {seconds:.3g} s was trained on"
    side = "upwards" if way > 0.0 else "downwards"
    slow = "slow " if span < SLOW * scales.outputs[k] else ""
    return f"no {slow}motion of {item.name} {side} ({way / seconds:.2g} {item.unit}/s) was trained on"

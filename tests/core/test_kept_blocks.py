"""Compiled networks that several processes keep on disk, loaded together."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.perceptron import Perceptron
from hybrid_sysid_ros.core.networks import Softsign
from tests.structures import BLOCKS

ERROR = """
import sys
import numpy as np
from hybrid_sysid_ros.core import Sensitivities, Softsign, rollouts
from hybrid_sysid_ros.models.hybrid_system import Hybrid
from tests.structures import ThrusterCart

for units in map(int, sys.argv[1:]):
    block = Softsign(features=4, units=units)
    weights = block.initial(units, output=1.0)
    hybrid = Hybrid(physics=ThrusterCart(), on=("velocity",), block=block, scales=(1.0,) * 5, network_weights=weights)
    starts, x, u = np.array([[0, 0, 3, 0]]), np.array([[0.3, 2.0]]), np.full((2, 2), 0.5)
    found = Sensitivities(hybrid, parameters=(), states=())
    derivatives, moved = np.empty((3, 2, found.count)), []
    found.rollouts(hybrid, starts, x, u, step=0.01, every=1, out=derivatives)
    for step in 1e-6 * np.eye(len(weights)):
        a, b = (rollouts(hybrid.with_weights(weights + s), starts, x, u, step=0.01, every=1)[1] for s in (step, -step))
        moved.append((a - b) / 2e-6)
    print(np.max(np.abs(derivatives - np.moveaxis(moved, 0, -1))))
"""


def errors(cache: Path, *units: int) -> list[float]:
    """Of derivatives by weights against differences, one network after the other in one process."""
    found = subprocess.run(
        [sys.executable, "-c", ERROR, *map(str, units)],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
        env=os.environ | {"HYBRID_SYSID_CACHE": str(cache)},
    )
    return [float(line) for line in found.stdout.split()]


@pytest.mark.slow
def test_networks_that_two_processes_compiled_are_told_apart_in_a_third(tmp_path):
    kept = [*errors(tmp_path, 3), *errors(tmp_path, 5), *errors(tmp_path, 3, 5), *errors(tmp_path, 5, 3)]
    assert max(kept) < 1e-7


def names(function) -> set[str]:
    """Of a function and of those that it calls, as far as they are made for a shape."""
    if getattr(function, "__closure__", None) is None:
        return set()
    return {function.__qualname__}.union(*(names(cell.cell_contents) for cell in function.__closure__))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Perceptron(widths=(2, 8, 1)), Perceptron(widths=(2, 8, 8, 1))),
        (Softsign(features=2, units=3), Softsign(features=2, units=4)),
        *BLOCKS.values(),
    ],
    ids=lambda block: type(block).__name__,
)
def test_functions_of_two_shapes_share_no_name(first, second):
    """Nor do those that they call."""
    assert not set().union(*map(names, first.functions)) & set().union(*map(names, second.functions))

"""Picture goal: predictive control whose cost is in the picture: how far it is from another one, pixel by pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from hybrid_sysid_ros.control.controller import MpcSolution
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.core import Parameter, System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.renderer import Renderer
from hybrid_sysid_ros.support.arrays import Array

LOOKS = 65
"""Positions at which the goal is looked for first."""
EVEN = np.linspace(-1.0, 1.0, 25)
OFFSETS: Array = np.sign(EVEN) * EVEN**2
"""Of the knots of the table from the best position, in spans: pictures of sharp edges differ by as much as they are
apart, so that the root is steep about the goal and flat far from it.
"""
OUTPUT = "picture"


@dataclass(frozen=True, kw_only=True)
class ImageErrorModel(Wrapper):
    """A system whose output r(q) is the root of how far its picture at a position q is from a goal.

        r(q)^2 = c sum over pixels (I(q) - goal)^2 + what no position takes away,   r < 0 below the best position,

    So r^2 summed over a horizon, the cost of a tracked output whose reference is 0, is that of the pictures. The table
    of r is of parameters, so that all goals share their compiled code.
    """

    position: str
    """The state that moves the picture."""
    span: float
    """How far the table goes to both sides, in the unit of the position."""
    best: float
    """The position where the picture is most like the goal."""
    roots: tuple[float, ...]
    """r at the OFFSETS from there (knots,)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        unit = next(item.unit for item in self.states if item.name == self.position)
        object.__setattr__(self, "outputs", (Variable(name=OUTPUT, unit=unit),))

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.physics.form, self.position, self.span, len(self.roots))

    @property
    def plain_outputs(self) -> bool:
        return False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = ("best", *(f"root_{k}" for k in range(len(self.roots))))
        unit = self.outputs[0].unit
        return (*self.physics.parameters, *(replace(of_data(name, unit), low=-1e12) for name in names))

    @property
    def values(self) -> Array:
        return np.concatenate([self.physics.values, [self.best, *self.roots]])

    def bound(self, values: Sequence[Scalar]) -> ImageErrorModel:
        physical = len(self.physics.parameters)
        best, *roots = values[physical:]
        return replace(self, physics=self.physics.bound(values[:physical]), best=best, roots=tuple(roots))

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """R between the knots: each line counts as far as the position has come along it."""
        apart = x[[item.name for item in self.states].index(self.position)] - self.best
        knots, found = (self.span * OFFSETS).tolist(), self.roots[0]
        for k, width in enumerate(np.diff(knots).tolist()):
            share = (clip(apart, knots[k], knots[k + 1], over=0.5 * width) - knots[k]) / width
            found = found + (self.roots[k + 1] - self.roots[k]) * share
        return [found]


class PictureMpc(ExactMpc):
    """The exact MPC of a :class:`ImageErrorModel`: whatever the reference is, the goal is the picture."""

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        return super().control(state, disturbance, previous_input, np.zeros_like(preview))


def error_model(
    system: System, position: str, renderer: Renderer, goal: Picture, band: NDArray[np.bool_], *,
    low: float, high: float,
) -> ImageErrorModel:  # fmt: skip
    """A system before a goal (rows, columns). band: the pixels that count. low, high: positions that are looked at.

    r is scaled so that over the table it is as large as the distance from the best position, in the mean: weights of a
    position may stay what they are. The goal's own light is taken as it is.
    """
    still: Array = np.array([-1.0, 1.0])

    def apart(where: float) -> float:
        return float(np.mean((renderer.take(0.0, still, np.full(2, where)).astype(float) - goal)[band] ** 2))

    looks = np.linspace(low, high, LOOKS)
    near = float(looks[np.argmin([apart(where) for where in looks.tolist()])])
    ends = max(near - looks[1] + low, low), min(near + looks[1] - low, high)
    best = float(minimize_scalar(apart, bounds=ends, method="bounded").x)
    offsets = (high - low) * OFFSETS
    least = apart(best)
    table = [apart(best + offset) - least for offset in offsets.tolist()]
    root = np.sign(offsets) * np.sqrt(np.maximum(table, 0.0))
    scale = float(np.mean(np.abs(offsets)) / max(np.mean(np.abs(root)), 1e-9))
    roots = tuple(float(value) for value in scale * root)
    return ImageErrorModel(physics=system, position=position, span=high - low, best=best, roots=roots)

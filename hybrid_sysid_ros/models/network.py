"""A small bounded network of states and inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Softsign
from hybrid_sysid_ros.core.mathematics import Scalar, clip

CORNER = 0.02
"""Width over which features that are held are rounded where a solver needs derivatives, in their scale."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """n(z) = scale sum_i a_i softsign(W_i . (z / feature_scales) + b_i), one hidden layer.

    Features are held within +-``clip`` of their scale and softsign is bounded, so |n| <= scale sum |a_i| everywhere.
    """

    units: int
    feature_scales: tuple[float, ...]
    scale: float
    clip: float = 1.5

    @classmethod
    def of(cls, design: Mapping[str, Any]) -> Network:
        """The network that ``dataclasses.asdict`` made a ``design`` of."""
        return cls(**{**design, "feature_scales": tuple(design["feature_scales"])})

    @property
    def block(self) -> Softsign:
        """Its hidden layer."""
        return Softsign(features=len(self.feature_scales), units=self.units)

    @property
    def size(self) -> int:
        """Number of weights: for each unit one per feature, a bias and an output weight."""
        return self.block.size

    def initial(self, seed: int, *, output: float = 0.0) -> NDArray[np.float64]:
        """Random hidden weights; output weights normal with deviation ``output``. Shape (size,)."""
        return self.block.initial(seed, output=output)

    def __call__(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """The output for states followed by inputs, inside a law."""
        features = [
            clip(value * (1.0 / scale), -self.clip, self.clip, over=CORNER)
            for value, scale in zip([*x, *u], self.feature_scales, strict=True)
        ]
        return self.scale * self.block(features)[0]

"""A small bounded network, as a plain function over scalars."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Operations


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
    def size(self) -> int:
        """Number of weights: for each unit one per feature, a bias and an output weight."""
        return self.units * (len(self.feature_scales) + 2)

    def initial(self, seed: int, *, output: float = 0.0) -> NDArray[np.float64]:
        """Random hidden weights; output weights normal with deviation ``output``. Shape (size,)."""
        random = np.random.default_rng(seed)
        weights = random.normal(size=(self.units, len(self.feature_scales) + 2))
        weights[:, -2] *= 0.5
        weights[:, -1] *= output
        return weights.ravel()

    def function(self, operations: Operations) -> Callable[..., Any]:
        """network(x, u, w): features are the states followed by the inputs."""
        absolute, saturate = operations.absolute, operations.saturate
        units, clip, scale = self.units, self.clip, self.scale
        scales = tuple(1.0 / value for value in self.feature_scales)
        features = len(scales)
        width = features + 2

        def network(x: Any, u: Any, w: Any) -> Any:
            states = len(x)
            total = 0.0
            for i in range(units):
                s = w[width * i + features]
                for j in range(features):
                    value = x[j] if j < states else u[j - states]
                    s += w[width * i + j] * saturate(value * scales[j], clip)
                total += w[width * i + features + 1] * s / (1.0 + absolute(s))
            return scale * total

        return operations.function(network)

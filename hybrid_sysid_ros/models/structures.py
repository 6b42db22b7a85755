"""The structures that can be identified, by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.equations import Equation
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.models.black_box import BlackBox
from hybrid_sysid_ros.models.hybrid import Hybrid
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.network import Network
from hybrid_sysid_ros.models.stribeck import Stribeck

STRUCTURES = ("linear", "stribeck", "gray", "black_box", "hybrid")

HYBRID_UNITS = 4
"""Units of the residual's hidden layer."""

BLACK_BOX_UNITS = 8

RESIDUAL_SCALE = 0.1
"""Output scale of the residual, as part of the acceleration that one input scale causes."""


def assemble(
    structure: str,
    physics: Equation,
    *,
    network: Network | None = None,
    weights: NDArray[np.float64] | None = None,
) -> Equation:
    """An equation of a named structure on a rig's own equation, with a network where it has one.

    Raises UserError for an unknown name, and where a network or its weights (size,) are missing or don't fit.
    """
    plain = {"linear": Linear(), "stribeck": Stribeck(), "gray": physics}
    if structure in plain:
        return plain[structure]
    if structure not in STRUCTURES:
        raise UserError(f"structure {structure!r} is unknown; choose one of {', '.join(STRUCTURES)}")
    if network is None or weights is None or len(weights) != network.size:
        count = 0 if weights is None else len(weights)
        raise UserError(f"structure {structure}: {count} weights don't fit the network {network}")
    if structure == "black_box":
        return BlackBox(network=network, network_weights=weights)
    return Hybrid(physics=physics, network=network, network_weights=weights)


def build(structure: str, physics: Equation, *, scales: NDArray[np.float64], seed: int) -> Equation:
    """A structure before its fit, every parameter where a fit begins, so that no earlier result leaks in.

    physics: the rig's own equation. scales (states + inputs,): magnitude of each feature of a network in the training
    data. seed: of a network's first weights. Raises UserError for an unknown name.
    """
    gain = next((item.start for item in physics.parameters if item.name == "gain"), 1.0)
    units, share = (BLACK_BOX_UNITS, 1.0) if structure == "black_box" else (HYBRID_UNITS, RESIDUAL_SCALE)
    network = Network(
        units=units,
        feature_scales=tuple(float(f"{scale:.4g}") for scale in scales),
        scale=float(f"{share * gain * scales[len(physics.states)]:.4g}"),
    )
    weights = network.initial(seed, output=0.05)
    equation = assemble(structure, physics, network=network, weights=weights)
    return equation.with_values(np.array([item.start for item in equation.parameters]))


def network_of(equation: Equation) -> Network | None:
    """The learned part's network, None where nothing is learned."""
    return getattr(equation, "network", None)

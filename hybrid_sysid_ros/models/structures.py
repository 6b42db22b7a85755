"""The structures that can be identified, by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models.black_box import BlackBox
from hybrid_sysid_ros.models.dahl import Dahl
from hybrid_sysid_ros.models.hybrid import Hybrid
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.lugre import LuGre
from hybrid_sysid_ros.models.narx import Narx
from hybrid_sysid_ros.models.network import Network
from hybrid_sysid_ros.models.options import Option, Options, complete
from hybrid_sysid_ros.models.recurrent import Recurrent
from hybrid_sysid_ros.models.stribeck import Stribeck
from hybrid_sysid_ros.support.errors import UserError

HYBRIDS = ("hybrid_joint", "hybrid_frozen", "hybrid")
"""Physics and network: the lecture's two on its linear model, and this project's on the rig's own equation."""

STRUCTURES = ("linear", "stribeck", "dahl", "lugre", "narx", "black_box", "recurrent", *HYBRIDS[:2], "gray", "hybrid")

SEEDED = ("black_box", "recurrent", *HYBRIDS)
"""Structures whose fit depends on a seed."""

_BIAS = Option(
    default=0.0, low=0.0, high=1.0, kind="float", description="prior deviation of each record's input bias, 0 for none"
)
_RIDGE = Option(default=1.0, low=0.01, high=100.0, kind="log", description="pull of a network's weights to zero")
_SCALE = Option(
    default=0.1, low=0.01, high=1.0, kind="log", description="size of the network, as part of the drive's acceleration"
)
_STARTS = Option(default=1, low=1, high=32, kind="int", description="points where a fit begins; the best one goes on")
_UNITS = Option(default=8, low=1, high=32, kind="int", description="of the network's hidden layer")
_FIT = {"bias": _BIAS, "starts": _STARTS}
_NETWORK = {"ridge": _RIDGE, **_FIT}

_OPTIONS: Mapping[str, Mapping[str, Option]] = {
    "linear": _FIT,
    "stribeck": _FIT,
    "dahl": _FIT,
    "lugre": _FIT,
    "gray": _FIT,
    "narx": {
        "output_lags": Option(default=1, low=1, high=6, kind="int", description="past outputs"),
        "input_lags": Option(default=2, low=1, high=6, kind="int", description="past inputs"),
        "degree": Option(default=3, low=1, high=3, kind="int", description="of the polynomial"),
        "terms": Option(default=4, low=0, high=40, kind="int", description="number of terms, 0 for BIC's"),
    },
    "black_box": {"units": _UNITS, **_NETWORK},
    "recurrent": {"units": Option(default=24, low=2, high=64, kind="int", description="hidden states of the GRU")},
    "hybrid_joint": {"units": _UNITS, "scale": replace(_SCALE, default=1.0), **_NETWORK},
    "hybrid_frozen": {"units": _UNITS, "scale": replace(_SCALE, default=1.0), **_NETWORK},
    "hybrid": {
        "units": replace(_UNITS, default=4),
        "scale": _SCALE,
        "members": Option(default=1, low=1, high=10, kind="int", description="networks of other seeds in the mean"),
        **_NETWORK,
        "ridge": replace(_RIDGE, default=10.0),
    },
}


def options_of(structure: str, physics: System) -> dict[str, Option]:
    """The options of a structure; on a rig's own equation also its terms, each 0 (left out) or 1.

    Raises UserError for an unknown name.
    """
    if structure not in _OPTIONS:
        raise UserError(f"structure {structure!r} is unknown; choose one of {', '.join(STRUCTURES)}")
    terms = {
        term: Option(default=int(term not in physics.doubtful_terms), low=0, high=1, kind="int", description="term")
        for term in (physics.terms if structure in ("gray", "hybrid") else ())
    }
    return {**_OPTIONS[structure], **terms}


def assemble(
    structure: str,
    physics: System,
    *,
    design: Mapping[str, Any] | None = None,
    weights: NDArray[np.float64] | None = None,
) -> System:
    """An equation of a named structure on a rig's own equation, with what is learned where it has such a part.

    design: what :attr:`~hybrid_sysid_ros.core.System.design` gave. Raises UserError for an unknown name, and
    where the design or the weights (size,) are missing or don't fit each other.
    """
    plain: dict[str, System] = {
        "linear": Linear(),
        "stribeck": Stribeck(),
        "dahl": Dahl(),
        "lugre": LuGre(),
        "gray": physics,
    }
    if structure in plain:
        return plain[structure]
    if structure not in STRUCTURES:
        raise UserError(f"structure {structure!r} is unknown; choose one of {', '.join(STRUCTURES)}")
    if design is None or weights is None:
        raise UserError(f"structure {structure}: the design or the weights of its learned part are missing")
    if structure == "narx":
        return Narx.of(design, weights)
    if structure == "recurrent":
        return Recurrent.of(design, weights)
    network = Network.of(design)
    if len(weights) != network.size:
        raise UserError(f"structure {structure}: {len(weights)} weights don't fit the network {network}")
    if structure == "black_box":
        return BlackBox(network=network, network_weights=weights)
    base = physics if structure == "hybrid" else Linear()
    return Hybrid(physics=base, network=network, network_weights=weights)


def build(
    structure: str, physics: System, *, scales: NDArray[np.float64], seed: int, options: Options | None = None
) -> tuple[System, tuple[str, ...]]:
    """A structure before its fit, every parameter where a fit begins, so that no earlier result leaks in; and the names
    of the parameters that the fit must leave as they are, since their term is switched off.

    physics: the rig's own equation. scales (states + inputs,): magnitude of each feature of a network in the training
    data. seed: of a network's first weights. Raises UserError for an unknown name or option, and for narx and
    recurrent, which are not built before their data are seen.
    """
    chosen = complete(options or {}, options_of(structure, physics), structure)
    if structure in ("narx", "recurrent"):
        raise UserError(f"structure {structure}: is made of its data, so it can't be built before them; identify it")
    design = weights = None
    if structure in ("black_box", *HYBRIDS):
        gain = next((item.start for item in physics.parameters if item.name == "gain"), 1.0)
        network = Network(
            units=int(chosen["units"]),
            feature_scales=tuple(float(f"{scale:.4g}") for scale in scales),
            scale=float(f"{chosen.get('scale', 1.0) * gain * scales[len(physics.states)]:.4g}"),
        )
        design, weights = asdict(network), network.initial(seed, output=0.05)
    system = assemble(structure, physics, design=design, weights=weights)
    system = system.with_values(np.array([item.start for item in system.parameters]))
    return system.without([term for term in system.terms if not chosen.get(term, 1)])

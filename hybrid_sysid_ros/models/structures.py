"""The structures that can be identified: one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from hybrid_sysid_ros.core import Softsign, System
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.core.symbolic import linearised
from hybrid_sysid_ros.models.difnn import Difnn
from hybrid_sysid_ros.models.hybrid import Hybrid, block_of, features_of
from hybrid_sysid_ros.models.lagged import Lagged
from hybrid_sysid_ros.models.linear import REACH, Friction, Linear
from hybrid_sysid_ros.models.narx import Narx
from hybrid_sysid_ros.models.options import Option, Options, complete
from hybrid_sysid_ros.models.recurrent import Recurrent
from hybrid_sysid_ros.models.region import Region
from hybrid_sysid_ros.models.residual import ResidualHybrid
from hybrid_sysid_ros.models.takagi_sugeno import TakagiSugeno
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

_RIDGE = Option(default=1.0, low=0.01, high=100.0, kind="log", description="pull of a network's weights to zero")
_SCALE = Option(
    default=1.0, low=0.01, high=1.0, kind="log", description="size of the network, as part of what the inputs do"
)
_STARTS = Option(default=1, low=1, high=32, kind="int", description="points where a fit begins; the best one goes on")
_UNITS = Option(default=8, low=1, high=32, kind="int", description="of the network's hidden layer")
_EVERYWHERE = Option(
    default=0, low=0, high=1, kind="int", description="1: a network on all rates, not only where friction is"
)
_BLOCKS = {
    "affine_rules": Option(
        default=0, low=0, high=20, kind="int", description="Takagi-Sugeno rules in place of the network, 0: none"
    ),
    "linked_rules": Option(
        default=0, low=0, high=40, kind="int", description="fuzzy-neural (DIFNN) ones in place of it, 0: none"
    ),
}
_INPUT_BIAS = Option(
    default=0.0,
    low=0.0,
    high=0.05,
    kind="float",
    description="prior deviation of a constant bias of each record's inputs, as part of their span; 0: none",
)
_MEMBERS = Option(default=1, low=1, high=10, kind="int", description="networks of other seeds in the mean")
_FIT = {"starts": _STARTS, "input_bias": _INPUT_BIAS}
_NETWORK = {"units": _UNITS, **_BLOCKS, "scale": _SCALE, "everywhere": _EVERYWHERE, "ridge": _RIDGE, **_FIT}
_ANCHORED = {
    **_NETWORK,
    "units": replace(_UNITS, default=4),
    "scale": replace(_SCALE, default=0.1),
    "members": _MEMBERS,
    "ridge": replace(_RIDGE, default=10.0),
}
_NARX = {
    "output_lags": Option(default=1, low=1, high=6, kind="int", description="past outputs"),
    "input_lags": Option(default=2, low=1, high=6, kind="int", description="past inputs"),
    "degree": Option(default=3, low=1, high=3, kind="int", description="of the polynomial"),
    "terms": Option(default=4, low=0, high=40, kind="int", description="number of terms of an output, 0 for BIC's"),
}
_TAKAGI_SUGENO = {
    "output_lags": Option(default=2, low=0, high=6, kind="int", description="past outputs, 0: of inputs alone"),
    "input_lags": _NARX["input_lags"],
    "rules": Option(default=0, low=0, high=40, kind="int", description="how many, 0: until validation falls no more"),
    "all_premises": Option(
        default=0, low=0, high=1, kind="int", description="1: rules by all lags, not only by those of use"
    ),
    "gustafson_kessel": Option(
        default=0, low=0, high=1, kind="int", description="1: clusters are ellipsoids, not fuzzy C-means"
    ),
}
_DIFNN = {
    "output_lags": replace(_TAKAGI_SUGENO["output_lags"], default=1),
    "input_lags": replace(_NARX["input_lags"], default=1),
    "terms": Option(default=5, low=1, high=40, kind="int", description="of each lag and of each output"),
    "least": Option(default=3, low=1, high=1000, kind="int", description="samples that a rule must be the winner of"),
}
_RESIDUAL = {
    "output_lags": Option(default=3, low=1, high=6, kind="int", description="past residuals of each output"),
    "input_lags": Option(default=2, low=1, high=6, kind="int", description="past inputs"),
    "units": replace(_UNITS, default=12, low=0, description="of the residual's network, 0: none"),
    "degree": Option(default=1, low=0, high=3, kind="int", description="of the residual's polynomial, 0: none"),
    "terms": Option(default=0, low=0, high=40, kind="int", description="products in it for an output, 0 for BIC's"),
    "members": _MEMBERS,
    "ridge": replace(_RIDGE, default=0.3),
    **_FIT,
}
_RECURRENT = {"units": Option(default=24, low=2, high=64, kind="int", description="hidden states of the GRU")}


@dataclass(frozen=True, kw_only=True)
class Structure:
    """A row of the table."""

    physics: Literal["own", "viscous", "stribeck", "dahl", "lugre", "straight", "none"]
    """The rig's own system, the linear one of its signature with a friction, its straight part, or nothing."""
    network: Literal["", "joint", "frozen", "anchored", "residual"] = ""
    """Whether something learned is added, and what becomes of the physics: fitted with it, fitted before and then left,
    fitted before and then held near, or fitted before and simulated without it, what is learned beside.
    """
    options: Mapping[str, Option] = field(default_factory=lambda: _FIT)
    everywhere: bool = False
    """A network on all rates, whatever the options say."""

    @property
    def seeded(self) -> bool:
        """Whether a fit depends on a seed."""
        return bool(self.network) or self.options in (_RECURRENT, _TAKAGI_SUGENO, _DIFNN)


TABLE: Mapping[str, Structure] = {
    "linear": Structure(physics="viscous"),
    "stribeck": Structure(physics="stribeck"),
    "dahl": Structure(physics="dahl"),
    "lugre": Structure(physics="lugre"),
    "narx": Structure(physics="none", options=_NARX),
    "black_box": Structure(
        physics="straight",
        network="joint",
        everywhere=True,
        options={name: option for name, option in _NETWORK.items() if name not in ("scale", "everywhere")},
    ),
    "takagi_sugeno": Structure(physics="none", options=_TAKAGI_SUGENO),
    "difnn": Structure(physics="none", options=_DIFNN),
    "recurrent": Structure(physics="none", options=_RECURRENT),
    "hybrid_joint": Structure(physics="viscous", network="joint", options=_NETWORK),
    "hybrid_frozen": Structure(physics="viscous", network="frozen", options=_NETWORK),
    "gray": Structure(physics="own"),
    "hybrid": Structure(physics="own", network="anchored", options=_ANCHORED),
    "residual": Structure(physics="own", network="residual", options=_RESIDUAL),
}
"""By name. A rig may offer further gray boxes of its own, and any gray box G has its anchored hybrid, hybrid_G, and its
hybrid by residual, residual_G.
"""

RECURRENCES: Mapping[str, type[Lagged] | type[Recurrent]] = {
    "narx": Narx,
    "takagi_sugeno": TakagiSugeno,
    "difnn": Difnn,
    "recurrent": Recurrent,
}
"""Those that stand on no physics, and what makes them again."""
STRUCTURES = tuple(TABLE)
Boxes = Mapping[str, System]
"""Further gray boxes of a rig, by name."""


def structure_of(name: str, boxes: Boxes | None = None) -> tuple[Structure, str]:
    """The row of a structure, and the name of its gray box; a rig's own boxes go before the table's of the same name.

    Raises UserError for an unknown name.
    """
    known = {**{box: TABLE[box] for box in TABLE if _gray(TABLE[box])}, **dict.fromkeys(boxes or {}, TABLE["gray"])}
    if name in TABLE and name not in known:
        row = TABLE[name]
        return row, {"own": "gray", "viscous": "linear"}.get(row.physics, row.physics)
    if name in known:
        return known[name], name
    kind, _, box = name.partition("_")
    if box in known and kind in ("hybrid", "residual"):
        return replace(TABLE[kind], physics=known[box].physics), box
    names = ", ".join(dict.fromkeys((*TABLE, *(boxes or {}))))
    raise UserError(
        f"structure {name!r} is unknown; choose one of {names}, or hybrid_NAME or residual_NAME of a gray box"
    )


def _gray(row: Structure) -> bool:
    return not row.network and row.physics != "none"


def options_of(structure: str, physics: System, boxes: Boxes | None = None) -> dict[str, Option]:
    """The options of a structure; on a rig's own system also its terms, each 0 (left out) or 1.

    Raises UserError for an unknown name.
    """
    row, box = structure_of(structure, boxes)
    own = (boxes or {}).get(box, physics)
    terms = {
        term: Option(default=int(term not in own.doubtful_terms), low=0, high=1, kind="int", description="term")
        for term in (own.terms if row.physics == "own" else ())
    }
    return {**row.options, **terms}


def _physics(row: Structure, box: str, physics: System, boxes: Boxes | None, design: Mapping[str, Any]) -> System:
    """The system that a structure stands on."""
    if boxes and box in boxes:
        return boxes[box]
    if row.physics == "own":
        return physics
    friction: Friction = "viscous"
    if row.physics in ("stribeck", "dahl", "lugre"):
        friction = row.physics
    return Linear(
        origin=physics,
        friction=friction,
        straight=row.physics == "straight",
        scales=tuple(design.get("scales", ())),
        begin=design.get("begin"),
        unshown=tuple(design.get("unshown", ())),
    )


def assemble(
    structure: str,
    physics: System,
    *,
    design: Mapping[str, Any] | None = None,
    weights: Array | None = None,
    boxes: Boxes | None = None,
) -> System:
    """A system of a named structure on a rig's own one, with what is learned where it has such a part.

    design: what :attr:`~hybrid_sysid_ros.core.System.design` gave. Raises UserError for an unknown name, and
    where the design or the weights (size,) are missing or don't fit each other.
    """
    row, box = structure_of(structure, boxes)
    if _gray(row):
        return _physics(row, box, physics, boxes, design or {})
    if design is None or weights is None:
        raise UserError(f"structure {structure}: the design or the weights of its learned part are missing")
    if structure in RECURRENCES:
        return RECURRENCES[structure].of(design, weights)
    base = _physics(row, box, physics, boxes, design.get("physics") or {})
    if row.network == "residual":
        return ResidualHybrid.of(base, design, weights)
    on, features = tuple(design["on"]), len(features_of(base))
    return Hybrid(
        physics=base,
        on=on,
        block=block_of(design, features, len(on)),
        scales=(1.0,) * (features + len(on)),
        network_weights=weights,
        region=Region.everywhere(features) if set(on) <= set(corrected_by(base, {})) else None,
    )


def corrected_by(system: System, options: Mapping[str, Any]) -> tuple[str, ...]:
    """The closures of a system that a hybrid adds to; none where it adds to rates."""
    return () if options.get("everywhere") else tuple(item.name for item in system.closures)


def rates_of(system: System, *, everywhere: bool) -> tuple[str, ...]:
    """States to whose rates a network adds: those that carry contacts, or all that don't just follow a velocity."""
    carriers = tuple(dict.fromkeys(contact.on for contact in system.contacts))
    if carriers and not everywhere:
        return carriers
    return tuple(item.name for i, item in enumerate(system.declared_states) if i not in system.kinematics)


def build(
    structure: str,
    physics: System,
    *,
    scales: Array,
    seed: int,
    options: Options | None = None,
    centre: Array | None = None,
    features: Array | None = None,
    unshown: tuple[str, ...] = (),
    boxes: Boxes | None = None,
) -> tuple[System, tuple[str, ...]]:
    """A structure before its fit, every parameter where a fit begins, so that no earlier result leaks in; and the names
    of the parameters that the fit must leave as they are, since their term is switched off.

    physics: the rig's own system. scales, centre (states + inputs,): magnitude of each declared state and input in the
    training data, and their means. features: magnitudes of the features that the rig's own system declares. seed: of a
    network's first weights. unshown: states that no record shows.

    Raises UserError for an unknown name or option, for a structure that makes no sense on the rig, and for
    recurrences and residual, which are not built before their data are seen.
    """
    row, box = structure_of(structure, boxes)
    chosen = complete(options or {}, options_of(structure, physics, boxes), structure)
    if row.physics == "none" or row.network == "residual":
        raise UserError(f"structure {structure}: is made of its data, so it can't be built before them; identify it")
    own = physics.with_values([item.start for item in physics.parameters])
    n, at = len(own.declared_states), np.zeros(len(scales)) if centre is None else centre
    a, b = linearised(own, np.append(at[:n], np.zeros(len(own.states) - n)), at[n:])
    # What inputs do to each rate; where that is nothing, or out of an entry's reach from what states do, then these.
    # What states do to a velocity says little: springs between positions cancel.
    effects, through = np.abs(b) @ scales[n:], np.abs(a) @ scales[:n]
    moves = np.isin(np.arange(n), [*own.kinematics.values()])
    effects = np.where(effects > np.where(moves, 0.0, through / REACH), effects, through)
    efforts = tuple(scale_of(value) if value > 0.0 else 1.0 for value in effects)
    design: dict[str, Any] = {"scales": [*map(scale_of, scales), *efforts], "unshown": unshown}
    system = _physics(row, box, physics, boxes, design)
    if isinstance(system, Linear):
        system = system.begun(_entries(system, a, b))
    system = system.with_values([item.start for item in system.parameters])
    if row.network:
        on, sizes = corrected_by(system, chosen), [float(chosen.get("scale", 1.0))] * len(system.closures)
        region = Region.everywhere(len(features_of(system))) if on else None
        if not on:
            having = {item.name for item in system.declared_states}
            chosen_rates = rates_of(own, everywhere=row.everywhere or bool(chosen.get("everywhere")))
            on = tuple(name for name in chosen_rates if name in having)
            names = [item.name for item in own.declared_states]
            sizes = [scale_of(float(chosen.get("scale", 1.0)) * efforts[names.index(name)]) for name in on]
        sized = dict(zip((item.name for item in (*own.declared_states, *own.inputs)), scales.tolist(), strict=True))
        by_name = np.array([sized.get(item.name, 1.0) for item in features_of(system)])
        seen = features if system.features and features is not None else by_name
        block = block_of(chosen, len(seen), len(on))
        system = Hybrid(
            physics=system,
            on=on,
            block=block,
            scales=(*map(scale_of, seen), *sizes),
            network_weights=block.initial(seed, output=0.05) if isinstance(block, Softsign) else np.zeros(block.size),
            region=region,
        )
    return system.without([term for term in system.terms if not chosen.get(term, 1)])


def _entries(system: Linear, a: Array, b: Array) -> dict[str, float]:
    """Where entries of a linear system begin: at the derivatives of the rig's own law."""
    rows = [item.name for item in system.origin.declared_states]
    columns = [*rows, *(item.name for item in system.origin.inputs)]
    known, found = {item.name for item in system.parameters}, {}
    for row, values in zip(rows, np.concatenate([a, b], axis=1), strict=True):
        for column, value in zip(columns, values, strict=True):
            name, sign = (f"{row}_per_{column}", 1.0)
            if name not in known and row == column:
                name, sign = f"{row}_damping", -1.0
            if name in known and value:
                found[name] = sign * float(value)
    return found

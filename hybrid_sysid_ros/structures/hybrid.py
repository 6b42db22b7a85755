"""Hybrids: physics with a learned part in its rates or closures, fitted together or one after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import scipy

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.hybrid_system import Hybrid, averaged_hybrid, block_kinds, block_of, features_of, kind_of
from hybrid_sysid_ros.models.region import Region
from hybrid_sysid_ros.models.structure import FitContext, Magnitudes, Option, Options, Structure
from hybrid_sysid_ros.structures.gray_box import FIT_OPTIONS, STRAIGHT, GrayBox, LinearisedLaw
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIDGE = Option(default=1.0, low=0.01, high=100.0, kind="log", description="Penalty of a network's weights.")
MEMBERS = Option(default=1, low=1, high=10, kind="int", description="Number of averaged networks.", searched=False)
LEARNED_OPTIONS = {
    "scale": Option(
        default=1.0, low=0.01, high=1.0, kind="log", description="Size of the network, relative to the inputs' effect."
    ),
    "everywhere": Option(
        default=0, low=0, high=1, kind="int", description="1: a network on all rates, not only those with friction."
    ),
    "ridge": RIDGE,
    **FIT_OPTIONS,
}


class JointHybrid(Structure):
    """Physics and a learned part, fitted together."""

    summary = "physics and a network, fitted together"
    seeded = True
    default_box = "linear"
    everywhere: ClassVar[bool] = False
    """Whether the learned part is on all rates, whatever the options are."""

    @property
    def options(self) -> Mapping[str, Option]:
        own = {name: kind.option for name, kind in block_kinds().items()} | LEARNED_OPTIONS
        return {**own, **{name: option for name, option in self.gray.options.items() if name not in own}}

    def assemble(self, design: Mapping[str, Any], weights: Array) -> System:
        base = self.gray.assemble(design.get("physics") or {}, np.zeros(0))
        if "on" not in design:
            raise UserError("its design does not say on which rates the network acts, as in very old models; fit again")
        on, features = tuple(design["on"]), len(features_of(base))
        return Hybrid(
            physics=base,
            on=on,
            block=block_of(design, features, len(on)),
            scales=(1.0,) * (features + len(on)),
            network_weights=weights,
            region=Region.everywhere(features) if set(on) <= set(closures_of(base, {})) else None,
        )

    def build(self, sizes: Magnitudes, options: Options, seed: int) -> tuple[Hybrid, tuple[str, ...]]:
        own, share = self.physics, float(options.get("scale", 1.0))
        system, held = self.gray.build(sizes, options, seed)
        on, outputs = closures_of(system, options), [share] * len(system.closures)
        region = Region.everywhere(len(features_of(system))) if on else None
        if not on:
            efforts = LinearisedLaw.of(own, sizes).efforts
            having = {item.name for item in system.declared_states}
            rates = rates_of(own, everywhere=self.everywhere or bool(options.get("everywhere")))
            on = tuple(name for name in rates if name in having)
            names = [item.name for item in own.declared_states]
            outputs = [scale_of(share * efforts[names.index(name)]) for name in on]
        named = (item.name for item in (*own.declared_states, *own.inputs))
        sized = dict(zip(named, sizes.scales.tolist(), strict=True))
        seen = np.array([sized.get(item.name, 1.0) for item in features_of(system)])
        if system.features and sizes.features is not None:
            seen = sizes.features
        block = block_of(options, len(seen), len(on))
        hybrid = Hybrid(
            physics=system,
            on=on,
            block=block,
            scales=(*map(scale_of, seen), *outputs),
            network_weights=kind_of(block).initial(block, seed),
            region=region,
        )
        return hybrid, held

    def initialised(self, context: FitContext, seed: int) -> tuple[Hybrid, tuple[str, ...]]:
        """The hybrid with initial values from its training data, and the names of the parameters that are held."""
        from hybrid_sysid_ros.identification.initial_values import initialised

        system, held = self.build(context.magnitudes, context.options, seed)
        system = replace(system, physics=self.gray.initial_guess(system.physics, context))
        return initialised(system, context.experiments(self.physics), seed=seed), held

    def fit(self, context: FitContext) -> Fit:
        system, held = self.initialised(context, context.seed)
        return context.fit_physics([system], hold=held)


class BlackBox(JointHybrid):
    """A network on all rates, with the linear effect of the inputs beside it."""

    summary = "a network on all rates"
    default_box = ""
    everywhere = True

    @property
    def gray(self) -> Structure:
        return GrayBox(name=STRAIGHT, physics=self.physics, boxes=self.boxes)

    @property
    def options(self) -> Mapping[str, Option]:
        return {name: option for name, option in super().options.items() if name not in ("scale", "everywhere")}


class FrozenHybrid(JointHybrid):
    """Physics that is fitted first and held afterwards, while a network learns the residual."""

    summary = "physics, then a network beside it"

    def fit(self, context: FitContext) -> Fit:
        gray = self.gray.fit(context.of(self.gray))
        system, held = self.initialised(context, context.seed)
        found = context.fit_physics([replace(system, physics=gray.system)], hold=(*held, *gray.names), starts=1)
        return replace(
            found,
            names=(*gray.names, *found.names),
            covariance=scipy.linalg.block_diag(gray.covariance, found.covariance),
            by_cost=scipy.linalg.block_diag(gray.by_cost, found.by_cost),
        )


class AnchoredHybrid(JointHybrid):
    """Fits the gray box first, then networks of several seeds on it, which are averaged into one, so that they learn
    the residual of the physics and no single seed decides.

    The physics' parameters stay near those of the gray box. Where closures are corrected, the parameters are held.
    """

    summary = "physics, then a small network with the physics held near"
    default_box = "gray"
    combines = True

    @property
    def options(self) -> Mapping[str, Option]:
        found = dict(super().options)
        for name, default in (("units", 4), ("scale", 0.1), ("ridge", 10.0)):
            found[name] = replace(found[name], default=default)
        return {"members": MEMBERS, **found}

    def fit(self, context: FitContext) -> Fit:
        from hybrid_sysid_ros.identification.fitting import STAGES

        gray = self.gray.fit(context.of(self.gray))
        frozen = bool(closures_of(gray.system, context.options))
        members = []
        for member in range(int(context.options["members"])):
            seed = context.seed + 1000 * member
            system, held = self.initialised(context, seed)
            members.append(
                context.fit_physics(
                    [replace(system, physics=gray.system)],
                    hold=(*held, *(gray.names if frozen else ())),
                    anchor=None if frozen else gray,
                    stages=STAGES[-2:],
                    starts=1,
                    seed=seed,
                )
            )
        return replace(
            gray,
            **({} if frozen else _together(members)),
            system=averaged_hybrid([found.system for found in members if isinstance(found.system, Hybrid)]),
            relative_error=float(np.mean([found.relative_error for found in members])),
            chi_squared=None if gray.chi_squared is None else float(np.mean([found.chi_squared for found in members])),
            seconds=gray.seconds + sum(found.seconds for found in members),
            evaluations=gray.evaluations + sum(found.evaluations for found in members),
        )


def _together(members: Sequence[Fit]) -> dict[str, Any]:
    """Names and covariances of averaged fits: those of the one, or of physics alone, whose members err alike, so that
    their own spread comes on top.
    """
    first = members[0]
    if len(members) == 1:
        keys = "names", "covariance", "by_cost", "effective", "block_spread"
        return {key: getattr(first, key) for key in keys}
    physical = [i for i, name in enumerate(first.names) if not name.startswith("weight_")]
    places = [[item.name for item in first.system.parameters].index(first.names[i]) for i in physical]
    spread = np.atleast_2d(np.cov([found.system.values[places] for found in members], rowvar=False))
    means = {
        key: np.mean([getattr(found, key)[np.ix_(physical, physical)] for found in members], axis=0)
        for key in ("covariance", "by_cost")
    }
    covariance = means["covariance"] + spread / len(members)
    return {
        "names": tuple(first.names[i] for i in physical),
        **means,
        "covariance": covariance,
        "block_spread": np.zeros(0),
    }


def closures_of(system: System, options: Mapping[str, Any]) -> tuple[str, ...]:
    """The closures of a system that a hybrid adds to; none where it adds to rates."""
    return () if options.get("everywhere") else tuple(item.name for item in system.closures)


def rates_of(system: System, *, everywhere: bool) -> tuple[str, ...]:
    """States to whose rates a network adds: those with contacts, or all except positions that follow a velocity."""
    carriers = tuple(dict.fromkeys(contact.on for contact in system.contacts))
    if carriers and not everywhere:
        return carriers
    return tuple(item.name for i, item in enumerate(system.declared_states) if i not in system.kinematics)

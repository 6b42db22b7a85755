"""Hybrid systems: physics with a small learned residual."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from hybrid_sysid_ros.core import Parameter, Softsign, System, Variable
from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.steppers import Rates
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.models.region import Region
from hybrid_sysid_ros.models.structure import Option
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

CLIP = 1.5
"""Features are limited to +-CLIP times their scale, since a network is not trained beyond it."""

CORNER = 0.05
"""Width of that limit's rounded corners for solvers that need derivatives, in the features' scale."""


@dataclass(frozen=True, kw_only=True)
class Hybrid(Wrapper):
    """The physics with a learned part S n(z / s), where n is a block: a network, or fuzzy rules.

    z: the features of the physics, or else the declared states, then the inputs. s, S: scales, which are fixed
    parameters, so that blocks of one shape share their compiled code. ``on`` decides to which it is added:

        rates of states         x' = f(x, u) + E S n(clip(z / s)): |S n| is bounded, whatever the motion
        closures            x' = f(x, u, c + E S n(z / s) phi(z / s)), where phi fades beyond the training data
                                (:class:`~.region.Region`), so that far away only the physics is left

    Raises UserError where weights or scales don't fit the block, or ``on`` does not fit the physics.
    """

    on: tuple[str, ...]
    """Names of states to whose rates the block adds, or of closures to which it adds."""
    block: Block
    """The block, with one output for each name in ``on``."""
    scales: tuple[float, ...]
    """Scales of the features, then of the block's outputs."""
    network_weights: Array
    """Weights of the block."""
    region: Region | None = None
    """Region of the training data, where the block is on closures."""

    def __post_init__(self) -> None:
        super().__post_init__()
        kind, known = ("state", self.declared_states) if self.region is None else ("closure", self.physics.closures)
        unknown = set(self.on) - {item.name for item in known}
        if unknown or not self.on:
            raise UserError(f"hybrid: its network is on {', '.join(sorted(unknown)) or 'nothing'}, which is no {kind}")
        if len(self.scales) != self.block.features + len(self.on) or len(self.network_weights) != self.block.size:
            raise UserError(
                f"hybrid: {len(self.network_weights)} weights don't fit {type(self.block).__name__} of "
                f"{self.block.size}, or {len(self.scales)} scales its features; fit again"
            )

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.physics.form, self.on, self.block, self.region is None)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        features, units = features_of(self.physics), {item.name: item.unit for item in self.physics.closures}
        rates = {item.name: f"{item.unit}/s" for item in self.declared_states}
        named = [(f"scale_{item.name}", item.unit) for item in features]
        taken = {name for name, _ in named}  # a state may be called as another one's rate
        named += [
            (f"scale_{name}_rate" + "_added" * (f"scale_{name}_rate" in taken), rates[name])
            if self.region is None
            else (f"scale_{name}", units[name])
            for name in self.on
        ]
        edges = [] if self.region is None else Region.names([item.name for item in features])
        return (
            *self.physics.parameters,
            *(of_data(name, unit) for name, unit in named),
            *(of_data(name, "1", low=-1e12) for name in edges),
        )

    @property
    def values(self) -> Array:
        region = () if self.region is None else self.region.numbers
        return np.concatenate([self.physics.values, self.scales, region])

    def bound(self, values: Sequence[Scalar]) -> Hybrid:
        physical = len(self.physics.parameters)
        scales, edges = physical + len(self.scales), self.region
        return replace(
            self,
            physics=self.physics.bound(values[:physical]),
            scales=tuple(values[physical:scales]),
            region=None if edges is None else replace(edges, numbers=tuple(values[scales:])),
        )

    @property
    def design(self) -> dict[str, Any]:
        return {**size_of(self.block), "on": list(self.on), "physics": self.physics.design}

    @property
    def weights(self) -> Array:
        return self.network_weights

    def with_weights(self, weights: Array) -> Hybrid:
        return replace(self, network_weights=weights)

    def rates(self, physics: Rates, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        """The rates of the physics, plus the learned part where it is on rates."""
        found, names = super().rates(physics, x, u), [item.name for item in self.states]
        if self.region is None:
            for name, value in zip(self.on, self._learned(x, u), strict=True):
                found[names.index(name)] = found[names.index(name)] + value
        return found

    @property
    def _computed(self) -> System:
        """The physics, with the learned part in its closures where it is on these."""
        if self.region is None:
            return self.physics
        names = [item.name for item in self.physics.closures]

        def more(x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
            learned = dict(zip(self.on, self._learned(x, u), strict=True))
            return [learned.get(name, 0.0) for name in names]

        return self.physics.corrected(more)

    def _learned(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        """The learned part, (on,)."""
        features, outputs = self.scales[: self.block.features], self.scales[self.block.features :]
        scaled = [value / scale for value, scale in zip(self.physics.feature(x, u), features, strict=True)]
        if self.region is None:
            scaled = [clip(value, -CLIP, CLIP, over=CORNER) for value in scaled]
            return [scale * value for value, scale in zip(self.block(scaled), outputs, strict=True)]
        share = self.region.share(scaled)
        return [scale * share * value for value, scale in zip(self.block(scaled), outputs, strict=True)]


def features_of(system: System) -> tuple[Variable, ...]:
    """The features of a network on a system."""
    return tuple(system.features) or (*system.declared_states, *system.inputs)


class BlockKind(ABC):
    """A kind of block that a hybrid may learn. An extension provides one as ``blocks``, under the name of the option
    that chooses it and gives its size; 0 chooses none.
    """

    made: ClassVar[type[Block]]
    """The class of its blocks."""
    size_field: ClassVar[str]
    """The field that holds a block's size, by which :meth:`block` makes it again."""
    option: ClassVar[Option]
    from_data: ClassVar[bool] = False
    """Whether its first weights depend on where the training data are."""

    @abstractmethod
    def block(self, size: int, features: int, outputs: int) -> Block: ...

    def initial(self, block: Block, seed: int) -> Array:
        """Weights (size,) before any data are seen."""
        return np.zeros(block.size)

    def initial_weights(self, block: Block, points: Array, seed: int) -> Array:
        """Initial weights (size,) of a fit; points (samples, features): training data in their scales."""
        raise NotImplementedError


class Network(BlockKind):
    """One hidden layer of softsigns."""

    made, size_field = Softsign, "units"
    option = Option(default=8, low=1, high=32, kind="int", description="Units of the network's hidden layer.")

    def block(self, size: int, features: int, outputs: int) -> Softsign:
        return Softsign(features=features, units=size, outputs=outputs)

    def initial(self, block: Block, seed: int) -> Array:
        assert isinstance(block, Softsign)
        return block.initial(seed, output=0.05)


NETWORK = "units"
"""The option of a network, which is learned where no other block is chosen."""


def block_kinds() -> dict[str, BlockKind]:
    """The kinds of blocks by the options that choose them, the network first."""
    return {NETWORK: Network(), **{name: kind() for name, kind in extensions.provided("blocks").items()}}


def block_of(sizes: Mapping[str, Any], features: int, outputs: int) -> Block:
    """The block that the sizes in options or in a stored design choose.

    Raises UserError for two kinds of blocks at once, and for one that is not installed.
    """
    kinds = block_kinds()
    chosen = [name for name in kinds if name != NETWORK and int(sizes.get(name) or 0)] or [NETWORK]
    if len(chosen) > 1:
        raise UserError(f"{' and '.join(chosen)}: a hybrid has either; leave one of them at 0")
    if chosen[0] not in sizes:
        unknown = ", ".join(sorted(set(sizes) - {"on", "physics"}))
        raise UserError(f"hybrid: what it learned is of a kind ({unknown}) whose extension is not installed")
    return kinds[chosen[0]].block(int(sizes[chosen[0]]), features, outputs)


def kind_of(block: Block) -> BlockKind:
    """The kind of a block."""
    return next(kind for kind in block_kinds().values() if type(block) is kind.made)


def size_of(block: Block) -> dict[str, int]:
    """The size by which :func:`block_of` makes a block again."""
    name, kind = next(item for item in block_kinds().items() if type(block) is item[1].made)
    return {name: int(getattr(block, kind.size_field))}


def averaged_hybrid(members: Sequence[Hybrid]) -> Hybrid:
    """The mean of hybrids of one shape: of their parameters, and one network that is the mean of their networks.

    Raises UserError for several members whose learned part is no network: the mean of rules has more rules.
    """
    first, outputs = members[0], len(members[0].on)
    if len(members) == 1:
        return first
    units = size_of(first.block).get(NETWORK)
    if units is None:
        raise UserError("members: only networks can be averaged, not rules; leave members at 1")
    weights = np.concatenate([member.network_weights.reshape(units, -1) for member in members])
    weights[:, -outputs:] /= len(members)
    return replace(
        first,
        physics=first.physics.with_values(np.mean([member.physics.values for member in members], axis=0)),
        block=block_of({NETWORK: units * len(members)}, first.block.features, outputs),
        network_weights=weights.ravel(),
    )

"""Fuzzy rules as blocks of hybrids."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.extensions.fuzzy.affine_rules import AffineRules
from hybrid_sysid_ros.extensions.fuzzy.linked_rules import LinkedRules
from hybrid_sysid_ros.extensions.fuzzy.memberships import packed
from hybrid_sysid_ros.models.hybrid_system import BlockKind
from hybrid_sysid_ros.models.structure import Option
from hybrid_sysid_ros.support.arrays import Array

CLUSTERED = 2000
"""Samples, evenly through the training data, of which rules get their centres."""


class AffineRulesKind(BlockKind):
    """Takagi-Sugeno rules: centres by fuzzy C-means of the features, its widths; they say nothing yet."""

    made, size_field, from_data = AffineRules, "rules", True
    option = Option(
        default=0,
        low=0,
        high=20,
        kind="int",
        description="Takagi-Sugeno rules in place of the network, 0: none",
        searched=False,
    )

    def block(self, size: int, features: int, outputs: int) -> AffineRules:
        return AffineRules(features=features, rules=size, outputs=outputs)

    def initial_weights(self, block: Block, points: Array, seed: int) -> Array:
        assert isinstance(block, AffineRules)
        centres = _centres(points, block.rules, seed)
        premises = packed(centres, np.ones_like(centres))
        return np.pad(premises, (0, block.size - len(premises)))


class LinkedRulesKind(BlockKind):
    """Fuzzy-neural rules, each with terms of its own: as wide as makes them half as true at the next centre."""

    made, size_field, from_data = LinkedRules, "terms", True
    option = Option(
        default=0,
        low=0,
        high=40,
        kind="int",
        description="fuzzy-neural (DIFNN) ones in place of it, 0: none",
        searched=False,
    )

    def block(self, size: int, features: int, outputs: int) -> LinkedRules:
        rules, links = tuple((i,) * features for i in range(size)), tuple((i, i) for i in range(size))
        return LinkedRules(rules=rules, links=(links,) * outputs, terms=size)

    def initial_weights(self, block: Block, points: Array, seed: int) -> Array:
        from hybrid_sysid_ros.extensions.fuzzy.clustering import HALF

        assert isinstance(block, LinkedRules)
        centres = _centres(points, block.terms, seed)
        apart = np.linalg.norm(centres[:, None] - centres, axis=2) + np.diag(np.full(block.terms, np.inf))
        widths = np.repeat(np.min(apart, axis=1)[:, None] / HALF, block.features, axis=1)
        said = np.zeros((block.outputs, block.terms))
        return np.concatenate([packed(centres.T, widths.T), packed(said, np.ones_like(said))])


def _centres(points: Array, count: int, seed: int) -> Array:
    from hybrid_sysid_ros.extensions.fuzzy.clustering import fuzzy_c_means

    return fuzzy_c_means(points[:: len(points) // CLUSTERED + 1], count, seed=seed)

"""Fuzzy-neural network of five layers (DIFNN): a recurrence by rules that are linked to terms of the outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.extensions.fuzzy.linked_rules import LinkedRules
from hybrid_sysid_ros.extensions.shared.lagged import Lagged
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Difnn(Lagged):
    """y_k(t + 1) = Y_k n_k(r): n the five layers of :class:`~.linked_rules.LinkedRules`, r of any number of lags.

    Centres and widths of the terms of inputs and outputs are what is learned. Raises UserError for rules, links or
    weights that don't fit each other.
    """

    KIND = "difnn"
    LEARNED = "term_weights"

    antecedents: tuple[tuple[int, ...], ...]
    """Of each rule the term of each entry of r."""
    links: tuple[tuple[tuple[int, int], ...], ...]
    """Of each output its links, from a rule to a term each."""
    clusters: int
    """Terms of each entry of r, and of each output."""
    term_weights: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.regressors)
        rules, terms = {*range(len(self.antecedents))}, {*range(self.clusters)}
        fitting = (
            all(len(rule) == count and set(rule) <= terms for rule in self.antecedents)
            and len(self.links) == len(self.outputs)
            and all({r for r, _ in links} == rules and {t for _, t in links} <= terms for links in self.links)
        )
        if not rules or not fitting or len(self.term_weights) != self.block.size:
            raise UserError(
                f"{self.KIND}: {len(self.antecedents)} rules, their links, {self.clusters} terms and "
                f"{len(self.term_weights)} weights don't fit {count} regressors; fit again"
            )

    @property
    def block(self) -> LinkedRules:
        """N."""
        return LinkedRules(rules=self.antecedents, links=self.links, terms=self.clusters)

    @property
    def form(self) -> tuple[Any, ...]:
        return (*super().form, self.antecedents, self.links, self.clusters)

    def following(self, r: Sequence[Scalar]) -> list[Scalar]:
        return self.block(r)

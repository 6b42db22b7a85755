"""Stratified live shots: how many of each condition, and how many that saves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Strata:
    """Conditions of shooting. Raises UserError where shares are not 1 together, or a probability is no guess at all."""

    shares: Array
    """p: of each condition in use, (strata,)."""
    successes: Array
    """a: first guess of the probability of success in each, as a simulation tells it, (strata,)."""

    def __post_init__(self) -> None:
        if not len(self.shares):
            raise UserError("there are no strata: give a row for each, its share and a guess of success")
        if not np.all(self.shares > 0.0) or abs(float(np.sum(self.shares)) - 1.0) > 1e-6:
            raise UserError(f"shares of strata are {_list(self.shares)}: they need to be positive and 1 together")
        if not np.all((self.successes > 0.0) & (self.successes < 1.0)):
            raise UserError(
                f"probabilities of success are {_list(self.successes)}: they need to lie between 0 and 1; "
                "guess .01 or .99 where a simulation never or always succeeds"
            )

    @property
    def efficiency(self) -> float:
        """K_a = A (1 - A) / (sum p_i sqrt(a_i (1 - a_i)))^2 >= 1, A = sum p_i a_i: as many unstratified shots tell what
        one stratified shot does (the paper prints its inverse).
        """
        overall = float(self.shares @ self.successes)
        return overall * (1.0 - overall) / float(np.sum(self._weights)) ** 2

    @property
    def saved(self) -> float:
        """Part of the live shots that stratifying them saves."""
        return 1.0 - 1.0 / self.efficiency

    def allocation(self, shots: int) -> NDArray[np.int64]:
        """Shots of each stratum, (strata,): n_i ~ p_i sqrt(a_i (1 - a_i)) (Neyman 1934), at least one.

        Raises UserError where there are fewer shots than strata.
        """
        if shots < len(self.shares):
            raise UserError(f"{shots} shots for {len(self.shares)} strata: each needs one at least")
        exact = shots * self._weights / np.sum(self._weights)
        counts = np.ones(len(exact), dtype=np.int64)
        for _ in range(shots - len(exact)):
            counts[np.argmax(exact - counts)] += 1
        return counts

    @property
    def _weights(self) -> Array:
        return np.asarray(self.shares * np.sqrt(self.successes * (1.0 - self.successes)))


def _list(values: Array) -> str:
    return ", ".join(f"{value:g}" for value in values)

"""Polynomial NARX: a recurrence in lagged outputs and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.extensions.narx.polynomial import Polynomial
from hybrid_sysid_ros.extensions.shared.lagged import Lagged
from hybrid_sysid_ros.support.errors import UserError

Term = tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Narx(Lagged):
    """y_k(t + 1) = Y_k sum_j theta_kj prod_i r_i(t)^e_kji: a polynomial in lags of all outputs and inputs.

    Billings (2013), Nonlinear system identification: NARMAX methods, section 2.2; r, Y and the states:
    :class:`~.lagged.Lagged`. Raises UserError for terms that don't fit the lags or the coefficients.
    """

    KIND = "NARX"
    LEARNED = "coefficients"

    exponents: tuple[tuple[Term, ...], ...]
    """e, for each output its terms, in the order of r."""
    coefficients: tuple[float, ...]
    """theta of all outputs: what is learned."""

    def __post_init__(self) -> None:
        super().__post_init__()
        lags, terms = len(self.regressors), [term for output in self.exponents for term in output]
        fitting = all(len(term) == lags and min(term) >= 0 for term in terms)
        if not fitting or len(terms) != len(self.coefficients) or len(self.exponents) != len(self.outputs):
            raise UserError(
                f"NARX: {len(self.coefficients)} coefficients don't fit {len(terms)} terms, or the terms "
                f"don't have {lags} exponents of 0 or more each"
            )

    @property
    def form(self) -> tuple[Any, ...]:
        return (*super().form, self.exponents)

    def following(self, r: Sequence[Scalar]) -> list[Scalar]:
        found, at = [], 0
        for terms in self.exponents:
            found += Polynomial(exponents=terms, features=len(r), at=at)(r)
            at += len(terms)
        return found

"""Grouping: what data tell of parameters that they can't tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.support.arrays import Array

DETERMINED = 0.3
"""Standard error of a direction, in that of the prior, below which the data determine it."""
LEAST_PIVOT, NEAR_WHOLE = 0.2, 0.2
"""Of an echelon form, and how near to a whole number an exponent is taken for it."""


@dataclass(frozen=True, kw_only=True)
class ParameterGroup:
    """A product of powers of parameters that the data determine, where they don't determine these apart."""

    exponents: Mapping[str, float]
    """By parameter, whole numbers where they are near to some."""
    value: float
    """In the units of the parameters."""
    relative_error: float
    """Standard error, as part of the value."""

    @property
    def content(self) -> dict[str, Any]:
        """As plain data."""
        return {"exponents": dict(self.exponents), "value": self.value, "relative_error": self.relative_error}

    def __str__(self) -> str:
        over = [_power(name, power) for name, power in self.exponents.items() if power > 0.0]
        under = [_power(name, -power) for name, power in self.exponents.items() if power < 0.0]
        formula = " / ".join(filter(None, (" ".join(over) or "1", " ".join(under))))
        return f"{formula} = {self.value:.5g} (standard error {100.0 * self.relative_error:.2g} %)"


def groups(fit: Fit) -> list[ParameterGroup]:
    """Of the parameters with a prior, those products of powers that the data determine; none where these determine each
    parameter, or no prior is the better known for them.

    In parameters counted in deviations of their priors the data determine the directions of small variance, as the
    curvature of the cost tells it; as exponents of the parameters these are rows of a matrix, which is brought to
    echelon form in the order in which the parameters are declared. How sure a product is tells the robust covariance.
    """
    pairs = zip(fit.system.parameters, fit.system.values.tolist(), strict=True)
    known = {item.name: (item.spread, value) for item, value in pairs if item.spread and value > 0.0}
    names = [name for name in fit.names if name in known]
    if len(names) < 2:
        return []
    index = [list(fit.names).index(name) for name in names]
    spreads, values = (np.array([known[name][k] for name in names], dtype=float) for k in (0, 1))
    shares, directions = np.linalg.eigh(fit.by_cost[np.ix_(index, index)] / np.outer(spreads, spreads))
    relative = fit.covariance[np.ix_(index, index)] / np.outer(values, values)
    determined = shares < DETERMINED**2
    if not determined.any() or determined.all():
        return []
    found = []
    for row in _echelon(directions[:, determined].T * (values / spreads)):
        error = np.sqrt(max(float(row @ relative @ row), 0.0))
        away = np.abs(row - np.round(row))
        whole = (away < NEAR_WHOLE) | (away * spreads / values < error)  # nobody could tell it from the whole number
        exponents = np.where(whole, np.round(row), row)
        exponents = -exponents if np.sum(exponents) < 0.0 else exponents
        found.append(
            ParameterGroup(
                exponents={name: float(power) for name, power in zip(names, exponents, strict=True) if power},
                value=float(np.prod(values**exponents)),
                relative_error=float(np.sqrt(max(exponents @ relative @ exponents, 0.0))),
            )
        )
    return found


def _echelon(rows: Array) -> Array:
    """The reduced echelon form of independent rows."""
    rows, done = rows / np.max(np.abs(rows), axis=1, keepdims=True), 0
    for column in range(rows.shape[1]):
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) < LEAST_PIVOT * np.max(np.abs(rows[done:])):
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    return np.asarray(rows)


def _power(name: str, power: float) -> str:
    return name if power == 1.0 else f"{name}^{power:g}"

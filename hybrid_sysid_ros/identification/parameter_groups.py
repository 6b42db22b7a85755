"""Parameter groups: products of parameters that data determine, where they don't determine each parameter."""

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
"""Least pivot of an echelon form, and the distance within which an exponent is rounded to a whole number."""


@dataclass(frozen=True, kw_only=True)
class ParameterGroup:
    """A product of powers of parameters that the data determine, while they don't determine each parameter."""

    exponents: Mapping[str, float]
    """Exponents by parameter; they are whole numbers where they are close to some."""
    value: float
    """Value of the product, in the units of the parameters."""
    relative_error: float
    """Standard error relative to the value."""

    @property
    def content(self) -> dict[str, Any]:
        """The group as plain data."""
        return {"exponents": dict(self.exponents), "value": self.value, "relative_error": self.relative_error}

    def __str__(self) -> str:
        over = [_power(name, power) for name, power in self.exponents.items() if power > 0.0]
        under = [_power(name, -power) for name, power in self.exponents.items() if power < 0.0]
        formula = " / ".join(filter(None, (" ".join(over) or "1", " ".join(under))))
        return f"{formula} = {self.value:.5g} (standard error {100.0 * self.relative_error:.2g} %)"


def groups(fit: Fit) -> list[ParameterGroup]:
    """Products of powers of the parameters with a prior that the data determine. There are none where the data
    determine each parameter, or improve on no prior.

    Measured in deviations of their priors, the parameters are determined in directions of small variance by the
    curvature of the cost. Written as exponents these directions are rows of a matrix, which is brought to echelon form
    in the order of the parameters. The standard error of a product comes from the robust covariance.
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
        whole = (away < NEAR_WHOLE) | (away * spreads / values < error)  # as good as the whole number
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

"""Identifiability: which parameters the data determine, and which only a prior or a bound determines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import Parameter
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array

EXPLAINED = 0.5
"""R2 of a run over a record of the fit below which it is doubted."""
HIGHLY_CORRELATED, KNOWN = 0.95, 0.01
"""Correlation from which two parameters can't be told apart, and the standard error, in a parameter's value, up to
which it is known beside all others.
"""
UNDETERMINED = 0.5
"""Ratio of the standard error to the prior deviation above which the data contributed little."""
AT_BOUND, ON_BOUND, FAR = 0.01, 0.001, 2.0
"""Distance from a bound, relative to the distance of both bounds, that counts as at the bound, even where that is more
than FAR standard errors.
"""


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """A parameter that the data don't determine. Values, errors and deviations are in its unit.

    standard_error: that of the fit, including priors. before: standard deviation before the fit: that of the prior, or
    of a uniform distribution between the bounds, (high - low) / sqrt 12, where there is no prior. at_bound: whether the
    estimate is at a bound, where a standard error means little. correlated: parameters that can change together with
    this one without much effect on the simulation, with correlation coefficients, largest first.
    """

    parameter: Parameter
    value: float
    standard_error: float
    before: float
    at_bound: bool
    correlated: tuple[tuple[str, float], ...]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons why the parameter is doubtful."""
        item, found = self.parameter, []
        if self.at_bound:
            side, bound = min((("lower", item.low), ("upper", item.high)), key=lambda end: abs(end[1] - self.value))
            found.append(f"stands at its {side} bound {bound:g}")
        if not np.isfinite(self.standard_error):
            found.append("has no effect on the output, or none of its own")
        elif self.standard_error > UNDETERMINED * self.before:
            known = "the prior's" if item.spread else "that of any value between its bounds,"
            found.append(f"is hardly known better than before (standard deviation of {known} {self.before:.2g})")
        if self.correlated:
            others = ", ".join(f"{name} ({coefficient:+.2f})" for name, coefficient in self.correlated)
            found.append(f"can't be told apart from {others}")
        return tuple(found)

    def __str__(self) -> str:
        unit = "" if self.parameter.unit == "1" else f" {self.parameter.unit}"
        error = f"{self.standard_error:.2g}" if np.isfinite(self.standard_error) else "unknown"
        return f"{self.parameter.name} = {self.value:.4g}{unit} (standard error {error}) {'; '.join(self.reasons)}"


def doubts(model: Model) -> list[Doubt]:
    """The free physical parameters of a model that its data don't determine, with those that they are correlated with.

    A parameter is doubted if its standard error is above UNDETERMINED times the deviation before the fit, if it is at a
    bound, has no effect, or is correlated by more than HIGHLY_CORRELATED with another and not known to KNOWN. The
    covariance is that of the linearised fit with its priors (Ljung 1999, section 9.4), which make errors smaller, never
    larger. A hybrid's physics has a second prior, the anchor to the gray box, which a model does not store: examine the
    gray box instead.
    """
    errors, pairs = model.standard_errors, correlated(model.names, model.covariance)
    found = []
    for item, value in zip(model.system.parameters, model.system.values, strict=True):
        if item.name not in errors:
            continue
        others = [(b if a == item.name else a, other) for a, b, other in pairs if item.name in (a, b)]
        others = others if errors[item.name] > KNOWN * abs(value) else []
        doubt = Doubt(
            parameter=item,
            value=float(value),
            standard_error=errors[item.name],
            before=item.spread or (item.high - item.low) / float(np.sqrt(12)),
            at_bound=at_bound(item, float(value), errors[item.name]),
            correlated=tuple((name, coefficient) for name, coefficient in others if name in errors),
        )
        found += [doubt] if doubt.reasons else []
    return found


def unexplained(model: Model) -> list[tuple[str, str, float]]:
    """Name, output and R2 of the runs over records of the fit that do not explain half of the output's variance."""
    alone = model.system.outputs[0].name
    return [
        (name, output, float(own["r2"]))
        for name, scores in model.scores.items()
        for output, own in scores.get("outputs", {alone: scores}).items()
        if not own["r2"] > EXPLAINED
    ]


def correlated(
    names: Sequence[str], covariance: Array, threshold: float = HIGHLY_CORRELATED
) -> list[tuple[str, str, float]]:
    """Pairs of estimates whose correlation is beyond +-threshold: their names and the coefficient, largest first."""
    coefficients = correlation(covariance)
    pairs = [
        (names[i], names[j], float(coefficients[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(coefficients[i, j]) > threshold
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def correlation(covariance: Array) -> Array:
    """Correlation coefficients (free, free) of a covariance; 0 for a parameter without variance."""
    deviations = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    scale = np.where(deviations > 0.0, deviations, np.inf)
    return np.asarray(covariance / np.outer(scale, scale))


def at_bound(item: Parameter, value: float, error: float = np.inf) -> bool:
    """Whether a fitted parameter is at one of its bounds, by its standard error, too; at a lower bound above 0 by
    magnitude, since 5 rad/s are far from 0.01 rad/s though both are small beside 1000.
    """
    range_ = item.high - item.low
    near = max(min(AT_BOUND, FAR * error / range_), ON_BOUND)
    share = (value - item.low) / range_
    small = item.low <= 0.0 or value <= item.low * (item.high / item.low) ** AT_BOUND
    return not item.fixed and ((not share > near and small) or not share < 1.0 - near)

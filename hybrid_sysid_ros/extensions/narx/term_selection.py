"""Terms of a polynomial NARX, chosen by how much of the output each explains."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.narx.narx import Narx
from hybrid_sysid_ros.extensions.shared.regression import Regression
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

MOST = 30
"""Largest number of terms that the information criterion chooses from."""

EXACT = 1e-10
"""Relative error of one step below which a model is exact, and more terms only fit rounding."""


def select_terms(
    experiments: Sequence[PreparedRecord],
    *,
    outputs: Sequence[Variable],
    inputs: Sequence[Variable],
    output_lags: int,
    input_lags: int,
    degree: int,
    terms: int | None = None,
) -> Narx:
    """The polynomials whose terms explain most of each y(t + 1) in several records, coefficients by least squares.

    Forward regression by orthogonal least squares (FROLS): of all products of at most ``degree`` lagged values, each
    next term is the one with the largest error reduction ratio. Its matrices come from every record by itself, so that
    no lag reaches from one record into another. Chen, Billings and Luo (1989), Orthogonal least squares methods and
    their application to non-linear system identification, Int. J. Control 50(5); here SysIdentPy's.

    outputs, inputs: their names and units. terms: how many each output gets; None takes the least Bayesian information
    criterion of one-step errors, which is right for data that a polynomial of these lags made, and too many for others:
    those simulate badly. The coefficients are the best for one step, not for a simulation; refine them by
    :func:`~hybrid_sysid_ros.identification.fitting.fit`.

    Raises UserError for lags, a degree or terms below 1, a record that is too short for the lags, a step that is not
    the period, more terms than candidates or samples, and where SysIdentPy is missing.
    """
    if min(output_lags, input_lags, degree, 1 if terms is None else terms) < 1:
        raise UserError("NARX: lags, degree and terms must be 1 or more")
    regression = Regression.of(experiments, output_lags=output_lags, input_lags=input_lags, kind="NARX")
    lagged, targets = regression.lagged, regression.targets
    candidates = exponents_of(lagged.shape[1], degree)
    values = np.stack([np.prod(lagged**term, axis=1) for term in candidates], axis=1)
    most = min(len(candidates), len(targets) - 1, MOST if terms is None else terms)
    if terms is not None and most < terms:
        raise UserError(
            f"NARX: {terms} terms of {len(candidates)} candidates and {len(targets)} samples; ask for {most} or fewer"
        )
    exponents, coefficients = [], []
    for target in targets.T:
        chosen = forward_selection(values, target, most)
        if terms is None:
            chosen = chosen[: least_criterion(values[:, chosen], target)]
        exponents.append(tuple(candidates[index] for index in chosen))
        coefficients += np.linalg.lstsq(values[:, chosen], target, rcond=None)[0].tolist()
    return Narx(**regression.shape(outputs, inputs), exponents=tuple(exponents), coefficients=tuple(coefficients))


def exponents_of(values: int, degree: int) -> list[tuple[int, ...]]:
    """Exponents of all products of at most ``degree`` of so many values, the constant first."""
    return [
        tuple(factors.count(value) for value in range(values))
        for size in range(degree + 1)
        for factors in combinations_with_replacement(range(values), size)
    ]


def forward_selection(values: Array, target: Array, count: int) -> NDArray[np.intp]:
    """Columns of values (rows, candidates) in the order in which forward regression takes them, (count,)."""
    with extra("narx"):
        from sysidentpy.model_structure_selection import FROLS
    # Its Householder reflections divide by zero where a leading row has an exact zero, as at rest; any order of rows
    # will do, so those come last.
    order = np.argsort(-np.abs(values).min(axis=1), kind="stable")
    selection: Any = FROLS(order_selection=False, n_terms=count, ylag=1, xlag=1)
    padded = np.concatenate([np.zeros(selection.max_lag), target[order]])[:, None]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        _, chosen, _ = selection.error_reduction_ratio(values[order], padded, count)
    return np.asarray(chosen, dtype=np.intp)


def least_criterion(values: Array, target: Array) -> int:
    """The number n of leading columns (rows, columns) with the least N ln s2 + n ln N, s2 the mean square of N errors.

    The Bayesian information criterion of Schwarz (1978).
    """
    exact = EXACT**2 * float(np.mean(target**2))

    def criterion(count: int) -> float:
        errors = target - values[:, :count] @ np.linalg.lstsq(values[:, :count], target, rcond=None)[0]
        return float(len(target) * np.log(max(float(np.mean(errors**2)), exact)) + count * np.log(len(target)))

    return min(range(1, values.shape[1] + 1), key=criterion)

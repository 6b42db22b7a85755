"""The structure of a DIFNN: its terms by range and clusters, its rules and their links by counting winners."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.fuzzy.clustering import HALF, k_means
from hybrid_sysid_ros.extensions.fuzzy.difnn import Difnn
from hybrid_sysid_ros.extensions.fuzzy.memberships import packed
from hybrid_sysid_ros.extensions.shared.regression import Regression, least_squares
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIDGE = 1e-6
"""Pull of the outputs' centres to those of their clusters, by the number of rows."""


def select_links(
    experiments: Sequence[PreparedRecord],
    *,
    outputs: Sequence[Variable],
    inputs: Sequence[Variable],
    output_lags: int,
    input_lags: int,
    terms: int,
    least: int = 1,
    seed: int = 0,
) -> Difnn:
    """Terms of each regressor evenly over its range, and of each output where its values cluster, half their height at
    the next one; as rules those sets of terms that are the nearest ones of some sample; and from each rule a link to
    that term of each output that was the nearest one most often then. Rules with fewer than ``least`` such samples are
    left out. Then the outputs' centres move to where they explain one step best, all terms of an output equally wide.

    Lin and Lee (1991), Neural-network-based fuzzy logic control and decision system, IEEE Trans. Computers 40(12), has
    one consequence a rule, too. Centres and widths are then to be tuned by :func:`~..fuzzy.tuned`.

    Raises UserError for lags that don't fit the records, more terms than different values, and rules without data.
    """
    regression = Regression.of(experiments, output_lags=output_lags, input_lags=input_lags, kind=Difnn.KIND)
    values = np.column_stack([regression.lagged, regression.targets])
    fewest = min(len(np.unique(column)) for column in values.T)
    if terms > fewest:
        raise UserError(f"difnn: {terms} terms of a variable of {fewest} different values; take {fewest} or fewer")
    split, targets = regression.lagged.shape[1], regression.targets.shape[1]
    even = np.linspace(values[:, :split].min(axis=0), values[:, :split].max(axis=0), terms)
    centres = np.column_stack([even, *(k_means(column, terms, seed=seed) for column in values[:, split:].T)])
    nearest = np.argmin(np.abs(values[:, None, :] - centres), axis=1)
    rules, of = np.unique(nearest[:, :split], axis=0, return_inverse=True)
    counts = np.zeros((targets, len(rules), terms), dtype=np.int64)
    for k, column in enumerate(nearest[:, split:].T):
        np.add.at(counts[k], (of.ravel(), column), 1)
    kept = np.flatnonzero((counts >= least).any(axis=2).all(axis=0))
    if not len(kept):
        raise UserError(
            f"difnn: no rule has {least} samples, the largest one {counts.max()}: take fewer terms, or a smaller count"
        )
    links = [tuple(enumerate(of_output[kept].argmax(axis=1).tolist())) for of_output in counts]
    rules, widths = rules[kept], _widths(centres)
    widths[:, split:] = 1.0
    for k, of_output in enumerate(links):
        shares = _shares(regression.lagged, centres[:, :split], widths[:, :split], rules, of_output)
        left = regression.targets[:, [k]] - shares @ centres[:, [split + k]]
        centres[:, [split + k]] += least_squares(shares, left, ridge=RIDGE)
    return Difnn(
        **regression.shape(outputs, inputs),
        antecedents=tuple(map(tuple, rules.tolist())),
        links=tuple(links),
        clusters=terms,
        term_weights=tuple(packed(centres.T, widths.T).tolist()),
    )


def _shares(lagged: Array, centres: Array, widths: Array, rules: Array, links: Sequence[tuple[int, int]]) -> Array:
    """Part of each term of an output whose terms are all as wide, (rows, terms)."""
    columns = np.arange(lagged.shape[1])
    apart = (lagged[:, None, :] - centres[rules, columns]) / widths[rules, columns]
    logarithms = -np.sum(apart**2, axis=2)
    fired = np.exp(logarithms - logarithms.max(axis=1, keepdims=True))
    found = np.zeros((len(lagged), len(centres)))
    for rule, term in links:
        found[:, term] += fired[:, rule]
    return np.asarray(found / found.sum(axis=1, keepdims=True))


def _widths(centres: Array) -> Array:
    """B (terms, variables) by which a term is a half at its nearest neighbour: |c - c'| / sqrt(ln 2)."""
    if len(centres) == 1:
        return np.ones_like(centres)
    gaps = np.diff(centres, axis=0)
    nearer = np.minimum(np.concatenate([gaps, gaps[-1:]]), np.concatenate([gaps[:1], gaps]))
    return np.asarray(nearer / HALF)

"""Rules of a Takagi-Sugeno model: their premises, their number, where they lie and what they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.fuzzy.clustering import fuzzy_c_means, gustafson_kessel
from hybrid_sysid_ros.extensions.fuzzy.memberships import memberships, packed
from hybrid_sysid_ros.extensions.fuzzy.takagi_sugeno import TakagiSugeno
from hybrid_sysid_ros.extensions.shared.regression import Regression, least_squares
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BLOCKS, HELD = 10, 3
"""Consecutive parts of the training data, every third of which judges what the others teach."""

FEW = 4
"""Rules with which premises are chosen, where their number is not given."""

MOST, PATIENCE = 10, 2
"""Largest number of rules that growth goes to, and rules more in a row that may be no better before it ends."""

GAIN, WORTH = 0.01, 0.05
"""Part by which another rule and another premise must lower the error."""

RIDGE = 1e-9
"""Of consequents, by the number of rows: for rules that hardly any data speak of."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rules:
    premises: tuple[int, ...]
    centres: Array
    widths: Array

    def design(self, lagged: Array) -> Array:
        """What consequents multiply, (rows, rules * (1 + regressors))."""
        h = memberships(lagged[:, self.premises], self.centres, self.widths)
        affine = np.column_stack([np.ones(len(lagged)), lagged])
        return np.asarray((h[:, :, None] * affine[:, None, :]).reshape(len(lagged), -1))


def select_rules(
    experiments: Sequence[PreparedRecord],
    *,
    outputs: Sequence[Variable],
    inputs: Sequence[Variable],
    output_lags: int,
    input_lags: int,
    rules: int | None = None,
    premises: Sequence[int] | None = None,
    ellipsoids: bool = False,
    seed: int = 0,
) -> TakagiSugeno:
    """Rules from clusters of the premise variables in several records, and their consequents by least squares.

    rules: how many; None: one more as long as the error of one step falls on the held parts of the training data.
    premises: which of the regressors; None: first the one with the least of that error, then others as long as it
    falls. ellipsoids: clusters by Gustafson and Kessel instead of fuzzy C-means. seed: of where clusters begin.

    All consequents are found at once, which recursive least squares over the same rows gives as well. They are the best
    for one step: refine them, centres and widths by :func:`~hybrid_sysid_ros.identification.fitting.fit`.

    Raises UserError for lags that don't fit the records, for more rules than the rows can teach, and for clusters
    that are alike, singular or without data.
    """
    regression = Regression.of(experiments, output_lags=output_lags, input_lags=input_lags, kind=TakagiSugeno.KIND)
    selection = _RuleSelection(regression, ellipsoids=ellipsoids, seed=seed)
    chosen = tuple(premises) if premises is not None else selection.premises(rules or FEW)
    found = selection.clustered(chosen, rules or selection.grown(chosen))
    consequents = least_squares(found.design(regression.lagged), regression.targets, ridge=RIDGE)
    return TakagiSugeno(
        **regression.shape(outputs, inputs),
        premises=chosen,
        rules=len(found.centres),
        premise_weights=tuple(packed(found.centres, found.widths).tolist()),
        consequents=tuple(consequents.T.ravel().tolist()),
    )


class _RuleSelection:
    """Choices by the held parts of the rows."""

    def __init__(self, regression: Regression, *, ellipsoids: bool, seed: int) -> None:
        self._regression, self._ellipsoids, self._seed = regression, ellipsoids, seed
        count = len(regression.lagged)
        self._held = np.arange(count) * BLOCKS // count % HELD == HELD - 1
        spreads = np.std(regression.lagged, axis=0)
        self._spreads = np.where(spreads > 0.0, spreads, 1.0)

    def clustered(self, premises: tuple[int, ...], rules: int) -> _Rules:
        """So many rules on premises, from all rows. Raises UserError where the rows don't carry them."""
        count, width = len(self._regression.lagged), 1 + self._regression.lagged.shape[1]
        if rules * width > count:
            raise UserError(
                f"takagi_sugeno: {rules} rules have {rules * width} numbers for each output, and there are {count} "
                f"samples: take {count // width} rules or fewer, or longer records"
            )
        spreads = self._spreads[list(premises)]
        points = self._regression.lagged[:, premises] / spreads
        if self._ellipsoids:
            centres, widths = gustafson_kessel(points, rules, seed=self._seed)
        else:
            centres = fuzzy_c_means(points, rules, seed=self._seed)
            widths = np.ones_like(centres)
        order = np.argsort(centres[:, 0])
        centres, widths = centres[order], widths[order]
        nearest = np.argmax(memberships(points, centres, widths), axis=1)
        samples = np.bincount(nearest, minlength=rules)
        if not samples.min():
            raise UserError(
                f"takagi_sugeno: rule {int(samples.argmin()) + 1} of {rules} is the nearest one of no sample: "
                "take fewer rules, or fuzzy C-means (gustafson_kessel=0)"
            )
        return _Rules(premises=premises, centres=centres * spreads, widths=widths * spreads)

    def error(self, premises: tuple[int, ...], rules: int) -> float:
        """Root mean square error of one step on the held rows, learned from the others."""
        lagged, targets = self._regression.lagged, self._regression.targets
        design = self.clustered(premises, rules).design(lagged)
        consequents = least_squares(design[~self._held], targets[~self._held], ridge=RIDGE)
        return float(np.sqrt(np.mean((design[self._held] @ consequents - targets[self._held]) ** 2)))

    def premises(self, rules: int) -> tuple[int, ...]:
        """Regressors, one after the other as long as the error falls."""
        chosen: tuple[int, ...] = ()
        best, left = np.inf, set(range(self._regression.lagged.shape[1]))
        while left:
            errors = {index: self.error(tuple(sorted((*chosen, index))), rules) for index in sorted(left)}
            index = min(errors, key=errors.__getitem__)
            if not errors[index] < (1.0 - WORTH) * best:
                break
            chosen, best = tuple(sorted((*chosen, index))), errors[index]
            left.remove(index)
        return chosen

    def grown(self, premises: tuple[int, ...]) -> int:
        """The number of rules beyond which the error falls no more."""
        best, least = 1, self.error(premises, 1)
        for rules in range(2, MOST + 1):
            try:
                error = self.error(premises, rules)
            except UserError:  # the data don't carry so many
                break
            if error < (1.0 - GAIN) * least:
                best, least = rules, error
            elif rules - best >= PATIENCE:
                break
        return best

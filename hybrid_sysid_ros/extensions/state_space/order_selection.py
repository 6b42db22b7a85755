"""Choice of a state-space model's order by held-out blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hybrid_sysid_ros.extensions.state_space import subspace
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BLOCKS = 5
"""Blocks into which the records are cut; each is held out in turn."""
MOST, CHANCE = 1.02, 1.1
"""The smallest order is taken whose error is at most so many times the least one, for sure and by chance."""
EXACT = 1e-6
"""Errors below it are rounding."""
ORDERS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60)
SURE = 3.0
"""The input acts on the output at once where that lowers the mean square by so many standard errors."""


@dataclass(frozen=True, kw_only=True)
class TriedOrder:
    """An order that was tried."""

    order: int
    error: float
    """Root mean square error of the simulation in held-out blocks, relative to the outputs' deviation."""
    spread: float
    """Standard error of ``error`` by the spread over the blocks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Selection:
    """A chosen order."""

    order: int
    through: bool
    trials: Sequence[TriedOrder]

    @property
    def error(self) -> float:
        """That of the order in held-out blocks; infinite where it was not tried."""
        return next((item.error for item in self.trials if item.order == self.order), np.inf)


def rows_for(highest: int) -> int:
    """Samples of future and past in a subspace factorisation up to an order: in fewer, slow modes look like each other,
    however many outputs there are.
    """
    return max(2 * highest, 8)


def blocks_of(stretches: Sequence[subspace.Stretch], shortest: int) -> list[subspace.Stretch]:
    """Stretches cut into some BLOCKS blocks, none shorter than ``shortest`` samples."""
    total = sum(len(inputs) for inputs, _ in stretches)
    found = []
    for inputs, outputs in stretches:
        count = max(1, min(round(BLOCKS * len(inputs) / total), len(inputs) // shortest))
        edges = np.linspace(0, len(inputs), count + 1).astype(int)
        found += [(inputs[a:b], outputs[a:b]) for a, b in pairwise(edges)]
    return found


def comparable(stretches: Sequence[subspace.Stretch], highest: int) -> list[int]:
    """The orders up to ``highest`` that these stretches allow to compare. Raises UserError where there is none."""
    m, p = stretches[0][0].shape[1], stretches[0][1].shape[1]
    found = [n for n in ORDERS if n <= highest and _allowed(stretches, n, m, p)]
    if not found:
        lengths = [len(inputs) for inputs, _ in stretches]
        raise UserError(
            f"state space: {sum(lengths)} samples, in parts of {max(lengths)} at most, are too few to compare orders: "
            "give longer records, or an order (--option order=1)"
        )
    return found


def _allowed(stretches: Sequence[subspace.Stretch], order: int, m: int, p: int) -> bool:
    rows = rows_for(order)
    lengths = [len(inputs) for inputs, _ in blocks_of(stretches, 4 * rows)]
    columns = [max(length - 2 * rows + 1, 0) for length in lengths]
    return min(lengths) > 2 * order and sum(columns) - max(columns) > 3 * rows * (m + p)


def select_order(
    stretches: Sequence[subspace.Stretch],
    *,
    orders: Sequence[int],
    through: bool | None,
    known: int = 40,
    progress: Callable[[int, float], None] | None = None,
) -> Selection:
    """The order, and whether the input acts at once, by the error in held-out blocks of the records.

    Each block is scored by the model of all others, from the start that its first ``known`` samples tell. The order is
    the lowest whose error is near the least: within MOST or, where the excess is no more than a standard error over the
    blocks, within CHANCE (Breiman, Friedman, Olshen & Stone 1984, Classification and Regression Trees, section 3.4.3).
    through: whether the input acts at once; None: the blocks decide. Raises UserError where no simulation stays finite.
    """
    m, p = stretches[0][0].shape[1], stretches[0][1].shape[1]
    rows = rows_for(max(orders))
    blocks = blocks_of(stretches, 4 * rows)
    if len(blocks) < 2:
        raise UserError(
            f"state space: {len(blocks[0][0])} samples can't be cut into blocks of {4 * rows}: give longer records, or "
            "order and feedthrough (--option order=2 --option feedthrough=0)"
        )
    factors = [subspace.in_time([block], rows) for block in blocks]

    def errors(order: int, directs: Sequence[Array], direct: bool) -> Array:
        found = []
        for held, directions in enumerate(directs):
            others = [block for k, block in enumerate(blocks) if k != held]
            model = subspace.completed(*subspace.poles_and_readout(directions, order, p), others, direct)
            wrong = subspace.residuals(model, *blocks[held], known=known)
            found.append(float(np.mean(wrong**2)))
        return np.array(found)

    directs = []
    for held in range(len(blocks)):
        joined = subspace.triangular_factor(
            (factor for k, factor in enumerate(factors) if k != held), factors[0].shape[1]
        )
        directs.append(subspace.observability(joined, rows, m, p)[0])
    trials, squares = [], {}
    for order in orders:
        squares[order] = errors(order, directs, through is not False)
        error = float(np.sqrt(squares[order].mean()))
        spread = float(np.std(squares[order], ddof=1) / np.sqrt(len(blocks)) / (2.0 * max(error, 1e-300)))
        trials.append(TriedOrder(order=order, error=error, spread=spread))
        if progress is not None:
            progress(order, error)
    finite = [trial for trial in trials if np.isfinite(trial.error)]
    if not finite:
        raise UserError("state space: no order gives a model whose simulation stays finite; check the record")
    best = min(finite, key=lambda trial: trial.error)

    def is_enough(trial: TriedOrder) -> bool:
        more = squares[trial.order] - squares[best.order]
        is_chance = more.mean() <= more.std(ddof=1) / np.sqrt(len(more))
        return trial.error <= max((CHANCE if is_chance else MOST) * best.error, EXACT)

    order = next(trial.order for trial in finite if is_enough(trial))
    if through is None:
        gain = errors(order, directs, False) - squares[order]
        through = gain.mean() > SURE * gain.std(ddof=1) / np.sqrt(len(gain))
    return Selection(order=order, through=bool(through), trials=tuple(trials))

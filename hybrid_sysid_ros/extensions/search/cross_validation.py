"""Blocked cross-validation: how well a structure predicts motion unlike the one it was fitted to."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification.context import Context
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.identify import checked
from hybrid_sysid_ros.identification.part import Part, parts_of, without_gaps
from hybrid_sysid_ros.identification.validation.scores import score_free_run
from hybrid_sysid_ros.models import Options, Sampling
from hybrid_sysid_ros.models.structure import complete, structure_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

BLOCKS = 6
"""Fewest blocks of the training data; records are split where there are fewer."""

WORST = -1.0
"""Lower limit of a block's R2, so that a single diverged block does not decide."""


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Scores of blocks that were held out of the fit."""

    scores: Mapping[str, float]
    """R2 of the free run over each block, mean over the outputs, by name."""
    seconds: float
    """Time of all fits [s]."""

    @property
    def value(self) -> float:
        """Mean of the scores, which a comparison maximises."""
        return float(np.mean([max(score, WORST) for score in self.scores.values()]))

    @property
    def standard_error(self) -> float:
        """Standard error of the mean."""
        values = [max(score, WORST) for score in self.scores.values()]
        return float(np.std(values, ddof=1) / np.sqrt(len(values)))


def blocks_of(records: Sequence[Record], sampling: Sampling, each: int | None = None) -> list[Record]:
    """Records, each cut at scored samples into ``each`` equal parts, by default enough for BLOCKS in all. They are in
    the order of the outputs' deviations relative to the largest, calmest first.
    """
    each = each or max(1, -(-BLOCKS // len(records)))
    blocks = []
    for record in records:
        for i in range(each):
            block = Part(start=i / each, stop=(i + 1) / each).of(record, sampling)
            name = f"{record.name} {i + 1}/{each}" if each > 1 else record.name
            blocks.append(replace(block, name=name))
    deviations = np.array([np.std(block.output, axis=0) for block in blocks])
    widths = (deviations / np.maximum(deviations.max(axis=0), 1e-12)).mean(axis=1)
    return [blocks[i] for i in np.argsort(widths, kind="stable")]


def cross_validate(
    records: Sequence[Record],
    rig: Rig,
    structure: str,
    *,
    sampling: Sampling,
    part: Part | Sequence[Part] = Part(),
    options: Options | None = None,
    seed: int = 0,
    folds: int = 3,
    alike: bool = False,
) -> Validation:
    """Fit without one group of blocks, free-run over them, for each group in turn.

    The groups go from the calmest blocks to the widest: each is predicted from calmer and wider motion only, so that a
    structure must extrapolate to an unseen excitation. ``alike``: each record is cut into as many blocks as there are
    folds, and every group holds out one block of each record. This suits records with unique content, such as the only
    slow one. No block shares a sample with another.

    Raises UserError for records that are too short or don't excite the rig, and for fewer than two folds.
    """
    if not records:
        raise UserError("cross-validation: no record")
    used = parts_of(records, part, sampling)
    found = structure_of(structure, rig.system, rig.structures)
    holds = found.sampling(sampling)
    for record in used:
        checked(record, rig, holds)
    # A constant output can't be scored.
    blocks = [
        block
        for block in blocks_of(used, sampling, each=folds if alike else None)
        if np.all(np.ptp(block.output, axis=0) > 0.0)
    ]
    if not 2 <= folds <= len(blocks):
        raise UserError(f"cross-validation: {folds} folds; choose 2 to {len(blocks)}, the number of blocks")
    chosen = complete(options or {}, found.options, structure)
    began = time.perf_counter()
    scores = {}
    for held in _of_each(blocks, folds) if alike else np.array_split(np.arange(len(blocks)), folds):
        learned = without_gaps([block for i, block in enumerate(blocks) if i not in held], sampling)
        context = Context(rig=rig, sampling=holds, options=chosen, seed=seed, records=learned)
        system = found.fit(context).system
        for i in held:
            scores[blocks[i].name] = score_free_run(system, prepare(blocks[i], system, holds)).r2
    return Validation(scores=scores, seconds=time.perf_counter() - began)


def _of_each(blocks: Sequence[Record], folds: int) -> list[list[int]]:
    """Groups of the first block of each record, the second of each, ..."""
    return [[k for k, block in enumerate(blocks) if block.name.endswith(f" {i + 1}/{folds}")] for i in range(folds)]

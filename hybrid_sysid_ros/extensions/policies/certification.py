"""Certification: many random closed loops of a policy beside the exact MPC, on all cores, and what they count."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.safety.certificate import DELTA, Certificate, SeedCounts
from hybrid_sysid_ros.control.safety.supervisor import REASONS
from hybrid_sysid_ros.control.scenarios import DISTURBED, PUSHED
from hybrid_sysid_ros.extensions.policies.certified_loops import (
    COST,
    ERROR,
    EXACT,
    JUDGED,
    KKT_TOLERANCE,
    UNSOLVED,
    WORST_PERIOD,
    Certification,
    Drivers,
    measured,
)
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.models.storage import plain
from hybrid_sysid_ros.support import parallel
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.parallel import Store
from hybrid_sysid_ros.support.progress import StageProgress

CHUNK = 32
"""Loops that a process runs between two looks."""

WORST = 5
"""Worst loops named, of each driver and criterion."""

STRATUM = "references of the training"


def certify(
    certification: Certification,
    *,
    loops: int,
    delta: float = DELTA,
    before: Certificate | None = None,
    workers: int = 0,
    store: Path | None = None,
    progress: StageProgress | None = None,
) -> Certificate:
    """Run the loops and count.

    before: the policy's certificate so far, whose other seeds count as well.
    workers: processes, 0 for one per core. store: folder where finished loops are kept until the end, so that an
    interrupted certification goes on; more loops go on from fewer. Raises UserError for a number of loops or a delta
    that says nothing.
    """
    if not 0.0 < delta < 1.0 or loops < 1:
        raise UserError(f"certificate: {loops} loops with delta {delta} say nothing: take more loops and 0 < delta < 1")
    Drivers(certification)  # or say why not
    began, report = time.perf_counter(), progress or (lambda *_: None)
    pieces = [(first, min(first + CHUNK, loops)) for first in range(0, loops, CHUNK)]
    kept: Store[NamedArrays] | None = Store(store, _purpose(certification)) if store is not None else None
    report("closed loops", 0, loops)
    found = parallel.run(
        partial(measured, certification),
        pieces,
        workers=workers,
        store=kept,
        progress=lambda done, _: report("closed loops", min(done * CHUNK, loops), loops),
    )
    measures, reasons = (np.concatenate([each[name] for each in found]) for name in ("measures", "reasons"))
    entry = SeedCounts(
        seed=certification.seed,
        loops={STRATUM: loops},
        failed={
            driver: {STRATUM: {name: int(np.sum(~values)) for name, values in parts.items()}}
            for driver, parts in certification.kept(measures).items()
        },
        check=dict(zip(REASONS, reasons.sum(0).tolist(), strict=True)),
        exact={
            "periods": loops * certification.periods,
            "not_converged": int(measures[:, EXACT, UNSOLVED].sum()),
        },
        made={"seconds": round(time.perf_counter() - began, 1), "versions": versions()},
    )
    worst = list(_worst(certification.seed, measures))
    certificate = pooled(certification, before, entry, worst, delta)
    if kept is not None:
        kept.remove()
    return certificate


def pooled(
    certification: Certification,
    before: Certificate | None,
    entry: SeedCounts,
    worst: list[dict[str, Any]],
    delta: float,
) -> Certificate:
    """The certificate of all seeds that were tried: those of an earlier certificate, and this one.

    Raises UserError where the earlier one is of another distribution or other criteria.
    """
    distribution = plain(
        {
            **asdict(certification.distribution),
            "periods": certification.periods,
            "pushed": PUSHED,
            "disturbed": DISTURBED,
        }
    )
    criteria = plain(
        {
            **asdict(certification.criteria),
            "check": certification.tolerances._asdict(),
            "kkt_tolerance": KKT_TOLERANCE,
        }
    )
    ledger: list[SeedCounts] = []
    if before is not None:
        for name, now in (("distribution", distribution), ("criteria", criteria)):
            if getattr(before, name) != now:
                raise UserError(f"its certificate is of another {name}: counts can't be pooled; remove it first")
        ledger = [item for item in before.ledger if item.seed != entry.seed]
        worst = [*(case for case in before.worst if case["seed"] != entry.seed), *worst]
    return Certificate(
        policy=certification.seal,
        model=certification.policy.model,
        delta=delta,
        distribution=distribution,
        criteria=criteria,
        ledger=[*ledger, entry],
        worst=_largest(worst),
    )


def _largest(cases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of each driver and criterion the worst cases."""
    sizes = {"input": lambda case: case["input_error"], "cost": lambda case: case["cost"] / case["exact_cost"]}
    found = []
    for driver in JUDGED:
        for criterion, size in sizes.items():
            rows = [case for case in cases if (case["driver"], case["by"]) == (driver, criterion)]
            found += sorted(rows, key=size, reverse=True)[:WORST]
    return found


def _purpose(certification: Certification) -> str:
    """Everything that a loop depends on, but not how many there are."""
    plain = replace(certification, policy=None)  # type: ignore[arg-type]
    return f"{plain} {certification.plant.weights.tolist()} {certification.model.weights.tolist()}"


def _worst(seed: int, measures: Array) -> Iterator[dict[str, Any]]:
    """The loops with the largest errors of the input and of the cost."""
    for name, driver in JUDGED.items():
        rows = measures[:, driver]
        ratio = rows[:, COST] / measures[:, EXACT, COST]
        for criterion, values in (("input", rows[:, ERROR]), ("cost", ratio)):
            for loop in np.argsort(-values, kind="stable")[:WORST].tolist():
                yield {
                    "driver": name,
                    "by": criterion,
                    "seed": seed,
                    "loop": loop,
                    "input_error": float(rows[loop, ERROR]),
                    "period": int(rows[loop, WORST_PERIOD]),
                    "cost": float(rows[loop, COST]),
                    "exact_cost": float(measures[loop, EXACT, COST]),
                }

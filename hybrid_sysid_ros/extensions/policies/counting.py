"""Counting: many random closed loops of a trial, on all cores or a cluster, and the certificate that they make."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.safety.certificate import DELTA, Certificate, SeedCounts
from hybrid_sysid_ros.control.safety.supervisor import REASONS
from hybrid_sysid_ros.extensions.policies.criteria import COST, ERROR, EXACT, JUDGED, UNSOLVED, WORST_PERIOD
from hybrid_sysid_ros.extensions.policies.mixture import BEGINNINGS, STRATA
from hybrid_sysid_ros.extensions.policies.trial import KKT_TOLERANCE, Drivers, Trial, measured
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.models.storage import plain
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import StageProgress

CHUNK = 128
"""Loops that a process runs between two looks: the controllers of a trial take as long to make as a loop to run."""

WORST = 5
"""Worst loops named, of each driver and criterion."""


def certify(
    trial: Trial,
    *,
    loops: int,
    delta: float = DELTA,
    before: Certificate | None = None,
    workers: int = 0,
    cluster: str = "",
    store: Path | None = None,
    progress: StageProgress | None = None,
) -> Certificate:
    """Run the loops of a seed and count.

    before: the policy's certificate so far: its other seeds count as well, and this seed goes on from the loops that it
    has there. workers: processes, 0 for one per core. cluster: address of a Dask scheduler in their place, or local.
    store: folder where finished loops are kept until the end, so that an interrupted certification goes on. Raises
    UserError for a number of loops or a delta that says nothing, and where the counts so far are of other loops.
    """
    if not 0.0 < delta < 1.0 or loops < 1:
        raise UserError(f"certificate: {loops} loops with delta {delta} say nothing: take more loops and 0 < delta < 1")
    Drivers(trial)  # or say why not
    stated, ledger = _stated(trial), _ledger(trial, before)
    counted = ledger.get(trial.seed)
    first = sum(counted.loops.values()) if counted is not None else 0
    worst = list(before.worst) if before is not None else []
    kept: Store[NamedArrays] | None = Store(store, _purpose(trial)) if store is not None else None
    if first < loops:
        began, report = time.perf_counter(), progress or (lambda *_: None)
        pieces = [(begin, min(begin + CHUNK, loops)) for begin in range(first, loops, CHUNK)]
        report("closed loops", first, loops)
        found = parallel.run(
            partial(measured, trial),
            pieces,
            workers=workers,
            cluster=cluster,
            store=kept,
            progress=lambda done, _: report("closed loops", min(first + done * CHUNK, loops), loops),
        )
        measures, reasons = (np.concatenate([each[name] for each in found]) for name in ("measures", "reasons"))
        new = _counted(trial, first, measures, reasons, seconds=time.perf_counter() - began)
        ledger[trial.seed] = new if counted is None else _together(counted, new)
        worst += _worst(trial.seed, first, measures)
    certificate = Certificate(
        policy=trial.seal,
        model=trial.policy.model,
        delta=delta,
        **stated,
        ledger=[*ledger.values()],
        worst=_largest(worst),
    )
    if kept is not None:
        kept.remove()
    return certificate


def _counted(trial: Trial, first: int, measures: Array, reasons: NDArray[np.int64], *, seconds: float) -> SeedCounts:
    """What loops from ``first`` on kept: measures (loops, drivers, measures), reasons (loops, reasons)."""
    places = (first + np.arange(len(measures))) % len(STRATA)
    return SeedCounts(
        seed=trial.seed,
        loops={name: int(np.sum(places == place)) for place, name in enumerate(STRATA)},
        failed={
            driver: {
                stratum: {name: int(np.sum(~values[places == place])) for name, values in parts.items()}
                for place, stratum in enumerate(STRATA)
            }
            for driver, parts in trial.kept(measures).items()
        },
        check=dict(zip(REASONS, reasons.sum(0).tolist(), strict=True)),
        exact={
            "periods": len(measures) * trial.periods,
            "not_converged": int(measures[:, EXACT, UNSOLVED].sum()),
        },
        made={"seconds": round(seconds, 1), "versions": versions()},
    )


def _together(counted: SeedCounts, new: SeedCounts) -> SeedCounts:
    """Loops of a seed and those that follow them."""
    return SeedCounts(
        seed=new.seed,
        loops=_sum(counted.loops, new.loops),
        failed={
            driver: {stratum: _sum(counted.failed[driver][stratum], counts) for stratum, counts in strata.items()}
            for driver, strata in new.failed.items()
        },
        check=_sum(counted.check, new.check),
        exact=_sum(counted.exact, new.exact),
        made={**new.made, "seconds": counted.made.get("seconds", 0.0) + new.made["seconds"]},
    )


def _sum(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return {key: one.get(key, 0) + value for key, value in other.items()}


def _stated(trial: Trial) -> dict[str, dict[str, Any]]:
    """Distribution and criteria, as a certificate states them."""
    mixture = {"strata": STRATA, "periods": trial.periods, "beginnings": BEGINNINGS, **asdict(trial.mixture)}
    criteria = {**asdict(trial.criteria), "check": trial.tolerances._asdict(), "kkt_tolerance": KKT_TOLERANCE}
    return {"distribution": plain(mixture), "criteria": plain(criteria)}


def _ledger(trial: Trial, before: Certificate | None) -> dict[int, SeedCounts]:
    """What was counted so far, by seed. Raises UserError where that was of another distribution or other criteria."""
    if before is None:
        return {}
    for name, now in _stated(trial).items():
        if getattr(before, name) != now:
            raise UserError(f"the certificate is of another {name}, with which counts can't be pooled; remove it first")
    return {entry.seed: entry for entry in before.ledger}


def _largest(cases: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of each driver and criterion the worst cases."""
    sizes = {
        "input": lambda case: case["input_error"],
        "cost": lambda case: case["cost"] / (case["exact_cost"] or math.inf),
    }
    found = []
    for driver in JUDGED:
        for criterion, size in sizes.items():
            rows = [case for case in cases if (case["driver"], case["by"]) == (driver, criterion)]
            found += sorted(rows, key=size, reverse=True)[:WORST]
    return found


def _purpose(trial: Trial) -> str:
    """Everything that a loop depends on, but not how many there are."""
    plain = replace(trial, policy=None)  # type: ignore[arg-type]
    return f"{plain} {trial.plant.weights.tolist()} {trial.model.weights.tolist()}"


def _worst(seed: int, first: int, measures: Array) -> Iterator[dict[str, Any]]:
    """The loops with the largest errors of the input and of the cost, of those from ``first`` on."""
    for name, driver in JUDGED.items():
        rows = measures[:, driver]
        ratio = rows[:, COST] / np.maximum(measures[:, EXACT, COST], np.finfo(float).tiny)
        for criterion, values in (("input", rows[:, ERROR]), ("cost", ratio)):
            for loop in np.argsort(-values, kind="stable")[:WORST].tolist():
                yield {
                    "driver": name,
                    "by": criterion,
                    "seed": seed,
                    "loop": first + loop,
                    "input_error": float(rows[loop, ERROR]),
                    "period": int(rows[loop, WORST_PERIOD]),
                    "cost": float(rows[loop, COST]),
                    "exact_cost": float(measures[loop, EXACT, COST]),
                }

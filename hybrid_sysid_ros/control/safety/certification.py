"""Certification: many random closed loops of a policy beside the exact MPC, in compiled code on all cores."""

from __future__ import annotations

import hashlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from hybrid_sysid_ros.control.policy.sampling import CHANGES, KICKS
from hybrid_sysid_ros.control.safety.certificate import Certificate, bounds, margin
from hybrid_sysid_ros.control.safety.certified_loop import COST, DRIVERS, ERROR, EXACT, MEASURES, UNSOLVED, WORST_PERIOD
from hybrid_sysid_ros.control.safety.certified_policy import JUDGED, KKT_TOLERANCE, Subject
from hybrid_sysid_ros.control.safety.online_check import REASONS
from hybrid_sysid_ros.models.model import versions
from hybrid_sysid_ros.models.storage import save_arrays
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_file

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
"""progress(stage, done, of)"""

CHUNK = 32
"""Loops that a thread runs between two looks."""

KEPT_EVERY = 5.0
"""Seconds between two copies of what is done."""

WORST = 5
"""Worst loops named, of each driver."""


def certify(
    subject: Subject,
    *,
    loops: int,
    delta: float = 0.01,
    workers: int = 0,
    store: Path | None = None,
    progress: Progress | None = None,
) -> Certificate:
    """Run the loops and count.

    workers: threads, 0 for one per core. store: file where finished loops are kept until the end, so that an
    interrupted certification goes on. Raises UserError for a number of loops or a delta that says nothing.
    """
    if not 0.0 < delta < 1.0 or loops < 1 or margin(loops, delta) >= 1.0:
        raise UserError(f"certificate: {loops} loops with delta {delta} say nothing: take more loops and 0 < delta < 1")
    began = time.perf_counter()
    work = _Work(subject, loops, store)
    earlier = work.seconds
    work.run(workers or os.cpu_count() or 1, progress or (lambda *_: None))
    measures, reasons = work.measures, work.reasons
    rates = {
        driver: {name: float(np.mean(values)) for name, values in parts.items()}
        for driver, parts in subject.kept(measures).items()
    }
    certificate = Certificate(
        policy=subject.seal,
        model=subject.policy.model,
        loops=loops,
        seed=subject.seed,
        delta=delta,
        distribution={
            **asdict(subject.distribution),
            "periods": subject.periods,
            "pushed": KICKS,
            "disturbed": CHANGES,
        },
        criteria={**asdict(subject.criteria), "check": subject.tolerances._asdict(), "kkt_tolerance": KKT_TOLERANCE},
        rates=rates,
        bounds=bounds(rates, loops, delta),
        check={reason: float(share) for reason, share in zip(REASONS, reasons.sum(0) / reasons.sum(), strict=True)},
        exact={"not_converged": float(measures[:, EXACT, UNSOLVED].sum() / (loops * subject.periods))},
        worst=list(_worst(measures)),
        made={"seconds": round(earlier + time.perf_counter() - began, 1), "versions": versions()},
    )
    work.remove()
    return certificate


def _worst(measures: Array) -> Iterator[dict[str, object]]:
    """The loops with the largest errors of the input and of the cost."""
    for name, driver in JUDGED.items():
        rows = measures[:, driver]
        ratio = rows[:, COST] / measures[:, EXACT, COST]
        for criterion, values in (("input", rows[:, ERROR]), ("cost", ratio)):
            for loop in np.argsort(-values, kind="stable")[:WORST].tolist():
                yield {
                    "driver": name,
                    "by": criterion,
                    "loop": loop,
                    "input_error": float(rows[loop, ERROR]),
                    "period": int(rows[loop, WORST_PERIOD]),
                    "cost": float(rows[loop, COST]),
                    "exact_cost": float(measures[loop, EXACT, COST]),
                }


class _Work:
    """The loops of a certification: which are done, and what came out. measures (loops, drivers, measures), reasons
    (loops, reasons), done (loops,).
    """

    def __init__(self, subject: Subject, loops: int, store: Path | None) -> None:
        self._subject = subject
        self._store = store
        # Everything that a loop depends on, but not how many there are: more loops go on from fewer.
        purpose = f"{replace(subject, policy=None)} {subject.plant.weights.tolist()} {subject.model.weights.tolist()}"  # type: ignore[arg-type]
        self._key = np.frombuffer(hashlib.sha256(purpose.encode()).digest(), np.uint8)
        self.measures = np.zeros((loops, len(DRIVERS), len(MEASURES)))
        self.reasons = np.zeros((loops, len(REASONS)), np.int64)
        self.done = np.zeros(loops, dtype=bool)
        self.seconds = 0.0
        self._find()

    def _find(self) -> None:
        if self._store is None or not self._store.is_file():
            return
        try:
            kept = load_file(self._store)
            if not np.array_equal(kept["key"], self._key):
                return
            count = min(len(kept["done"]), len(self.done))
            self.done[:count] = kept["done"][:count]
            self.measures[:count], self.reasons[:count] = kept["measures"][:count], kept["reasons"][:count]
            self.seconds = float(kept["seconds"][0])
        except (SafetensorError, OSError, KeyError, ValueError):
            self.done[:] = False

    def _keep(self, seconds: float) -> None:
        if self._store is not None:
            arrays = {name: getattr(self, name) for name in ("measures", "reasons", "done")}
            with written_file(self._store) as partial:
                save_arrays(partial, {**arrays, "key": self._key, "seconds": np.array([seconds])})

    def remove(self) -> None:
        """Forget what was kept: the certification is finished."""
        if self._store is not None:
            self._store.unlink(missing_ok=True)

    def run(self, workers: int, progress: Progress) -> None:
        """Run what is left. Ctrl-C: finish the loops under way, keep them, and stop."""
        left = np.flatnonzero(~self.done)
        total, mine, stopped = len(self.done), threading.local(), threading.Event()
        began, earlier = time.perf_counter(), self.seconds
        progress("closed loops", int(self.done.sum()), total)
        benches = iter([self._subject.bench() for _ in range(min(workers, len(left)))])  # compiled once, here

        def prepare() -> None:
            mine.bench = next(benches)

        def chunk(numbers: NDArray[np.int64]) -> None:
            for loop in numbers.tolist():
                if stopped.is_set():
                    return
                self.measures[loop], self.reasons[loop] = 0.0, 0
                self._subject.run(mine.bench, loop, self.measures[loop], self.reasons[loop])
                self.done[loop] = True

        pool = ThreadPoolExecutor(max(min(workers, len(left)), 1), initializer=prepare)
        running: set[Future[None]] = {pool.submit(chunk, left[at : at + CHUNK]) for at in range(0, len(left), CHUNK)}
        kept = time.perf_counter()
        try:
            while running:
                finished, running = wait(running, timeout=1.0, return_when=FIRST_COMPLETED)
                for each in finished:
                    each.result()
                progress("closed loops", int(self.done.sum()), total)
                if time.perf_counter() - kept > KEPT_EVERY:
                    kept = time.perf_counter()
                    self._keep(earlier + kept - began)
        except BaseException:
            stopped.set()
            pool.shutdown(wait=True, cancel_futures=True)
            self._keep(earlier + time.perf_counter() - began)
            progress("closed loops", int(self.done.sum()), total)
            raise
        pool.shutdown()

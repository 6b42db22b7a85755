"""Workers: independent pieces of work for one kind of worker, of which one may be lost."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from dataclasses import dataclass
from typing import Generic, TypeVar

from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import Report
from hybrid_sysid_ros.support.threads import alone

Item = TypeVar("Item")
Result = TypeVar("Result")

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a process whose libraries have one thread each."""

POLL = 1.0
"""Seconds between two looks at the workers."""

LOSSES = 3
"""Number of lost processes after which a piece is given up, since it probably causes the losses."""


@dataclass(frozen=True)
class Lost:
    """Replaces a result whose processes were lost repeatedly."""

    reason: str = f"its worker process was lost {LOSSES} times; perhaps it needs more memory"


class Workers(ABC, Generic[Item, Result]):
    """Workers for one kind of work, as a context. tell: receives a line when one is lost; name: the item in it."""

    def __init__(
        self, work: Callable[[Item], Result], *, tell: Report = print, name: Callable[[Item], str] = str
    ) -> None:
        self.work = work
        self.tell = tell
        self.name = name
        self._pending: dict[Future[Result], tuple[int, Item]] = {}

    def run(self, items: Iterable[Item]) -> Iterator[tuple[Item, Result | Lost]]:
        """Results in the order in which they end; an item is taken when a worker is free for it.

        Raises errors of the work, and UserError where no workers are left.
        """
        waiting, losses = iter(items), Counter[int]()
        pending, taken = self._pending, 0
        while True:
            while len(pending) < self.size:
                try:
                    item = next(waiting)
                except StopIteration:
                    break
                pending[self.submit(item)] = taken, item
                taken += 1
            if not pending:
                return
            for future in wait(pending, timeout=POLL, return_when=FIRST_COMPLETED).done:
                number, item = pending.pop(future)
                try:
                    found: Result | Lost = self.result(future)
                except BrokenExecutor:
                    losses[number] += 1
                    if losses[number] < LOSSES:
                        self.tell(f"a worker process was lost; {self.name(item)} runs again")
                        pending[self.submit(item)] = number, item
                        continue
                    found = Lost()
                yield item, found

    def drained(self) -> Iterator[tuple[Item, Result | Lost]]:
        """Wait for running items; failed and lost ones are left out."""
        while self._pending:
            for future in wait(self._pending, return_when=FIRST_COMPLETED).done:
                _, item = self._pending.pop(future)
                if future.exception() is None:
                    yield item, self.result(future)

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of items that run at once."""

    @abstractmethod
    def submit(self, item: Item) -> Future[Result]:
        """Begin with an item."""

    def result(self, future: Future[Result]) -> Result | Lost:
        """The result of a finished future. Raises BrokenExecutor where its worker was lost."""
        return future.result()

    def close(self) -> None:
        """End all workers, including running work."""

    def __enter__(self) -> Workers[Item, Result]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def count(jobs: int) -> int:
    """A number of jobs: 0 or -1 is one for each processor. Raises UserError for less."""
    if jobs in (0, -1):
        return len(os.sched_getaffinity(0))
    if jobs < 1:
        raise UserError(f"--jobs {jobs}: write how many processes, or 0 for one on each processor")
    return jobs


def in_one_thread(work: Callable[[Item], Result], item: Item) -> Result:
    """Run an item with one thread, as in parallel processes."""
    with alone():
        return work(item)

"""Independent pieces of work in parallel processes, and a store of results for the next run.

The piece of a lost process (killed, out of memory) runs again; an interruption loses running pieces, and finished ones
are in the store. Each process has one thread of linear algebra, since more would slow each other down.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import warnings
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from functools import partial
from pathlib import Path
from typing import Any, Generic

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from hybrid_sysid_ros.extensions.shared.workers import ONE_THREAD, Item, Lost, Result, Workers, count, in_one_thread
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256, written_folder

IDLE = 60.0
"""Seconds after which an idle process ends, also one whose parent was killed."""

ARRAYS = "arrays.safetensors"
FINISHED = "finished.json"
"""The file that shows that a result was written whole, with its key and its SHA-256."""


class Here(Workers[Item, Result]):
    """Runs one item after the other in this process; the work may use all of its threads."""

    @property
    def size(self) -> int:
        return 1

    def submit(self, item: Item) -> Future[Result]:
        future: Future[Result] = Future()
        try:
            future.set_result(self.work(item))
        except Exception as error:
            future.set_exception(error)
        return future


class Processes(Workers[Item, Result]):
    """Processes of this machine, by joblib's executor. Each is a pool of its own, so that only one breaks at a loss.

    jobs: see :func:`~.workers.count`. Work and items are pickled.
    """

    def __init__(self, work: Callable[[Item], Result], *, jobs: int = 0, **more: Any) -> None:
        super().__init__(work, **more)
        self._idle = [self._process() for _ in range(count(jobs))]
        self._busy: dict[Future[Result], Executor] = {}

    @staticmethod
    def _process() -> Executor:
        from joblib.externals.loky import ProcessPoolExecutor

        # A worker that compiled much code is replaced between two items: nothing that a user could act on.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        # Ctrl-C goes to the whole group of processes, and the parent is the one that answers it.
        ignore = {"initializer": signal.signal, "initargs": (signal.SIGINT, signal.SIG_IGN)}
        executor: Executor = ProcessPoolExecutor(1, timeout=IDLE, env=ONE_THREAD, **ignore)
        return executor

    @property
    def size(self) -> int:
        return len(self._idle) + len(self._busy)

    def submit(self, item: Item) -> Future[Result]:
        process = self._idle.pop()
        future = process.submit(in_one_thread, self.work, item)
        self._busy[future] = process
        return future

    def result(self, future: Future[Result]) -> Result:
        process = self._busy.pop(future)
        try:
            found = future.result()
        except BrokenExecutor:
            process.shutdown()
            self._idle.append(self._process())
            raise
        self._idle.append(process)
        return found

    def close(self) -> None:
        for process in (*self._idle, *self._busy.values()):
            process.shutdown(kill_workers=True)  # type: ignore[call-arg]  # loky's


def workers_for(
    work: Callable[[Item], Result], *, jobs: int = 0, cluster: str = "", **more: Any
) -> Workers[Item, Result]:
    """A cluster, where its address is given, else processes, or for one job this process itself."""
    if cluster:
        from hybrid_sysid_ros.extensions.shared.cluster import Cluster

        return Cluster(work, cluster, jobs=jobs, **more)
    return Here(work, **more) if count(jobs) == 1 else Processes(work, jobs=jobs, **more)


class Store(Generic[Result]):
    """Finished results in a folder. Each has a key of all that it depends on, and is written whole or not at all.

    purpose: the common part of all keys; results of another purpose are not found. Results are named arrays; a subclass
    may store others.
    """

    def __init__(self, folder: Path, purpose: str = "") -> None:
        self.folder = folder
        self.purpose = purpose

    @property
    def kept(self) -> int:
        """Number of stored results of any purpose."""
        return sum(1 for _ in self.folder.glob(f"*/{FINISHED}"))

    def write(self, result: Result, folder: Path) -> None:
        """Write a result into a folder of its own."""
        arrays: Any = result
        content = save({name: np.ascontiguousarray(value) for name, value in arrays.items()})
        (folder / ARRAYS).write_bytes(content)

    def read(self, folder: Path) -> Result:
        """The result in a folder; one that raises an error counts as missing."""
        found: Any = load_file(folder / ARRAYS)
        return found  # type: ignore[no-any-return]

    def find(self, key: Any) -> Result | None:
        """The result of a key; None where it is missing, altered, or can't be read.

        key: plain data, or objects with a distinctive repr().
        """
        place = self._place(key)
        try:
            written = json.loads((place / FINISHED).read_text(encoding="utf-8"))["sha256"]
            return self.read(place) if written == sha256(place, without=FINISHED) else None
        except (OSError, SafetensorError, ValueError, KeyError, TypeError, UserError):
            return None

    def keep(self, key: Any, result: Result) -> None:
        """Write a result. Raises UserError where the place can't be written."""
        with written_folder(self._place(key), marker=FINISHED, force=True) as partial:
            self.write(result, partial)
            (partial / FINISHED).write_text(_text({"key": key, "sha256": sha256(partial)}), encoding="utf-8")

    def remove(self) -> None:
        """Remove the folder: the work as a whole is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _place(self, key: Any) -> Path:
        return self.folder / hashlib.sha256(f"{self.purpose}\n{_text(key)}".encode()).hexdigest()[:24]


def _text(key: Any) -> str:
    return json.dumps(key, sort_keys=True, default=repr)


def run(
    work: Callable[[Item], Result],
    pieces: Sequence[Item],
    *,
    workers: int = 0,
    cluster: str = "",
    store: Store[Result] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Result]:
    """Results of ``work`` for each piece, in their order.

    workers: see :func:`~.workers.count`. cluster: see :class:`~.cluster.Cluster`, in place of processes. store: a store
    of finished pieces, so that an interrupted run can continue. progress: receives the numbers of finished and of all
    pieces. After Ctrl-C no more work is begun; results of running pieces are still stored. Raises UserError where a
    piece loses its processes repeatedly.
    """
    found: dict[int, Result] = {}
    jobs = min(count(workers), max(len(pieces), 1))
    with workers_for(partial(_numbered, work), jobs=jobs, cluster=cluster) as crew:
        for (number, _), result, _ in resumed(
            crew, list(enumerate(pieces)), store=store, key=lambda item: item[1], finish=True
        ):
            if isinstance(result, Lost):
                raise UserError(f"piece {number + 1} of {len(pieces)}: {result.reason}")
            found[number] = result
            if progress is not None:
                progress(len(found), len(pieces))
    return [found[number] for number in range(len(pieces))]


def _numbered(work: Callable[[Item], Result], item: tuple[int, Item]) -> Result:
    return work(item[1])


def resumed(
    found: Workers[Item, Result],
    items: Iterable[Item],
    *,
    store: Store[Result] | None = None,
    key: Callable[[Item], Any] = lambda item: item,
    keep: Callable[[Result], bool] = lambda result: True,
    finish: bool = False,
) -> Generator[tuple[Item, Result | Lost, bool], None, None]:
    """(item, result, whether it was stored) of all items: stored ones first, then others as they finish.

    Each new result for which ``keep`` is true is in the store before it is yielded. finish: after Ctrl-C, running items
    are awaited and stored.
    """
    left = []
    for item in items:
        kept = store.find(key(item)) if store is not None else None
        if kept is None:
            left.append(item)
        else:
            yield item, kept, True
    try:
        for item, result in found.run(left):
            if store is not None and not isinstance(result, Lost) and keep(result):
                store.keep(key(item), result)
            yield item, result, False
    except KeyboardInterrupt:
        if finish and store is not None:
            for item, result in found.drained():
                if not isinstance(result, Lost) and keep(result):
                    store.keep(key(item), result)
        raise

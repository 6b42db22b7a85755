"""Work in parallel that can be resumed: each piece gives arrays, kept on disk as it finishes."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from hybrid_sysid_ros.support.files import written_file
from hybrid_sysid_ros.support.threads import ONE_THREAD

Arrays = dict[str, NDArray[Any]]
Piece = TypeVar("Piece")


@dataclass(frozen=True)
class Store:
    """Finished pieces of one piece of work, one file each."""

    folder: Path
    purpose: str
    """Everything that the results depend on, as text; pieces of another purpose are not found again."""

    def find(self, piece: object) -> Arrays | None:
        """What a piece gave; None where it is not there or was not written whole."""
        path = self._path(piece)
        try:
            return dict(load_file(path)) if path.is_file() else None
        except (SafetensorError, OSError):
            return None

    def keep(self, piece: object, arrays: Arrays) -> None:
        """Write what a piece gave."""
        with written_file(self._path(piece)) as partial:
            partial.write_bytes(save({name: np.ascontiguousarray(value) for name, value in arrays.items()}))

    def remove(self) -> None:
        """Remove the folder: the work is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, piece: object) -> Path:
        key = hashlib.sha256(f"{self.purpose}\n{piece!r}".encode()).hexdigest()[:24]
        return self.folder / f"{key}.safetensors"


def run(
    work: Callable[[Piece], Arrays],
    pieces: Sequence[Piece],
    *,
    workers: int = 0,
    store: Store | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Arrays]:
    """What ``work`` gives for each piece, in their order.

    workers: processes, 0 for one per core; one works in this process. store: where finished pieces are kept, so that an
    interrupted run goes on. progress: gets how many pieces are done, and of how many. Ctrl-C is for this process: it
    ends what is under way; what is finished is kept.
    """
    count = min(workers or os.cpu_count() or 1, max(len(pieces), 1))
    jobs = (joblib.delayed(_once)(work, piece, store, os.getpid()) for piece in pieces)
    found: list[Arrays] = []
    backend = "loky" if count > 1 else "sequential"
    with joblib.parallel_config(backend=backend, **_threads(count)), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*tasks", category=UserWarning)  # of what an interrupt leaves undone
        with closing(joblib.Parallel(n_jobs=count, return_as="generator", batch_size=1)(jobs)) as results:
            for result in results:
                found.append(result)
                if progress is not None:
                    progress(len(found), len(pieces))
    return found


def _threads(count: int) -> dict[str, int]:
    """One thread of linear algebra a worker: more only get into each other's way."""
    return {"inner_max_num_threads": 1} if count > 1 else {}


def _once(work: Callable[[Any], Arrays], piece: Any, store: Store | None, parent: int) -> Arrays:
    """A piece of work, done unless its result is there."""
    if os.getpid() != parent:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        os.environ.update(ONE_THREAD)
    found = store.find(piece) if store is not None else None
    if found is None:
        found = work(piece)
        if store is not None:
            store.keep(piece, found)
    return found

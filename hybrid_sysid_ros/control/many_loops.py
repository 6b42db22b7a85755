"""Many closed loops side by side, each giving arrays, kept on disk as they finish."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file

from hybrid_sysid_ros.models.storage import save_arrays
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.parallel import Lost, Store, count, resumed, workers

Arrays = dict[str, NDArray[Any]]
Item = TypeVar("Item")

FILE = "loop.safetensors"


@dataclass(frozen=True)
class Kept:
    """Where finished loops are kept, so that what is interrupted goes on."""

    folder: Path
    purpose: str
    """All that the loops depend on, as text; loops of another purpose are not found again."""

    @property
    def store(self) -> Store[Arrays]:
        return Store(self.folder, write=lambda arrays, place: save_arrays(place / FILE, arrays), read=_read)

    def key(self, item: object) -> list[str]:
        """Of one loop, or of some."""
        return [self.purpose, repr(item)]

    def remove(self) -> None:
        """The work is finished."""
        self.store.remove()


def _read(place: Path) -> Arrays:
    try:
        return dict(load_file(place / FILE))
    except SafetensorError as error:
        raise ValueError(f"{place}: {error}") from error


def run_all(
    work: Callable[[Item], Arrays],
    items: Sequence[Item],
    *,
    jobs: int = 0,
    kept: Kept | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Arrays]:
    """What ``work`` gives for each item, in their order; items that are kept are not done again.

    jobs: processes, 0 for one per core; for one, this process. progress: gets how many are done, and of how many.
    Raises UserError where a process was lost again and again.
    """
    found: dict[int, Arrays] = {}
    with workers(_Numbered(work), jobs=min(count(jobs), max(len(items), 1))) as team:
        pairs = resumed(
            team,
            enumerate(items),
            store=kept.store if kept is not None else None,
            key=lambda pair: kept.key(pair[1]) if kept is not None else None,
        )
        for (index, _), result, _ in pairs:
            if isinstance(result, Lost):
                raise UserError(f"closed loops: {result.reason}")
            found[index] = result
            if progress is not None:
                progress(len(found), len(items))
    return [found[index] for index in range(len(items))]


@dataclass(frozen=True)
class _Numbered:
    """Work on an item with its number."""

    work: Callable[[Any], Arrays]

    def __call__(self, pair: tuple[int, Any]) -> Arrays:
        return {name: np.asarray(values) for name, values in self.work(pair[1]).items()}

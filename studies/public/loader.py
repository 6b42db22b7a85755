"""Records of the loader nonlinear-benchmarks, which downloads the sets and cuts them as they are published."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from studies.public.sets import Reader, Split, record_of

FUNCTIONS = {"drives": "CED", "tanks": "Cascaded_Tanks", "silverbox": "Silverbox"}
"""What each set is called there."""


def loader_of(source: str) -> Callable[[str], Reader] | None:
    """The readers of sets by a source; None for files. Raises UserError for another source, and without the loader."""
    if source == "files":
        return None
    if source != "nonlinear-benchmarks":
        raise UserError(f"there is no source {source}; choose files or nonlinear-benchmarks")
    with extra("public"):
        import nonlinear_benchmarks

    def reader_of(name: str) -> Reader:
        def reader(folder: Path) -> Split:
            try:
                train, tests = getattr(nonlinear_benchmarks, FUNCTIONS[name])(always_return_tuples_of_datasets=True)
            except Exception as error:  # of its downloads
                raise UserError(f"nonlinear-benchmarks does not give {FUNCTIONS[name]}: {error}") from error
            return records_of(train), records_of(tests)

        return reader

    return reader_of


def records_of(data: Iterable[Any]) -> list[Record]:
    """Records of the loader's sets, each with u, y, sampling_time and name. Raises UserError where several inputs or
    outputs, or no sampling time, are in one.
    """
    found = []
    for number, item in enumerate(data):
        u, y = np.squeeze(item.u), np.squeeze(item.y)
        if u.ndim != 1 or y.ndim != 1 or item.sampling_time is None:
            raise UserError(f"{item.name}: u {u.shape} and y {y.shape} need one column each and a sampling time")
        found.append(record_of(f"{number + 1} {item.name}", u, y, float(item.sampling_time)))
    return found

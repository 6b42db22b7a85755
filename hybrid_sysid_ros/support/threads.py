"""Threads of libraries: where several things run side by side each gets one, for spinning neighbours slow it down."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a process whose libraries have one thread each."""


@contextmanager
def one_torch_thread(torch: Any) -> Iterator[None]:
    """Train in one thread: batches are small, and a second thread that finds its core busy holds up the first."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)

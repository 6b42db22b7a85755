"""Threads of torch, which only extensions have."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def one_torch_thread(torch: Any) -> Iterator[None]:
    """Train in one thread: batches are small, and a second thread on a busy core delays the first."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)

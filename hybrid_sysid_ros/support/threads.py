"""Threads of libraries: parallel work gets one each, since threads that spin slow each other down."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_available = ContextVar("threads", default=2)


def available() -> int:
    """Number of threads that one piece of work may use."""
    return _available.get()


@contextmanager
def alone() -> Iterator[None]:
    """Limit work to one thread, since other work runs in parallel."""
    from threadpoolctl import threadpool_limits

    token = _available.set(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        _available.reset(token)

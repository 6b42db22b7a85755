"""Closed loops of the exact MPC in several processes, kept on disk as they finish."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import get_context
from types import TracebackType

from hybrid_sysid_ros.control.policy.sample_store import SampleStore
from hybrid_sysid_ros.control.policy.sampling import Samples
from hybrid_sysid_ros.support.threads import ONE_THREAD

Work = Callable[[int], Samples]
"""The samples of a seed."""


class SamplingPool:
    """Processes that sample, as a context. Ctrl-C is for the parent: it stops handing out work and keeps the loops
    under way once they finish.
    """

    def __init__(self, workers: int = 0, store: SampleStore | None = None) -> None:
        """workers: 0 for one per core. store: where finished loops are kept and found again."""
        self._workers = workers or os.cpu_count() or 1
        self._store = store
        self._stack = ExitStack()

    def __enter__(self) -> SamplingPool:
        self._stack.enter_context(_one_thread_each())
        ignore = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)
        pool = ProcessPoolExecutor(self._workers, mp_context=get_context("spawn"), initializer=ignore)
        self._pool = self._stack.enter_context(pool)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def run(self, work: Work, seeds: list[int], progress: Callable[[int, int], None]) -> list[Samples]:
        """The loops of the seeds, in their order; those that the store has are not run again."""
        store = self._store
        found = {seed: store.find(seed) if store is not None else None for seed in seeds}
        running = {seed: self._pool.submit(work, seed) for seed, samples in found.items() if samples is None}
        loops: list[Samples] = []
        try:
            for done, seed in enumerate(seeds):
                samples = found[seed] or running[seed].result()
                if store is not None and seed in running:
                    store.keep(seed, samples)
                loops.append(samples)
                progress(done + 1, len(seeds))
        except KeyboardInterrupt:
            self._pool.shutdown(wait=True, cancel_futures=True)
            for seed, future in running.items():
                if store is not None and not future.cancelled() and future.exception() is None:
                    store.keep(seed, future.result())
            raise
        return loops


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started here use one thread of linear algebra: more only get into each other's way."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

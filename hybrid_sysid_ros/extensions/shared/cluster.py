"""Trials on a Dask cluster."""

from __future__ import annotations

import importlib.metadata
import logging
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Any

from hybrid_sysid_ros.extensions.shared.workers import ONE_THREAD, Item, Lost, Result, Workers, count, in_one_thread
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

LOCAL = "local"
PATIENCE = 60.0
"""Seconds that a cluster may be without a worker, and that its first one may take to come."""

IGNORE_INTERRUPT = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
LARGE = {"distributed.admin.large-graph-warning-threshold": "1GiB"}  # records are sent as part of a task, see Cluster


class Cluster(Workers[Item, Result]):
    """A Dask cluster, which gives the item of a lost worker to another one by itself.

    address: of its scheduler; "local" starts a cluster of `jobs` processes on this machine. The work, and the records
    in it, is the result of a task, not scattered data: the cluster can make it again wherever it is lost.
    Raises UserError where the cluster is not there, has no workers, or works with another version.
    """

    def __init__(
        self, work: Callable[[Item], Result], address: str, *, jobs: int = 0, patience: float = PATIENCE, **more: Any
    ) -> None:
        super().__init__(work, **more)
        with extra("search"):
            import dask
            from distributed import Client, LocalCluster
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is reported in one line
        self.address, self.patience = address, patience
        self._cluster = None
        if address == LOCAL:
            self._cluster = LocalCluster(
                n_workers=count(jobs),
                threads_per_worker=1,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
                env=ONE_THREAD,
                preload=IGNORE_INTERRUPT,
            )
        try:
            self._client = Client(self._cluster or address, timeout=min(10.0, patience))
        except (OSError, ValueError) as error:
            raise UserError(f"--cluster {address}: no scheduler answers there; start `dask scheduler`") from error
        try:
            self._workers = self._wait_for_workers()
            self._check_versions()
            self._seen = time.monotonic()
            self._executor = self._client.get_executor(pure=False)
            with dask.config.set(LARGE):
                self._work = self._client.submit(_same, work, pure=False)
        except BaseException:
            self.close()
            raise

    @property
    def size(self) -> int:
        try:
            workers = dict(self._client.nthreads())
        except OSError as error:
            raise self._gone() from error
        for lost in self._workers.keys() - workers.keys():
            self.tell(f"worker {lost} was lost; what it was at runs again on another")
        self._workers = workers
        if workers:
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > self.patience:
            raise UserError(
                f"--cluster {self.address}: no worker is left since {self.patience:g} s; start some (`dask worker "
                "ADDRESS`) and repeat the command, which goes on from what is finished"
            )
        return max(1, sum(workers.values()))

    def submit(self, item: Item) -> Future[Result]:
        future: Future[Result] = self._executor.submit(in_one_thread, self._work, item)
        return future

    def result(self, future: Future[Result]) -> Result | Lost:
        from distributed import KilledWorker

        try:
            return future.result()
        except KilledWorker as error:
            return Lost(f"its workers were lost again and again; perhaps it needs more memory ({error})")
        except CancelledError as error:
            raise self._gone() from error

    def close(self) -> None:
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _gone(self) -> UserError:
        return UserError(
            f"--cluster {self.address}: the scheduler is gone; start it and repeat the command, which goes on from "
            "what is finished"
        )

    def _wait_for_workers(self) -> dict[str, int]:
        from distributed import TimeoutError as NoWorkers  # asyncio's in Python 3.10

        try:
            self._client.wait_for_workers(1, timeout=self.patience)
        except NoWorkers as error:
            raise UserError(f"--cluster {self.address}: has no workers; start some: `dask worker ADDRESS`") from error
        return dict(self._client.nthreads())

    def _check_versions(self) -> None:
        name = __package__.partition(".")[0]
        here = importlib.metadata.version(name)
        there = self._client.run(importlib.metadata.version, name, on_error="return")
        for address, version in there.items():
            if version != here:
                found = "is missing" if isinstance(version, Exception) else f"is version {version}"
                raise UserError(f"worker {address}: {name} {found} there; install version {here}, as here")


def _same(work: Any) -> Any:
    return work

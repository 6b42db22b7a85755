"""Where trials are evaluated: processes of joblib, or a Dask cluster. A lost worker's trial runs again."""

from __future__ import annotations

import signal
import warnings
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from types import TracebackType

from hybrid_sysid_ros.identification.selection.search.evaluation import Objective, Outcome, evaluate
from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.threads import ONE_THREAD

Tell = Callable[[str], object]

POLL = 1.0
"""Seconds between two looks at the workers."""

LOSSES = 3
"""A trial whose worker was lost so many times has failed: it is probably what kills them."""

IDLE = 60.0
"""Seconds after which an idle process ends, also one whose parent was killed."""


class Workers(ABC):
    """Workers for one objective. tell: gets a line when one is lost."""

    def __init__(self, objective: Objective, tell: Tell) -> None:
        self.objective = objective
        self.tell = tell

    def run(self, tasks: Iterator[tuple[int, Options]]) -> Iterator[tuple[int, Outcome]]:
        """Outcomes of numbered tasks in the order in which they end; a task is taken when a worker is free for it.

        Raises UserError where there are no workers any more.
        """
        pending: dict[Future[Outcome], tuple[int, Options]] = {}
        losses: Counter[int] = Counter()
        while True:
            while len(pending) < self.size and (task := next(tasks, None)) is not None:
                pending[self._submit(task[1])] = task
            if not pending:
                return
            for future in wait(pending, timeout=POLL, return_when=FIRST_COMPLETED).done:
                number, options = pending.pop(future)
                outcome = self._outcome(future)
                if outcome is None:
                    losses[number] += 1
                    if losses[number] < LOSSES:
                        self.tell(f"a worker process was lost; trial {number} runs again")
                        pending[self._submit(options)] = (number, options)
                        continue
                    outcome = Outcome(error=f"its worker process was lost {LOSSES} times; perhaps it needs more memory")
                yield number, outcome

    @property
    @abstractmethod
    def size(self) -> int:
        """Tasks that run at once."""

    @abstractmethod
    def _submit(self, options: Options) -> Future[Outcome]: ...

    @abstractmethod
    def _outcome(self, future: Future[Outcome]) -> Outcome | None:
        """What a finished future brought, None where its worker was lost."""

    @abstractmethod
    def close(self) -> None:
        """End what was started, running tasks included."""

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Processes(Workers):
    """Processes of this machine, by joblib's executor. Each is a pool of its own: it breaks alone when it is killed.

    jobs: how many; -1 is one for each processor.
    """

    def __init__(self, objective: Objective, tell: Tell, jobs: int = -1) -> None:
        super().__init__(objective, tell)
        self._idle = [self._process() for _ in range(count(jobs))]
        self._busy: dict[Future[Outcome], Executor] = {}

    @staticmethod
    def _process() -> Executor:
        with extra("search"):
            from joblib.externals.loky import ProcessPoolExecutor
        # A worker that compiled much code is replaced between two trials: nothing that a user could act on.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        # Ctrl-C goes to the whole group of processes, and the parent is the one that answers it.
        ignore = {"initializer": signal.signal, "initargs": (signal.SIGINT, signal.SIG_IGN)}
        executor: Executor = ProcessPoolExecutor(1, timeout=IDLE, env=ONE_THREAD, **ignore)
        return executor

    @property
    def size(self) -> int:
        return len(self._idle) + len(self._busy)

    def _submit(self, options: Options) -> Future[Outcome]:
        process = self._idle.pop()
        future = process.submit(evaluate, self.objective, options)
        self._busy[future] = process
        return future

    def _outcome(self, future: Future[Outcome]) -> Outcome | None:
        process = self._busy.pop(future)
        try:
            outcome = future.result()
        except BrokenExecutor:
            process.shutdown()
            self._idle.append(self._process())
            return None
        self._idle.append(process)
        return outcome

    def close(self) -> None:
        for process in (*self._idle, *self._busy.values()):
            process.shutdown(kill_workers=True)  # type: ignore[call-arg]  # loky's


def count(jobs: int) -> int:
    """A number of processes out of --jobs. Raises UserError for none."""
    if jobs == -1:
        with extra("search"):
            import joblib
        return int(joblib.cpu_count())
    if jobs < 1:
        raise UserError(f"--jobs {jobs}: write how many processes, or -1 for one on each processor")
    return jobs

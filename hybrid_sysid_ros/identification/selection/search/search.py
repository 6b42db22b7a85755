"""A search: trials of a study, evaluated by workers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from hybrid_sysid_ros.identification.selection.search.study import Study, Trial
from hybrid_sysid_ros.identification.selection.search.workers import Workers
from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.support.errors import UserError

FAILURES = 5
"""Failed trials, and no other, after which a search is given up: the mistake is not in the options."""


def search(
    study: Study,
    workers: Workers,
    *,
    trials: int,
    timeout: float | None = None,
    told: Callable[[Trial], object] = lambda trial: None,
) -> None:
    """Evaluate until the study has so many trials, those of earlier runs included.

    timeout: seconds after which no trial is begun any more. told: gets each finished trial. Every outcome is in the
    study as soon as it is there, so an interruption loses only trials that are running, and those run again next time.
    Raises UserError where nothing but failures comes.
    """
    deadline = None if timeout is None else time.monotonic() + timeout

    def asked() -> Iterator[tuple[int, Options]]:
        while study.begun < trials and (deadline is None or time.monotonic() < deadline):
            number, options = study.ask()
            if (known := study.outcome_at(options)) is None:
                yield number, options
            else:
                told(study.tell(number, known))

    for number, outcome in workers.run(asked()):
        told(study.tell(number, outcome))
        finished = study.finished
        if len(finished) >= FAILURES and all(trial.outcome.error for trial in finished):
            raise UserError(f"all {len(finished)} trials failed, the last one with: {outcome.error}")

"""One evaluation of an objective, as a worker does it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from threadpoolctl import threadpool_limits

from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.support.errors import UserError


class Answer(Protocol):
    """value: what is maximised. scores: what the value is made of, by name."""

    @property
    def value(self) -> float: ...

    @property
    def scores(self) -> Mapping[str, float]: ...


Objective = Callable[[Options], Answer]
"""What is maximised, by the value of its answer. It goes to other processes and machines: pickled, and pure."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """score: what is maximised, minus infinity where the evaluation diverged or failed. parts: what the score is made
    of, by name. error: why it failed, empty where it didn't.
    """

    score: float = -math.inf
    parts: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    error: str = ""


def evaluate(objective: Objective, options: Options) -> Outcome:
    """Evaluate in one thread of linear algebra, for the workers are the parallel part. A UserError is an outcome too;
    any other exception is a mistake of the program and is raised.
    """
    began = time.perf_counter()
    try:
        with threadpool_limits(1):
            answer = objective(options)
        if math.isnan(answer.value):
            raise UserError("the score is not a number")
    except UserError as error:
        return Outcome(error=" ".join(str(error).split()), seconds=round(time.perf_counter() - began, 3))
    seconds = round(time.perf_counter() - began, 3)
    return Outcome(score=answer.value, parts=dict(answer.scores), seconds=seconds)

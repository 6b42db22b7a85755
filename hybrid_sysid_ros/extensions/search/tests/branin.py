"""Branin's function as what a search maximises, for tests: as it is, watched, deadly to its process, and wrong."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.extensions.search.search import Evaluate, Objective, trial_name
from hybrid_sysid_ros.extensions.search.study import opened_study
from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.models import Option, Options
from hybrid_sysid_ros.support.errors import UserError

MINIMUM = 0.397887
"""Of Branin's function: Dixon and Szegoe (1978), Towards Global Optimisation 2; at (-pi, 12.275) and two more."""

SPACE = {
    "x": Option(default=0.0, low=-5.0, high=10.0, kind="float", description="first"),
    "y": Option(default=5.0, low=0.0, high=15.0, kind="float", description="second"),
}


@dataclass(frozen=True)
class Answer:
    value: float
    scores: Mapping[str, float] = field(default_factory=dict)


def branin(options: Options) -> Answer:
    x, y = options["x"], options["y"]
    b, c, t = 5.1 / (4 * math.pi**2), 5 / math.pi, 1 / (8 * math.pi)
    value = (y - b * x**2 + c * x - 6) ** 2 + 10 * (1 - t) * math.cos(x) + 10
    return Answer(-value, {"branin": -value})


@dataclass(frozen=True)
class SlowBranin:
    """Branin's function that leaves a file for each call: what it was called with, and by which process. The call with
    the name of `slow` waits until a file `go` is there.
    """

    folder: Path
    slow: str = ""

    def __call__(self, options: Options) -> Answer:
        name = f"{options['x']:.12g}"
        attempt = len(list(self.folder.glob(f"call {name} *")))
        (self.folder / f"call {name} {attempt}").write_text(str(os.getpid()))
        while self.slow in ("any", name) and not (self.folder / "go").exists():
            time.sleep(0.01)
        return branin(options)


@dataclass(frozen=True)
class Deadly:
    """Kills its process where x is at its default."""

    def __call__(self, options: Options) -> Answer:
        if options["x"] == SPACE["x"].default:
            os.kill(os.getpid(), signal.SIGKILL)
        return branin(options)


def picky(options: Options) -> Answer:
    if options["x"] > 0.0:
        raise UserError("x is positive,\nwhich is not allowed")
    return branin(options)


def broken(options: Options) -> Answer:
    raise UserError("nothing works here")


def mistaken(options: Options) -> Answer:
    raise ZeroDivisionError


class OfBranin(Objective):
    """Branin's function in the place of what the command maximises; FOLDER and SLOW are its files, see SlowBranin."""

    space = SPACE

    def __post_init__(self) -> None: ...

    def __call__(self, options: Options) -> Answer:  # type: ignore[override]
        return SlowBranin(Path(os.environ["FOLDER"]), os.environ.get("SLOW", ""))(options)


def here(objective) -> parallel.Here[Any, Any]:
    """Evaluates at once, in this process."""
    return parallel.Here(Evaluate(objective=objective), name=trial_name)


def processes(objective, tell, jobs: int) -> parallel.Processes[Any, Any]:
    return parallel.Processes(Evaluate(objective=objective), jobs=jobs, tell=tell, name=trial_name)


def study_of(place: str, seed: int = 0, **problem: object):
    return opened_study(place, "branin", problem={"function": "branin", **problem}, space=SPACE, seed=seed)


def wait_for(found, seconds: float = 15.0):
    """The first true value of a function."""
    deadline = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)
    return value

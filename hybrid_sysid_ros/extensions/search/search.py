"""A search: options of a structure that a study asks for, judged by cross-validation, side by side."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.search.cross_validation import Validation, cross_validate
from hybrid_sysid_ros.extensions.search.study import Evaluation, Study, TrialResult
from hybrid_sysid_ros.extensions.shared.workers import Lost, Workers
from hybrid_sysid_ros.identification.identify import identify
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.models import Model, Option, Options, Sampling, options_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

FAILURES = 5
"""Failed evaluations, and no other, after which a search is given up: the mistake is not in the options."""


class Scored(Protocol):
    """What an objective gives."""

    @property
    def value(self) -> float:
        """What is maximised."""

    @property
    def scores(self) -> Mapping[str, float]:
        """What the value is made of, by name."""


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """An objective as the work of other processes and machines: pickled, and pure."""

    objective: Callable[[Options], Scored]

    def __call__(self, item: tuple[int, Options]) -> TrialResult:
        """The outcome of numbered options. A UserError is one too; any other exception is a mistake of the program."""
        began = time.perf_counter()
        try:
            found = self.objective(item[1])
            if math.isnan(found.value):
                raise UserError("the score is not a number")
        except UserError as error:
            return TrialResult(error=" ".join(str(error).split()), seconds=round(time.perf_counter() - began, 3))
        seconds = round(time.perf_counter() - began, 3)
        return TrialResult(score=found.value, parts=dict(found.scores), seconds=seconds)


@dataclass(frozen=True, kw_only=True, eq=False)
class Objective:
    """The cross-validated free run of a structure over parts of records, as a function of the structure's options."""

    records: Sequence[Record]
    rig: Rig
    structure: str
    sampling: Sampling
    part: Part
    seed: int = 0
    folds: int = 3

    def __post_init__(self) -> None:
        # Workers are sent what is fitted only.
        object.__setattr__(self, "records", tuple(replace(record, channels={}) for record in self.records))

    def __call__(self, options: Options) -> Validation:
        return cross_validate(self.records, self.rig, self.structure, options=options, folds=self.folds, **self._shared)

    @property
    def space(self) -> Mapping[str, Option]:
        """The options that are searched. Raises UserError for an unknown structure."""
        known = options_of(self.structure, self.rig.system, self.rig.structures)
        return {name: option for name, option in known.items() if option.searched}

    @property
    def problem(self) -> dict[str, Any]:
        """Everything that the scores depend on."""
        return {
            "rig": self.rig.name,
            "structure": self.structure,
            "records": {record.name: record.fingerprint for record in self.records},
            "sampling": asdict(self.sampling),
            "part": f"{self.part.start:g}:{self.part.stop:g}",
            "seed": self.seed,
            "folds": self.folds,
            "options": {name: [option.kind, option.low, option.high] for name, option in self.space.items()},
        }

    def fit(self, options: Options) -> Model:
        """The structure fitted to the parts of all records."""
        return identify(self.records, self.rig, self.structure, options=options, **self._shared)

    @property
    def _shared(self) -> dict[str, Any]:
        return {"sampling": self.sampling, "part": self.part, "seed": self.seed}


def search(
    study: Study,
    workers: Workers[tuple[int, Options], TrialResult],
    *,
    trials: int,
    timeout: float | None = None,
    report: Callable[[Evaluation], object] = lambda evaluation: None,
) -> None:
    """Evaluate until the study has so many evaluations, those of earlier runs included.

    workers: of :class:`Evaluate`. timeout: seconds after which none is begun any more. report: gets each finished one.
    Every outcome is in the study as soon as it is there, so an interruption loses only what is running, and that runs
    again next time. Raises UserError where nothing but failures comes.
    """
    deadline = None if timeout is None else time.monotonic() + timeout

    def asked() -> Iterator[tuple[int, Options]]:
        while study.started < trials and (deadline is None or time.monotonic() < deadline):
            number, options = study.ask()
            if (known := study.outcome_at(options)) is None:
                yield number, options
            else:
                report(study.tell(number, known))

    for (number, _), found in workers.run(asked()):
        outcome = TrialResult(error=found.reason) if isinstance(found, Lost) else found
        report(study.tell(number, outcome))
        finished = study.finished
        if len(finished) >= FAILURES and all(item.outcome.error for item in finished):
            raise UserError(f"all {len(finished)} trials failed, the last one with: {outcome.error}")


def trial_name(item: tuple[int, Options]) -> str:
    """An item, as lines about it call it."""
    return f"trial {item[0]}"

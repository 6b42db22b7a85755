"""Trials of a tuning, kept by Optuna in a file, and the front of those that no other beats in both measures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hybrid_sysid_ros.extensions.shared.database import database
from hybrid_sysid_ros.extensions.shared.trials import distribution_of, sampler_at, study_differences
from hybrid_sysid_ros.extensions.tuning.loops import Measures
from hybrid_sysid_ros.models import Option, Options
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

if TYPE_CHECKING:
    import optuna

AIMS = ("settling", "effort", "bounds")


@dataclass(frozen=True, kw_only=True)
class TuningTrial:
    """Options that were tried; number 0 is what ships."""

    number: int
    options: Options
    measures: Measures


class Trials:
    """Drawn by Optuna's TPE for both measures, by the seed and the number of trials before; the first is what ships."""

    def __init__(self, study: optuna.Study, space: Mapping[str, Option], seed: int) -> None:
        self._study, self._seed = study, seed
        self._distributions = {name: distribution_of(option) for name, option in space.items()}
        if not self.finished:
            study.enqueue_trial({name: option.default for name, option in space.items()}, skip_if_exists=True)

    @property
    def finished(self) -> list[TuningTrial]:
        """Trials that were measured, by number; those that a killed process left are not."""
        return [
            TuningTrial(number=number, options=trial.params, measures=Measures(**trial.user_attrs["measures"]))
            for number, trial in enumerate(
                item for item in self._study.get_trials(deepcopy=False) if "measures" in item.user_attrs
            )
        ]

    def ask(self) -> optuna.Trial:
        """The next trial."""
        self._study.sampler = sampler_at(self._seed, len(self.finished))
        return self._study.ask(self._distributions)

    def tell(self, trial: optuna.Trial, found: Measures | None) -> None:
        """Keep what was measured; None: the options can't be."""
        import optuna

        if found is None:
            self._study.tell(trial, state=optuna.trial.TrialState.FAIL)
            return
        trial.set_user_attr("measures", asdict(found))
        self._study.tell(trial, (found.settling, found.effort))


@contextmanager
def opened_trials(
    place: str, name: str, problem: Mapping[str, Any], space: Mapping[str, Option], seed: int
) -> Iterator[Trials]:
    """Trials of a name in a file, begun where there are none. Raises UserError where they are of another problem."""
    with extra("search"):
        import optuna
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    problem = json.loads(json.dumps(problem))
    with database(place) as storage:
        study = optuna.create_study(
            storage=storage, study_name=name, directions=["minimize", "minimize"], load_if_exists=True
        )
        kept = study.user_attrs.get("problem", problem)
        if kept != problem:
            raise UserError(
                f"{place}: study {name} was begun with {study_differences(kept, problem)}; choose another --study "
                "or repeat its command"
            )
        study.set_user_attr("problem", problem)
        yield Trials(study, space, seed)


def front_of(trials: Sequence[TuningTrial]) -> list[TuningTrial]:
    """Trials that no other one beats in settling and effort, the quickest first."""
    found: list[TuningTrial] = []
    for trial in sorted(trials, key=lambda item: (item.measures.settling, item.measures.effort)):
        if not found or trial.measures.effort < found[-1].measures.effort:
            found.append(trial)
    return found


def best_of(trials: Sequence[TuningTrial], aim: str) -> TuningTrial:
    """The best by an aim: the quickest without more effort than what ships, the calmest that is as quick, or the one
    that is inside most often, and then the quickest. All have at least as many loops inside as what ships.
    """
    ships = trials[0].measures
    kept = [trial for trial in trials if trial.measures.inside >= ships.inside]
    if aim == "settling":
        return min((t for t in kept if t.measures.effort <= ships.effort), key=lambda t: t.measures.settling)
    if aim == "effort":
        return min((t for t in kept if t.measures.settling <= ships.settling), key=lambda t: t.measures.effort)
    return max(kept, key=lambda t: (t.measures.inside, -t.measures.settling))

"""An Optuna study in a file: asked for trials and told their outcomes by one process, and gone on with by the next."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hybrid_sysid_ros.extensions.shared.database import database
from hybrid_sysid_ros.extensions.shared.trials import distribution_of, experimental, sampler_at, study_differences
from hybrid_sysid_ros.models import Option, Options
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

if TYPE_CHECKING:
    import optuna

IMPORTANCE_TRIALS = 100
"""Fewer say nothing about which option matters: it is judged by how the best tenth of the trials is spread."""


@dataclass(frozen=True, kw_only=True)
class TrialResult:
    """What an evaluation of options brought."""

    score: float = -math.inf
    """What is maximised, minus infinity where the evaluation diverged or failed."""
    parts: Mapping[str, float] = field(default_factory=dict)
    """What the score is made of, by name."""
    seconds: float = 0.0
    error: str = ""
    """Why it failed, empty where it didn't."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Options that were evaluated."""

    number: int
    options: Options
    outcome: TrialResult


class Study:
    """Trials of one problem, drawn by Optuna's TPE; the first is at the default options.

    A trial is drawn by the seed and the number of trials drawn before it, so that one worker draws the same trials
    whether or not it was interrupted. Trials that a killed process left unfinished are the next to be asked for.
    """

    def __init__(self, study: optuna.Study, space: Mapping[str, Option], seed: int) -> None:
        import optuna

        self._study, self._seed = study, seed
        self._distributions = {name: distribution_of(option) for name, option in space.items()}
        self._asked: dict[int, optuna.Trial] = {}
        running = self._trials(optuna.trial.TrialState.RUNNING)
        for trial in running:
            study.enqueue_trial(trial.params)
            study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
        if not study.get_trials(deepcopy=False):
            study.enqueue_trial({name: option.default for name, option in space.items()})

    @property
    def finished(self) -> list[Evaluation]:
        """Trials that have a value or failed, by number."""
        import optuna

        found = self._trials(optuna.trial.TrialState.COMPLETE, optuna.trial.TrialState.FAIL)
        return [
            Evaluation(number=trial.number, options=trial.params, outcome=TrialResult(**trial.user_attrs["outcome"]))
            for trial in found
            if not _abandoned(trial)
        ]

    @property
    def started(self) -> int:
        """Number of trials that are finished or asked for."""
        return len(self.finished) + len(self._asked)

    @property
    def ranking(self) -> list[Evaluation]:
        """Trials that have a finite score, the best one first; of equal options only the first one."""
        finite = [trial for trial in self.finished if math.isfinite(trial.outcome.score)]
        first = {frozenset(trial.options.items()): trial for trial in reversed(finite)}
        return sorted(first.values(), key=lambda trial: (-trial.outcome.score, trial.number))

    def ask(self) -> tuple[int, Options]:
        """The number and the options of the next trial."""
        drawn = sum(not _abandoned(trial) for trial in self._study.get_trials(deepcopy=False))
        self._study.sampler = sampler_at(self._seed, drawn)
        trial = self._study.ask(self._distributions)
        self._asked[trial.number] = trial
        return trial.number, trial.params

    def tell(self, number: int, outcome: TrialResult) -> Evaluation:
        """Keep the outcome of a trial that was asked for."""
        import optuna

        trial = self._asked.pop(number)
        trial.set_user_attr("outcome", asdict(outcome))
        state = optuna.trial.TrialState.FAIL if outcome.error else optuna.trial.TrialState.COMPLETE
        self._study.tell(trial, None if outcome.error else outcome.score, state)
        return Evaluation(number=number, options=trial.params, outcome=outcome)

    def outcome_at(self, options: Options) -> TrialResult | None:
        """What is known of options that were drawn before, as whole numbers may be."""
        same = (trial.outcome for trial in self.finished if trial.options == options)
        return next((replace(outcome, seconds=0.0) for outcome in same), None)

    def importance(self) -> dict[str, float]:
        """Share of each option in what makes trials good (PED-ANOVA), the largest first; empty for too few trials."""
        if len(self.ranking) < IMPORTANCE_TRIALS or len(self._distributions) < 2:
            return {}
        import optuna

        with experimental():
            warnings.simplefilter("ignore", UserWarning)  # all trials are equally good: then so are the options
            evaluator = optuna.importance.PedAnovaImportanceEvaluator()
            return dict(optuna.importance.get_param_importances(self._study, evaluator=evaluator))

    def _trials(self, *states: optuna.trial.TrialState) -> list[optuna.trial.FrozenTrial]:
        return self._study.get_trials(deepcopy=False, states=states)


@contextmanager
def opened_study(
    place: str, name: str, *, problem: Mapping[str, Any], space: Mapping[str, Option], seed: int = 0
) -> Iterator[Study]:
    """The study of a name in a file, begun where there is none.

    place: path of an SQLite file, or the URL of another database that Optuna takes. problem: everything that the values
    depend on; it is kept with the study, as JSON.
    Raises UserError where the file is no study or is not writable, another process works on it, or the study is of
    another problem.
    """
    with extra("search"):
        import optuna
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    problem = json.loads(json.dumps(problem))
    with database(place) as storage:
        study = optuna.create_study(storage=storage, study_name=name, direction="maximize", load_if_exists=True)
        kept = study.user_attrs.get("problem", problem)
        if kept != problem:
            raise UserError(
                f"{place}: study {name} was begun with {study_differences(kept, problem)}; choose another --name for "
                "another study, or repeat its command"
            )
        study.set_user_attr("problem", problem)
        yield Study(study, space, seed)


def _abandoned(trial: optuna.trial.FrozenTrial) -> bool:
    """Whether a trial failed only because its process ended: it has been asked for again, as another trial."""
    return trial.state.name == "FAIL" and "outcome" not in trial.user_attrs

"""A study: what it draws, keeps and refuses, on a function whose minimum is known."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from hybrid_sysid_ros.extensions.search.search import search
from hybrid_sysid_ros.extensions.search.study import Study, opened_study
from hybrid_sysid_ros.extensions.search.tests.branin import (
    MINIMUM,
    SPACE,
    Answer,
    branin,
    broken,
    here,
    picky,
    study_of,
)
from hybrid_sysid_ros.models import Option, Options
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("optuna", reason="needs hybrid_sysid_ros[search]")
pytest.importorskip("joblib", reason="needs hybrid_sysid_ros[search]")


def drawn(study: Study) -> list[tuple[float, float]]:
    """What the trials were drawn at, in the order of their numbers."""
    return [(trial.options["x"], trial.options["y"]) for trial in study.finished]


@pytest.fixture(scope="module")
def sixty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Study]:
    place = str(tmp_path_factory.mktemp("branin") / "search.db")
    with study_of(place) as study:
        search(study, here(branin), trials=60)
        yield study


def test_the_minimum_of_branins_function_is_found(sixty: Study) -> None:
    # So near, to .006 of the area, 60 random trials come in 3 of 10 studies.
    best = sixty.ranking[0]
    assert MINIMUM <= -best.outcome.score < MINIMUM + 0.3
    assert [trial.number for trial in sixty.finished] == list(range(60))


def test_the_first_trial_is_at_the_defaults(sixty: Study) -> None:
    assert sixty.finished[0].options == {"x": 0.0, "y": 5.0}
    assert sixty.finished[0].outcome.parts == {"branin": sixty.finished[0].outcome.score}


def test_the_importance_tells_which_options_matter(monkeypatch, sixty: Study) -> None:
    assert sixty.importance() == {}  # too few trials
    monkeypatch.setattr("hybrid_sysid_ros.extensions.search.study.IMPORTANCE_TRIALS", 60)
    importance = sixty.importance()
    assert set(importance) == {"x", "y"}
    assert sum(importance.values()) == pytest.approx(1.0)


def test_nothing_matters_where_all_trials_are_equally_good(monkeypatch, place: str) -> None:
    monkeypatch.setattr("hybrid_sysid_ros.extensions.search.study.IMPORTANCE_TRIALS", 20)
    with study_of(place) as study:
        search(study, here(lambda options: Answer(1.0)), trials=20)
        assert set(study.importance()) == {"x", "y"}


def test_an_interrupted_study_draws_the_same_trials_as_one_that_was_not(sixty: Study, place: str) -> None:
    with study_of(place) as study:
        search(study, here(branin), trials=13)
    with study_of(place) as study:
        search(study, here(branin), trials=16)
        number, running = study.ask()  # and the process is killed
    with study_of(place) as study:
        assert len(study.finished) == 16
        search(study, here(branin), trials=25)
        assert drawn(study) == drawn(sixty)[:25]
        assert drawn(study)[16] == (running["x"], running["y"])
        assert number not in [trial.number for trial in study.finished]


def test_another_seed_draws_other_trials(sixty: Study, place: str) -> None:
    with study_of(place, seed=1) as study:
        search(study, here(branin), trials=3)
        assert drawn(study)[0] == drawn(sixty)[0]
        assert not set(drawn(study)[1:]) & set(drawn(sixty))


def test_a_study_of_another_problem_is_refused(place: str) -> None:
    with study_of(place, part="0:0.5", records={"a": "1", "b": "2"}) as study:
        search(study, here(branin), trials=2)
    with (
        pytest.raises(UserError, match=r"branin was begun with part 0:0\.5, not 0:1, other records \(b, c\); choose"),
        study_of(place, part="0:1", records={"a": "1", "b": "3", "c": "4"}),
    ):
        pass
    with study_of(place, part="0:0.5", records={"a": "1", "b": "2"}) as study:
        assert len(study.finished) == 2


def test_one_file_keeps_several_studies(place: str) -> None:
    for name in ("first", "second"):
        with opened_study(place, name, problem={"name": name}, space=SPACE) as study:
            search(study, here(branin), trials=2)
            assert len(study.finished) == 2


def test_two_searches_on_one_file_are_refused(place: str) -> None:
    with study_of(place), pytest.raises(UserError, match="another search works on it"), study_of(place):
        pass


@pytest.mark.parametrize("content", ["thesis", ""])
def test_a_file_of_something_else_is_not_a_study(tmp_path: Path, content: str) -> None:
    file = tmp_path / "thesis.tex"
    file.write_text(content * 1000)
    if content:
        with pytest.raises(UserError, match=r"thesis\.tex: is no SQLite file"), study_of(str(file)):
            pass
        assert file.read_text() == content * 1000
    else:
        with study_of(str(file)) as study:  # SQLite takes an empty file for an empty database
            assert study.started == 0


def test_a_place_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for place, words in [(tmp_path, "folder"), (tmp_path / "file" / "search.db", "cannot be written")]:
        with pytest.raises(UserError, match=words), study_of(str(place)):
            pass


def test_a_database_without_driver_is_refused() -> None:
    with pytest.raises(UserError, match="choose another --study"), study_of("firebird://host/search"):
        pass


def test_a_trial_that_fails_is_kept_with_its_message(place: str) -> None:
    with study_of(place) as study:
        search(study, here(picky), trials=20)
        failed = [trial for trial in study.finished if trial.outcome.error]
        assert len(study.finished) == 20
        assert 0 < len(failed) < 20
        assert all(trial.options["x"] > 0 for trial in failed)
        assert {trial.outcome.error for trial in failed} == {"x is positive, which is not allowed"}
        assert not {trial.number for trial in study.ranking} & {trial.number for trial in failed}
    with study_of(place) as study:  # and they are not tried again
        search(study, here(picky), trials=20)
        assert len(study.finished) == 20


def test_a_search_where_everything_fails_is_given_up(place: str) -> None:
    with study_of(place) as study, pytest.raises(UserError, match=r"all 5 trials failed.* nothing works"):
        search(study, here(broken), trials=40)


def test_a_diverged_trial_ranks_nowhere(place: str) -> None:
    def diverging(options: Options) -> Answer:
        return Answer(-math.inf if options["x"] > 0 else -1.0)

    with study_of(place) as study:
        search(study, here(diverging), trials=25)
        assert len(study.finished) == 25
        assert all(trial.options["x"] <= 0 for trial in study.ranking)


def test_options_that_were_drawn_before_are_not_evaluated_again(place: str) -> None:
    evaluated = []

    def objective(options: Options) -> Answer:
        evaluated.append(options["terms"])
        return Answer(float(options["terms"]))

    space = {"terms": Option(default=1, low=0, high=2, kind="int", description="terms")}
    with opened_study(place, "few", problem={}, space=space) as study:
        search(study, here(objective), trials=20)
        assert len(study.finished) == 20
        assert [trial.options["terms"] for trial in study.ranking] == [2, 1, 0]
    assert sorted(evaluated) == [0, 1, 2]


def test_no_trial_begins_after_the_timeout(place: str) -> None:
    with study_of(place) as study:
        search(study, here(branin), trials=5, timeout=0.0)
        assert study.started == 0


def test_options_are_of_their_kind(place: str) -> None:
    space = {
        "units": Option(default=4, low=2, high=12, kind="int", description="units"),
        "weight": Option(default=1.0, low=1e-4, high=1e4, kind="log", description="weight"),
    }
    with opened_study(place, "kinds", problem={}, space=space) as study:
        asked = [study.ask()[1] for _ in range(40)]
    assert all(isinstance(options["units"], int) and 2 <= options["units"] <= 12 for options in asked)
    assert 10 < sum(options["weight"] < 1.0 for options in asked) < 30

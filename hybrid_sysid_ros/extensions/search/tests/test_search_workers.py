"""The workers of a search, processes and a cluster: what is lost is done again, and nothing else."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from hybrid_sysid_ros.extensions.search.search import Evaluate, search, trial_name
from hybrid_sysid_ros.extensions.search.tests.branin import (
    Deadly,
    SlowBranin,
    branin,
    mistaken,
    processes,
    study_of,
    wait_for,
)
from hybrid_sysid_ros.extensions.shared.cluster import Cluster
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("optuna", reason="needs hybrid_sysid_ros[search]")
pytest.importorskip("joblib", reason="needs hybrid_sysid_ros[search]")


@pytest.fixture
def lines() -> list[str]:
    return []


def cluster(objective, address: str, **more) -> Cluster[Any, Any]:
    return Cluster(Evaluate(objective=objective), address, name=trial_name, **more)


def test_processes_work_at_the_same_time(place: str, tmp_path: Path, lines: list[str]) -> None:
    objective = SlowBranin(tmp_path, slow="any")

    def release() -> None:
        wait_for(lambda: len(list(tmp_path.glob("call*"))) == 2)  # both are in a trial
        (tmp_path / "go").touch()

    thread = threading.Thread(target=release)
    thread.start()
    with study_of(place) as study, processes(objective, lines.append, jobs=2) as workers:
        search(study, workers, trials=4)
        assert len(study.finished) == 4
    thread.join()


def kill_the_first(folder: Path) -> threading.Thread:
    """Kill the process that works on the first trial, in the midst of it, and let all others go."""

    def kill() -> None:
        pid = wait_for(lambda: next((p.read_text() for p in folder.glob("call 0 0")), ""))
        os.kill(int(pid), signal.SIGKILL)
        wait_for(lambda: list(folder.glob("call 0 1")))  # it runs again
        (folder / "go").touch()

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_killed_process_loses_no_trial(place: str, tmp_path: Path, lines: list[str]) -> None:
    killer = kill_the_first(tmp_path)
    with study_of(place) as study, processes(SlowBranin(tmp_path, slow="0"), lines.append, jobs=2) as workers:
        search(study, workers, trials=8)
        assert [trial.number for trial in study.finished] == list(range(8))
        assert all(branin(trial.options).value == trial.outcome.score for trial in study.finished)
    killer.join()
    assert lines == ["a worker process was lost; trial 0 runs again"]


@pytest.mark.slow
def test_a_trial_that_kills_its_processes_fails_alone(place: str, lines: list[str]) -> None:
    with study_of(place) as study, processes(Deadly(), lines.append, jobs=2) as workers:
        search(study, workers, trials=6)
        first, *others = study.finished
        assert "lost 3 times" in first.outcome.error
        assert not any(trial.outcome.error for trial in others)
        assert len(others) == 5


def test_a_mistake_of_the_program_is_not_a_failed_trial(place: str, lines: list[str]) -> None:
    with (
        study_of(place) as study,
        processes(mistaken, lines.append, jobs=1) as workers,
        pytest.raises(ZeroDivisionError),
    ):
        search(study, workers, trials=2)


@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("optuna", lambda place: study_of(place).__enter__()),
        ("distributed", lambda place: cluster(branin, "local")),
    ],
)
def test_a_missing_library_is_named_with_the_extra(monkeypatch, place: str, library: str, use) -> None:
    for module in [library, *(name for name in sys.modules if name.startswith(f"{library}."))]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UserError, match=rf"{library}.* is missing; .*hybrid_sysid_ros\[search\]"):
        use(place)


@pytest.mark.parametrize("jobs", [-3, -2])
def test_a_number_of_processes_that_is_none_is_refused(jobs: int) -> None:
    with pytest.raises(UserError, match=f"--jobs {jobs}"):
        processes(branin, print, jobs)


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_no_trial(place: str, tmp_path: Path, lines: list[str]) -> None:
    pytest.importorskip("distributed", reason="needs hybrid_sysid_ros[search]")
    killer = kill_the_first(tmp_path)
    with (
        study_of(place) as study,
        cluster(SlowBranin(tmp_path, slow="0"), "local", tell=lines.append, jobs=2) as workers,
    ):
        assert workers.size == 2
        search(study, workers, trials=8)
        assert [trial.number for trial in study.finished] == list(range(8))
        assert not any(trial.outcome.error for trial in study.finished)
    killer.join()
    assert any("was lost" in line for line in lines)
    processes = {file.read_text() for file in tmp_path.glob("call*")}
    assert len(processes) >= 2


def test_a_cluster_that_is_not_there_gets_one_line() -> None:
    pytest.importorskip("distributed", reason="needs hybrid_sysid_ros[search]")
    with pytest.raises(UserError, match=r"--cluster tcp://127\.0\.0\.1:9: no scheduler"):
        cluster(branin, "tcp://127.0.0.1:9", patience=0.5)
    with pytest.raises(UserError, match="--cluster banana://"):
        cluster(branin, "banana://", patience=0.5)

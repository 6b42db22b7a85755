"""The search: its study, its workers and its command, on a function whose minimum is known and on the beam."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import typer

from hybrid_sysid_ros import search_command
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.models import Option, Options, load
from hybrid_sysid_ros.search import Cluster, CrossValidation, Outcome, Processes, Study, Workers, opened, search
from hybrid_sysid_ros.search.evaluation import evaluate

pytest.importorskip("optuna", reason="needs hybrid_sysid_ros[search]")
pytest.importorskip("joblib", reason="needs hybrid_sysid_ros[search]")

MINIMUM = 0.397887
"""Of Branin's function: Dixon and Szegoe (1978), Towards Global Optimisation 2; at (-pi, 12.275) and two more."""

SPACE = {
    "x": Option(default=0.0, low=-5.0, high=10.0, kind="float", description="first"),
    "y": Option(default=5.0, low=0.0, high=15.0, kind="float", description="second"),
}
BAGS = [Path(__file__).parents[1] / "bags" / name for name in ("beam_multisine", "beam_random_steps")]


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
class Watched:
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


class OfBranin(CrossValidation):
    """Branin's function in the place of what the command maximises; FOLDER and SLOW are its files, see Watched."""

    space = SPACE

    def __post_init__(self) -> None: ...

    def __call__(self, options: Options) -> Answer:  # type: ignore[override]
        return Watched(Path(os.environ["FOLDER"]), os.environ.get("SLOW", ""))(options)


class Here(Workers):
    """Evaluates at once, in this process."""

    size = 1

    def _submit(self, options: Options):
        from concurrent.futures import Future

        future: Future[Outcome] = Future()
        future.set_result(evaluate(self.objective, options))
        return future

    def _outcome(self, future):
        return future.result()

    def close(self) -> None: ...


@pytest.fixture
def place(tmp_path: Path) -> str:
    return str(tmp_path / "deep" / "search.db")


@pytest.fixture
def lines() -> list[str]:
    return []


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]):
    """Run the command; give status, standard output and standard error."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(search_command.search_command)

    def run(*arguments: object) -> tuple[int, str, str]:
        status = app([str(argument) for argument in arguments], standalone_mode=False)
        captured = capsys.readouterr()
        return int(status or 0), captured.out, captured.err

    return run


def study_of(place: str, seed: int = 0, **problem: object):
    return opened(place, "branin", problem={"function": "branin", **problem}, space=SPACE, seed=seed)


def drawn(study: Study) -> list[tuple[float, float]]:
    """What the trials were drawn at, in the order of their numbers."""
    return [(trial.options["x"], trial.options["y"]) for trial in study.finished]


def wait_for(found, seconds: float = 15.0):
    """The first true value of a function."""
    deadline = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)
    return value


@pytest.fixture(scope="module")
def sixty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Study]:
    place = str(tmp_path_factory.mktemp("branin") / "search.db")
    with study_of(place) as study:
        search(study, Here(branin, print), trials=60)
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
    monkeypatch.setattr("hybrid_sysid_ros.search.study.IMPORTANCE_TRIALS", 60)
    importance = sixty.importance()
    assert set(importance) == {"x", "y"}
    assert sum(importance.values()) == pytest.approx(1.0)


def test_nothing_matters_where_all_trials_are_equally_good(monkeypatch, place: str) -> None:
    monkeypatch.setattr("hybrid_sysid_ros.search.study.IMPORTANCE_TRIALS", 20)
    with study_of(place) as study:
        search(study, Here(lambda options: Answer(1.0), print), trials=20)
        assert set(study.importance()) == {"x", "y"}


def test_an_interrupted_study_draws_the_same_trials_as_one_that_was_not(sixty: Study, place: str) -> None:
    with study_of(place) as study:
        search(study, Here(branin, print), trials=13)
    with study_of(place) as study:
        search(study, Here(branin, print), trials=16)
        number, running = study.ask()  # and the process is killed
    with study_of(place) as study:
        assert len(study.finished) == 16
        search(study, Here(branin, print), trials=25)
        assert drawn(study) == drawn(sixty)[:25]
        assert drawn(study)[16] == (running["x"], running["y"])
        assert number not in [trial.number for trial in study.finished]


def test_another_seed_draws_other_trials(sixty: Study, place: str) -> None:
    with study_of(place, seed=1) as study:
        search(study, Here(branin, print), trials=3)
        assert drawn(study)[0] == drawn(sixty)[0]
        assert not set(drawn(study)[1:]) & set(drawn(sixty))


def test_a_study_of_another_problem_is_refused(place: str) -> None:
    with study_of(place, part="0:0.5", records={"a": "1", "b": "2"}) as study:
        search(study, Here(branin, print), trials=2)
    with (
        pytest.raises(UserError, match=r"branin was begun with part 0:0\.5, not 0:1, other records \(b, c\); choose"),
        study_of(place, part="0:1", records={"a": "1", "b": "3", "c": "4"}),
    ):
        pass
    with study_of(place, part="0:0.5", records={"a": "1", "b": "2"}) as study:
        assert len(study.finished) == 2


def test_one_file_keeps_several_studies(place: str) -> None:
    for name in ("first", "second"):
        with opened(place, name, problem={"name": name}, space=SPACE) as study:
            search(study, Here(branin, print), trials=2)
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
            assert study.begun == 0


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
        search(study, Here(picky, print), trials=20)
        failed = [trial for trial in study.finished if trial.outcome.error]
        assert len(study.finished) == 20
        assert 0 < len(failed) < 20
        assert all(trial.options["x"] > 0 for trial in failed)
        assert {trial.outcome.error for trial in failed} == {"x is positive, which is not allowed"}
        assert not {trial.number for trial in study.ranking} & {trial.number for trial in failed}
    with study_of(place) as study:  # and they are not tried again
        search(study, Here(picky, print), trials=20)
        assert len(study.finished) == 20


def test_a_search_where_everything_fails_is_given_up(place: str) -> None:
    with study_of(place) as study, pytest.raises(UserError, match=r"all 5 trials failed.* nothing works"):
        search(study, Here(broken, print), trials=40)


def test_a_diverged_trial_ranks_nowhere(place: str) -> None:
    def diverging(options: Options) -> Answer:
        return Answer(-math.inf if options["x"] > 0 else -1.0)

    with study_of(place) as study:
        search(study, Here(diverging, print), trials=25)
        assert len(study.finished) == 25
        assert all(trial.options["x"] <= 0 for trial in study.ranking)


def test_options_that_were_drawn_before_are_not_evaluated_again(place: str) -> None:
    evaluated = []

    def objective(options: Options) -> Answer:
        evaluated.append(options["terms"])
        return Answer(float(options["terms"]))

    space = {"terms": Option(default=1, low=0, high=2, kind="int", description="terms")}
    with opened(place, "few", problem={}, space=space) as study:
        search(study, Here(objective, print), trials=20)
        assert len(study.finished) == 20
        assert [trial.options["terms"] for trial in study.ranking] == [2, 1, 0]
    assert sorted(evaluated) == [0, 1, 2]


def test_no_trial_begins_after_the_timeout(place: str) -> None:
    with study_of(place) as study:
        search(study, Here(branin, print), trials=5, timeout=0.0)
        assert study.begun == 0


def test_options_are_of_their_kind(place: str) -> None:
    space = {
        "units": Option(default=4, low=2, high=12, kind="int", description="units"),
        "weight": Option(default=1.0, low=1e-4, high=1e4, kind="log", description="weight"),
    }
    with opened(place, "kinds", problem={}, space=space) as study:
        asked = [study.ask()[1] for _ in range(40)]
    assert all(isinstance(options["units"], int) and 2 <= options["units"] <= 12 for options in asked)
    assert 10 < sum(options["weight"] < 1.0 for options in asked) < 30


def test_processes_work_at_the_same_time(place: str, tmp_path: Path, lines: list[str]) -> None:
    objective = Watched(tmp_path, slow="any")

    def release() -> None:
        wait_for(lambda: len(list(tmp_path.glob("call*"))) == 2)  # both are in a trial
        (tmp_path / "go").touch()

    thread = threading.Thread(target=release)
    thread.start()
    with study_of(place) as study, Processes(objective, lines.append, jobs=2) as workers:
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


def test_a_killed_process_loses_no_trial(place: str, tmp_path: Path, lines: list[str]) -> None:
    killer = kill_the_first(tmp_path)
    with study_of(place) as study, Processes(Watched(tmp_path, slow="0"), lines.append, jobs=2) as workers:
        search(study, workers, trials=8)
        assert [trial.number for trial in study.finished] == list(range(8))
        assert all(branin(trial.options).value == trial.outcome.score for trial in study.finished)
    killer.join()
    assert lines == ["a worker process was lost; trial 0 runs again"]


def test_a_trial_that_kills_its_processes_fails_alone(place: str, lines: list[str]) -> None:
    with study_of(place) as study, Processes(Deadly(), lines.append, jobs=2) as workers:
        search(study, workers, trials=6)
        first, *others = study.finished
        assert "lost 3 times" in first.outcome.error
        assert not any(trial.outcome.error for trial in others)
        assert len(others) == 5


def test_a_mistake_of_the_program_is_not_a_failed_trial(place: str, lines: list[str]) -> None:
    with (
        study_of(place) as study,
        Processes(mistaken, lines.append, jobs=1) as workers,
        pytest.raises(ZeroDivisionError),
    ):
        search(study, workers, trials=2)


@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("optuna", lambda place: study_of(place).__enter__()),
        ("joblib", lambda place: Processes(branin, print)),
        ("distributed", lambda place: Cluster(branin, print, "local")),
    ],
)
def test_a_missing_library_is_named_with_the_extra(monkeypatch, place: str, library: str, use) -> None:
    for module in [library, *(name for name in sys.modules if name.startswith(f"{library}."))]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UserError, match=rf"{library}.* is missing; .*hybrid_sysid_ros\[search\]"):
        use(place)


@pytest.mark.parametrize("jobs", [0, -2])
def test_a_number_of_processes_that_is_none_is_refused(jobs: int) -> None:
    with pytest.raises(UserError, match=f"--jobs {jobs}"):
        Processes(branin, print, jobs=jobs)


def test_a_killed_worker_of_a_cluster_loses_no_trial(place: str, tmp_path: Path, lines: list[str]) -> None:
    pytest.importorskip("distributed", reason="needs hybrid_sysid_ros[search]")
    killer = kill_the_first(tmp_path)
    with study_of(place) as study, Cluster(Watched(tmp_path, slow="0"), lines.append, "local", jobs=2) as workers:
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
        Cluster(branin, print, "tcp://127.0.0.1:9", patience=0.5)
    with pytest.raises(UserError, match="--cluster banana://"):
        Cluster(branin, print, "banana://", patience=0.5)


def test_the_command_searches_and_fits_the_best(command, tmp_path: Path) -> None:
    arguments = (*BAGS, "--structure", "linear", "--folds", 2, "--study", tmp_path / "search.db", "--jobs", 1)
    status, out, error = command(*arguments, "--part", "0:0.2", "--trials", 3, "--out", tmp_path / "model")
    assert status == 0
    assert "0, defaults" in out
    assert "3 of 3" in error
    model = load(tmp_path / "model")
    assert model.structure == "linear"
    assert [record["part"] for record in model.records] == [[0.0, 0.2]] * 2
    best = " ".join(f"{name}={value:.6g}" for name, value in model.fit["options"].items() if name != "starts")
    assert f"3 trials; best: {best}" in " ".join(out.split())
    with pytest.raises(UserError, match=r"begun with part 0:0\.2, not 0:1"):
        command(*arguments)


def test_an_unknown_structure_is_refused(command, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"banana.*choose one of .*hybrid"):
        command(*BAGS, "--study", tmp_path / "search.db", "--structure", "banana")
    assert not list(tmp_path.iterdir())


def test_the_same_records_are_the_same_problem_wherever_they_lie(monkeypatch, command, tmp_path: Path) -> None:
    monkeypatch.setattr(search_command, "CrossValidation", OfBranin)
    monkeypatch.setenv("FOLDER", str(tmp_path))
    moved = tmp_path / "moved" / BAGS[0].name
    shutil.copytree(BAGS[0], moved)
    arguments = ("--study", tmp_path / "search.db", "--trials", 2, "--jobs", 1)
    assert command(BAGS[0], *arguments)[0] == 0
    assert "trials: 2 of 2" in command(moved, *arguments)[2]
    with pytest.raises(UserError, match=r"other records \(beam_multisine, beam_random_steps\)"):
        command(BAGS[1], *arguments)


INTERRUPTED = """
import typer
from hybrid_sysid_ros import search_command
from test_search import OfBranin
search_command.CrossValidation = OfBranin
typer.run(search_command.search_command)
"""


@pytest.mark.parametrize("where", [[], ["--cluster", "local"]], ids=["processes", "cluster"])
def test_an_interrupted_command_keeps_its_trials_and_says_how_to_go_on(
    monkeypatch, command, tmp_path: Path, where: list[str]
) -> None:
    arguments = [*BAGS, "--study", tmp_path / "search.db", "--trials", "6", "--jobs", "2", *where]
    monkeypatch.setenv("FOLDER", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, *map(str, arguments)],
        env={**os.environ, "SLOW": "0"},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        wait_for(lambda: len(list(tmp_path.glob("call*"))) == 6, 60.0)  # all but the first one are finished, or nearly
        os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: the workers get it too
        error = process.communicate(timeout=60.0)[1]
    assert process.returncode == 130
    lines = error.strip().splitlines()
    assert re.fullmatch(
        r"interrupted: [45] of 6 trials are in .*search\.db; the same command goes on from there", lines[-1]
    )
    assert "Traceback" not in error
    worker = int(next(tmp_path.glob("call 0 0")).read_text())
    with pytest.raises(ProcessLookupError):
        wait_for(lambda: os.kill(worker, 0))
    monkeypatch.setattr(search_command, "CrossValidation", OfBranin)
    status, out, error = command(*arguments)
    assert status == 0
    assert "6 trials" in out
    assert len(list(tmp_path.glob("call 0 *"))) == 2

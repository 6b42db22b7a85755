"""hybrid-sysid search: on the beam, and on a function that leaves a file for each call."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import typer

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.search.commands import search as search_command
from hybrid_sysid_ros.extensions.search.tests.branin import OfBranin, wait_for
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import PLACES, refused_place

pytest.importorskip("optuna", reason="needs hybrid_sysid_ros[search]")
pytest.importorskip("joblib", reason="needs hybrid_sysid_ros[search]")

BAGS = [Path(__file__).parents[4] / "bags" / name for name in ("beam_multisine", "beam_random_steps")]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]):
    """Run the command; give status, standard output and standard error."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(search_command.command)

    def run(*arguments: object) -> tuple[int, str, str]:
        status = app([str(argument) for argument in arguments], standalone_mode=False)
        captured = capsys.readouterr()
        return int(status or 0), captured.out, captured.err

    return run


@pytest.mark.slow
def test_the_command_searches_and_fits_the_best(command, tmp_path: Path) -> None:
    arguments = (*BAGS, "--structure", "linear", "--folds", 2, "--study", tmp_path / "search.db", "--jobs", 1)
    status, out, error = command(*arguments, "--part", "0:0.2", "--trials", 3, "--out", tmp_path / "model")
    assert status == 0
    assert "0, defaults" in out
    assert "3 of 3" in error
    model = load(tmp_path / "model")
    assert model.structure == "linear"
    assert [record["part"] for record in model.records] == [[0.0, 0.2]] * 2
    searched = {name for name, option in model.kind.options.items() if option.searched}
    best = " ".join(f"{name}={value:.6g}" for name, value in model.fit["options"].items() if name in searched)
    assert f"3 trials; best: {best}" in " ".join(out.split())
    found = json.loads(command(*arguments, "--part", "0:0.2", "--trials", 3, "--json")[1])
    assert [trial["r2"] for trial in found["trials"]] == sorted((t["r2"] for t in found["trials"]), reverse=True)
    assert len(found["trials"]) + len(found["failed"]) == 3
    with pytest.raises(UserError, match=r"begun with part 0:0\.2, not 0:1"):
        command(*arguments)


@PLACES
def test_it_says_where_it_cannot_write_before_anything_else(call, tmp_path: Path, monkeypatch, place: str) -> None:
    command = partial(call, app.main, "hybrid-sysid")
    refused_place(command, tmp_path, place, ("search", "nowhere", "--out", "PLACE"), monkeypatch)


def test_an_unknown_structure_is_refused(command, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"banana.*choose one of .*hybrid"):
        command(*BAGS, "--study", tmp_path / "search.db", "--structure", "banana")
    assert not list(tmp_path.iterdir())


def test_where_every_trial_fails_the_reason_is_reported(command, tmp_path: Path) -> None:
    """None of the options helps a record that is too short for its parts."""
    arguments = ("--structure", "linear", "--part", "0:0.02", "--trials", 2, "--jobs", 1)
    reason = r"none of its 2 trials gave a model; the last one: .*beam_multisine.*too short"
    with pytest.raises(UserError, match=reason) as raised:
        command(BAGS[0], "--study", tmp_path / "search.db", *arguments)
    assert "--trials" not in str(raised.value)


def test_a_search_without_a_trial_says_so(monkeypatch, command, tmp_path: Path) -> None:
    monkeypatch.setattr(search_command, "Objective", OfBranin)
    monkeypatch.setenv("FOLDER", str(tmp_path))
    with pytest.raises(UserError, match="no trial is finished; give a longer --timeout"):
        command(BAGS[0], "--study", tmp_path / "search.db", "--timeout", "1e-9", "--jobs", 1)


def test_the_same_records_are_the_same_problem_wherever_they_lie(monkeypatch, command, tmp_path: Path) -> None:
    monkeypatch.setattr(search_command, "Objective", OfBranin)
    monkeypatch.setenv("FOLDER", str(tmp_path))
    moved = tmp_path / "moved" / BAGS[0].name
    shutil.copytree(BAGS[0], moved)
    arguments = ("--study", tmp_path / "search.db", "--trials", 2, "--jobs", 1)
    assert command(BAGS[0], *arguments)[0] == 0
    assert "trials: 2 of 2" in command(moved, *arguments)[2]
    with pytest.raises(UserError, match=r"other records \(beam_multisine, beam_random_steps\)"):
        command(BAGS[1], *arguments)


INTERRUPTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background jobs inherit as ignored
from hybrid_sysid_ros import __main__
from hybrid_sysid_ros.extensions.search.commands import search as search_command
from hybrid_sysid_ros.extensions.search.tests.branin import OfBranin
search_command.Objective = OfBranin
__main__.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "where",
    [pytest.param([], id="processes"), pytest.param(["--cluster", "local"], id="cluster")],
)
def test_an_interrupted_command_keeps_its_trials_and_says_how_to_go_on(
    monkeypatch, command, tmp_path: Path, where: list[str]
) -> None:
    arguments = [*BAGS, "--study", tmp_path / "search.db", "--trials", "6", "--jobs", "2", *where]
    monkeypatch.setenv("FOLDER", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, "search", *map(str, arguments)],
        env={**os.environ, "SLOW": "0"},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_for(lambda: len(list(tmp_path.glob("call*"))) == 6, 60.0)  # all but the first one are finished, or nearly
        os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: the workers get it too
        error = process.communicate(timeout=60.0)[1]
    finally:
        process.kill()  # where it did not end by itself
    assert process.returncode == 130
    lines = error.strip().splitlines()
    assert re.fullmatch(
        r"interrupted: [45] of 6 trials are in .*search\.db; the same command goes on from there", lines[-1]
    )
    assert "Traceback" not in error
    worker = int(next(tmp_path.glob("call 0 0")).read_text())
    with pytest.raises(ProcessLookupError):
        wait_for(lambda: os.kill(worker, 0))
    monkeypatch.setattr(search_command, "Objective", OfBranin)
    status, out, error = command(*arguments)
    assert status == 0
    assert "6 trials" in out
    assert len(list(tmp_path.glob("call 0 *"))) == 2

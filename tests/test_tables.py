"""Tables of the command line: a narrow terminal or a pipe cuts no name and no number."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rich.table import Table

from hybrid_sysid_ros.commands.score_table import score_table
from hybrid_sysid_ros.commands.terminal import console, print_table

NAMES = ["2026-11-21_random_steps_with_a_long_name_and_a_number_0000017", "run[red]", "a:smile:b", "[/bold]"]
SCORES = {"r2": 0.98765, "rmse": 0.01, "fit_percent": 88.9}


@pytest.fixture(params=["40", "80", "200"])
def width(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", request.param)
    return request.param


def test_names_and_numbers_are_whole_whatever_the_terminal_s_width(rig, width, capsys) -> None:
    scores = dict.fromkeys(NAMES, SCORES)
    print_table(score_table(scores, rig, "free run", dict.fromkeys(NAMES, SCORES)))
    title, *lines = capsys.readouterr().out.splitlines()
    assert title == "free run"
    assert len({len(line) for line in lines}) == 1  # the table's frame
    for name in NAMES:
        (row,) = (line for line in lines if f" {name} " in line)
        assert row.count("0.9877") == 2


def test_a_long_title_and_a_long_name_beside_many_columns_are_whole(width, capsys) -> None:
    table = Table(*(f"column_{number}_{'x' * 255}" for number in range(20)), title=f"policy {'/deep' * 100}")
    print_table(table)
    out = capsys.readouterr().out
    assert f"policy {'/deep' * 100}\n" in out
    assert all(f"column_{number}_{'x' * 255}" in out for number in range(20))


@pytest.mark.parametrize("name", NAMES)
def test_a_path_is_printed_as_it_is(name, width, capsys) -> None:
    console.print(f"/a/long/path/to/{name}: gray from 1 records")
    assert capsys.readouterr().out == f"/a/long/path/to/{name}: gray from 1 records\n"


def test_a_command_that_is_piped_prints_whole_names(tmp_path: Path) -> None:
    name = "beam_multisine_" + "1234567890" * 6
    shipped = Path(__file__).parents[1] / "bags" / "beam_multisine"
    shutil.copytree(shipped, tmp_path / name)
    command = [sys.executable, "-m", "hybrid_sysid_ros", "identify", str(tmp_path / name), "--out", str(tmp_path / "m")]
    end = subprocess.run(
        [*command, "--structure", "linear", "--part", "0:0.2"],
        env={**os.environ, "COLUMNS": "40"},
        capture_output=True,
        text=True,
        check=True,
    )
    (row,) = (line for line in end.stdout.splitlines() if name in line)
    assert len(row.split("│")) == 6

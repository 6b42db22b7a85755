"""The end of a run: six lines with a judgement of the machine, the same on a terminal and in a report."""

from __future__ import annotations

import io
import json

import pytest
from rich.console import Console
from rich.table import Table

from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.run import Run, RunResult

RIG = rigs.load("cam_beam")


def diagnostics(missed: int = 6, **controller: int):
    plant: dict[str, float] = {"measurements": 12068, "missed_commands": missed, "command_timeouts": 0}
    plant |= {f"delay_ms_{key}": value for key, value in (("p50", 1.3), ("p99", 2.2), ("max", 8.5))}
    return {"plant": plant, "controller": {"layer_exact": 60, "layer_policy": 11940, "layer_held": 0, **controller}}


def test_a_run_ends_in_six_lines():
    lines = RunSummary.of(diagnostics(), RIG).lines
    assert list(lines) == ["tracking", "delay", "missed", "layers", "failsafe", "bag"]
    assert lines["delay"] == "1.30 / 2.20 / 8.50 ms (median, 99 %, longest)"
    assert lines["missed"] == "6 of 12068 commands: this machine is fast enough (0.05 % missed)"
    assert lines["layers"] == "policy 99.5 %, exact 0.5 %"
    assert (lines["failsafe"], lines["bag"]) == ("never", "none")


def test_layers_name_the_most_frequent_rejection():
    """Waiting for good answers is what follows one."""
    checks = {"check_accepted": 90, "check_not_feasible": 1, "check_costlier_than_the_shifted_plan": 4}
    found = RunSummary.of(diagnostics(**checks, check_waiting_for_good_answers=5), RIG)
    assert found.lines["layers"] == "policy 99.5 %, exact 0.5 %; worst check: costlier than the shifted plan, 4 %"
    assert found.content["rejections"] == {"costlier than the shifted plan": 0.04, "not feasible": 0.01}


@pytest.mark.parametrize(("missed", "enough"), [(0, True), (120, True), (121, False), (12068, False)])
def test_a_machine_that_misses_more_than_one_command_in_a_hundred_is_too_slow(missed, enough):
    summary = RunSummary.of(diagnostics(missed), RIG)
    assert summary.fast_enough is enough
    assert ("missed" in summary.alarms) == (enough is False)
    assert ("TOO SLOW" in summary.lines["missed"]) is not enough
    assert RunSummary.of(diagnostics(missed), RIG, lockstep=True).fast_enough is None


def test_the_failsafe_line_counts_what_the_loop_did_instead_of_driving():
    found = diagnostics(times_driving=3, times_slowed=2, times_holding=1, times_resting=0)
    found["plant"]["command_timeouts"] = 4
    summary = RunSummary.of(found, RIG)
    assert summary.lines["failsafe"] == "slowed 2 times, holding 1 time, at rest for want of commands 4 times"
    assert summary.content["failsafe"] == {"slowed": 2, "holding": 1, "at rest for want of commands": 4}


def test_what_a_controller_counts_is_said_to_be_of_the_last_one():
    lines = RunSummary.of(diagnostics(restarts=2), RIG).lines
    assert lines["layers"].endswith("(since its last restart, of 2)")
    assert lines["failsafe"] == "never (since its last restart, of 2)"


@pytest.mark.parametrize(("share", "words"), [(0.021, "follows"), (0.9, "does NOT follow"), (None, "(RMSE)")])
def test_tracking_is_judged_by_the_movement_of_the_reference(share, words):
    line = RunSummary(missed=0, measurements=1, tracking={"whole_run": "0.1 V"}, share=share).lines["tracking"]
    assert line.startswith("whole run 0.1 V (RMSE)")
    assert words in line


def test_a_run_without_a_measurement_is_not_judged(tmp_path):
    summary = RunSummary.of({}, RIG, bag=tmp_path / "nowhere")
    assert summary.fast_enough is None
    assert "nothing was measured" in summary.lines["missed"]
    assert summary.lines["tracking"].startswith("not judged: ")


def test_run_prints_six_lines_or_everything(command, monkeypatch):
    monkeypatch.setattr(Run, "go", lambda _: RunResult(diagnostics=diagnostics(), interrupted=False, bag=None))
    status, out, _ = command("run")
    assert status == 0
    assert [line.split()[0] for line in out.splitlines()] == [*RunSummary.of({}, RIG).lines]
    assert "delay_ms_p50" in command("run", "--verbose")[1]
    content = json.loads(command("run", "--json")[1])
    assert content["fast_enough"] is True
    assert content["diagnostics"] == diagnostics()


def test_tables_and_lines_fold_to_a_terminal_and_nothing_is_cut(monkeypatch):
    written = io.StringIO()
    screen = Console(file=written, force_terminal=True, width=80, color_system=None, **terminal.PLAIN)
    monkeypatch.setattr(terminal, "console", screen)
    monkeypatch.setattr(terminal, "PipedConsole", lambda **_: screen)
    name = "/a_namespace/" + 80 * "x"
    table = Table("name", "words", title="folded")
    table.add_row(name, 40 * "word ")
    terminal.print_table(table)
    terminal.print_lines({"missed": 30 * "word ", "bag": "out"})
    text = written.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert text.count("word") == 71
    assert text.count("x") == 80

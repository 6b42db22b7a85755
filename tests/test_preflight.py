"""What is wrong with a loop is reported before anything of it is started, all at once, each with its place."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hybrid_sysid_ros.commands import rig_new
from hybrid_sysid_ros.commands.app import main
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import parameters, preflight, run
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserErrors


def problems(rig: str = "cam_beam", **asked: Any) -> tuple[str, ...]:
    try:
        preflight.check(load(rig), Run(rig=rig, **asked).values)
    except UserErrors as error:
        return error.lines
    return ()


@pytest.mark.parametrize("rig", ["cam_beam", "winged_cone"])
@pytest.mark.parametrize("lockstep", [False, True])
def test_a_rig_as_it_comes_has_no_problems(rig: str, lockstep: bool) -> None:
    assert problems(rig, lockstep=lockstep) == ()


def test_a_preview_shorter_than_the_horizon_is_reported_beside_the_rule_that_the_period_breaks() -> None:
    rule, preview = problems(policy="exact", lockstep=True, parameters={"controller": {"horizon": 20, "period": 0.05}})
    assert "stale_after" in rule
    assert preview.startswith(f"{load('cam_beam').file}: nodes.reference.preview_seconds is 0.5 s")


def test_each_value_that_is_wrong_is_reported_by_its_node_and_name(tmp_path: Path) -> None:
    given = {"controller": {"horizon": 2000, "speed": 1.0}, "plant": {"bias": 100.0}, "estimator": {"latency": 0.002}}
    found = problems(rate=300.0, reference="sinus", parameters=given)
    for words in ("controller: parameter horizon", "controller: unknown parameter speed", "plant: parameter bias"):
        assert sum(words in line for line in found) == 1
    folders = problems(model=tmp_path / "model", policy_path=tmp_path / "policy", rate=300.0, reference="sinus")
    for words in ("300 Hz", "'sinus'", str(tmp_path / "model"), str(tmp_path / "policy")):
        assert sum(words in line for line in folders) == 1


def test_estimator_and_controller_count_on_the_same_latency_and_rate() -> None:
    latency, rate = problems(policy="exact", parameters={"estimator": {"latency": 0.002, "rate": 100.0}})
    assert "estimator: parameter latency is 0.002 s" in latency
    assert "estimator: parameter rate is 100 Hz" in rate


def test_nothing_is_started_where_something_is_wrong(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delattr(run, "Session")
    with pytest.raises(UserErrors, match="kind is 'sinus'"):
        Run(reference="sinus", bag=tmp_path / "bag").go()
    assert not list(tmp_path.iterdir())


def test_the_command_says_each_problem_in_a_line(call: Any) -> None:
    status, _, said = call(main, "hybrid-sysid", "run", "--reference", "sinus", "--rate", "300")
    assert status == 2
    assert [line.startswith("error: ") for line in said.splitlines()] == [True, True]


@pytest.fixture
def slow(tmp_path: Path) -> Callable[[str], Path]:
    """A new rig with steps of 10 ms and a controller of 2.5 s, of which nothing else is written but what is given."""

    def made(more: str = "") -> Path:
        folder = tmp_path / "sled"
        rig_new.command(folder)
        file = folder / "rig.yaml"
        text = file.read_text().replace("controller: {", "controller: {horizon: 25, period: 0.1, ")
        file.write_text(re.sub(r"^step: \S+", "step: 0.01", text, flags=re.MULTILINE) + more)
        return folder

    return made


def test_defaults_follow_what_the_rig_writes(slow: Any) -> None:
    """The preview the horizon, rates the steps, and the times of the ladder the period."""
    rig = load(str(slow()))
    assert preflight.of_rig(rig) == []
    defaults = {node: parameters.defaults(rig, node) for node in ("plant", "estimator", "reference", "controller")}
    assert defaults["plant"]["rate"] == defaults["estimator"]["rate"] == 100.0
    assert 2.5 + 0.05 <= defaults["reference"]["preview_seconds"] < 2.7
    assert [defaults["controller"][name] for name in ("stale_after", "zero_after")] == pytest.approx([0.25, 1.0])


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("mpc: {riccati_at: [0.0, 0.0]}", "mpc: riccati_at has 2 numbers: it needs one for each output, 1"),
        ("mpc: {stage_parameters: {wall: 1.0}}", "mpc: stage_parameters names 'wall', which no term has"),
    ],
)
def test_what_the_mpc_would_refuse_is_said_once_with_its_file(slow: Any, section: str, words: str) -> None:
    rig = load(str(slow(f"\n{section}\n")))
    (line,) = preflight.of_rig(rig)
    assert line.startswith(f"{rig.file}: {words}")

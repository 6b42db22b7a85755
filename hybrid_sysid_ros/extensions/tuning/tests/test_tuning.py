"""Tuning a rig's loop: the front, what is kept, and the command on the beam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hybrid_sysid_ros.extensions.tuning.front import TuningTrial, best_of, front_of, opened_trials
from hybrid_sysid_ros.extensions.tuning.loops import HORIZON, MORE_UNSEEN, Loops, Measures
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import defaults, shipped
from hybrid_sysid_ros.runtime.parameters import of_file
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused

pytest.importorskip("optuna", reason="needs hybrid_sysid_ros[search]")
pytest.importorskip("joblib", reason="needs hybrid_sysid_ros[search]")


def trial(number: int, settling: float, effort: float, inside: float = 1.0) -> TuningTrial:
    return TuningTrial(number=number, options={}, measures=Measures(settling=settling, effort=effort, inside=inside))


SHIPS = trial(0, 0.3, 0.2)
TRIALS = [
    SHIPS,
    trial(1, 0.2, 0.3),
    trial(2, 0.25, 0.19),
    trial(3, 0.3, 0.1),
    trial(4, 0.4, 0.1),
    trial(5, 0.1, 0.1, 0.5),
]


def test_the_front_has_what_no_other_trial_beats():
    assert [item.number for item in front_of(TRIALS[:5])] == [1, 2, 3]


def test_the_best_by_an_aim_is_no_worse_in_the_rest():
    assert [best_of(TRIALS, aim).number for aim in ("settling", "effort", "bounds")] == [2, 3, 1]
    assert best_of([SHIPS, trial(1, 0.1, 0.5)], "settling") is SHIPS


@pytest.fixture(scope="module")
def loops() -> Loops:
    rig = load_rig("cam_beam")
    return Loops(rig=rig, model=load_model(shipped(rig.name, "model")), seed=0, count=2, horizons=1.0)


def test_options_are_factors_of_what_ships_and_the_horizon(loops):
    own, space = defaults(loops.rig, "controller"), loops.space
    assert "controller.input_weight" not in space  # it ships as 0, of which no factor makes anything else
    found = loops.values({"controller.rate_weight": 2.0, HORIZON: 15})
    assert found["controller"] == {"rate_weight": [2.0 * item for item in own["rate_weight"]], "horizon": 15}


def test_the_horizon_stays_where_the_file_has_intervals_for_it(loops):
    assert HORIZON in loops.space
    held = {"intervals": [1] * defaults(loops.rig, "controller")["horizon"]}
    rig = replace(loops.rig, content={**loops.rig.content, "mpc": held})
    assert loops.space.keys() - replace(loops, rig=rig).space.keys() == {HORIZON}


def test_references_of_several_outputs_have_a_centre_each(loops):
    rig = load_rig("flexible_joint")
    spread = replace(loops, rig=rig, model=load_model(shipped(rig.name, "model"))).spread
    assert len(spread.centre) == len(spread.amplitude) == len(rig.sensors)


def test_loops_repeat_and_unseen_ones_are_others(loops):
    ships = {name: option.default for name, option in loops.space.items()}
    (first, rows), (again, _), (_, others) = (loops.measures(ships, unseen=unseen) for unseen in (False, False, True))
    assert first == again
    assert len(others) == MORE_UNSEEN * len(rows)
    assert not np.isin(rows, others).any()


def test_trials_go_on_where_they_were_and_other_problems_are_refused(loops, tmp_path: Path):
    place, drawn = str(tmp_path / "tune.db"), []
    for _ in range(2):
        with opened_trials(place, "beam", {"loops": 2}, loops.space, 0) as kept:
            for _ in range(2):
                asked = kept.ask()
                drawn.append(asked.params)
                kept.tell(asked, Measures(settling=1.0 + len(drawn), effort=1.0, inside=1.0))
            kept.ask()  # and the process is killed
    assert drawn[0] == {name: option.default for name, option in loops.space.items()}
    with opened_trials(place, "beam", {"loops": 2}, loops.space, 0) as kept:
        assert [item.options for item in kept.finished] == drawn
    with pytest.raises(UserError, match="begun with loops 2, not 3"), opened_trials(place, "beam", {"loops": 3}, {}, 0):
        pass


@pytest.mark.slow
def test_the_command_writes_a_parameter_file_only_for_what_is_better(command, tmp_path: Path):
    out = tmp_path / "tuned"
    words = (
        "tune",
        "cam_beam",
        "--trials",
        6,
        "--loops",
        4,
        "--horizons",
        2,
        "--study",
        tmp_path / "t.db",
        "--jobs",
        1,
    )
    status, said, error = command(*words, "--out", out)
    assert status == 0, error
    assert "on unseen loops" in said or "it stays" in said
    found = yaml.safe_load((out / "tuning.yaml").read_text())
    assert found["trials"] == 6
    assert (out / "params.yaml").exists() == found["better"]
    if found["better"]:
        assert of_file(str(out / "params.yaml"), "/controller") == found["nodes"]["controller"]
    assert "Plotly.newPlot" in (out / "front.html").read_text()


def test_what_is_no_rig_aim_or_number_is_refused(command, tmp_path: Path):
    refused(command("tune", "no_rig"), "no_rig")
    refused(command("tune", "cam_beam", "--aim", "speed"), "speed")
    refused(command("tune", "cam_beam", "--trials", 1), "--trials")
    (tmp_path / "thesis.tex").touch()
    refused(command("tune", "cam_beam", "--out", tmp_path), tmp_path)

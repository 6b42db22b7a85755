"""The front door: what ``import hybrid_sysid_ros as hs`` offers, what it takes and what comes back."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros import models
from hybrid_sysid_ros.identification import evaluate
from hybrid_sysid_ros.library.arguments import given_columns, given_sampling
from hybrid_sysid_ros.library.loops import used_model
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError
from tests.shared import Frame

ROOT = Path(__file__).parents[1]
BAGS, TRAINED = ROOT / "bags", ROOT / "trained"


@pytest.fixture(scope="module")
def things() -> SimpleNamespace:
    """A rig, a model and a policy as a user has them."""
    return SimpleNamespace(
        record=hs.read_bag(BAGS / "beam_multisine", "cam_beam"),
        model=hs.load_model(TRAINED / "cam_beam" / "model"),
        policy=hs.load_policy(TRAINED / "cam_beam" / "policy"),
        rig=hs.load_rig("cam_beam"),
    )


# The names


def test_a_dozen_names_are_offered_and_nothing_else() -> None:
    assert dir(hs) == sorted(hs.__all__)
    assert len(hs.__all__) <= 16
    for name in hs.__all__:
        assert getattr(hs, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'identity'"):
        _ = hs.identity  # type: ignore[attr-defined]


def test_importing_the_package_loads_no_library() -> None:
    code = (
        "import sys, time; began = time.perf_counter(); import hybrid_sysid_ros as hs; "
        "took = time.perf_counter() - began; heavy = {'numpy', 'numba', 'casadi', 'scipy', 'yaml', 'torch', 'plotly'}; "
        "assert not heavy & set(sys.modules), heavy & set(sys.modules); dir(hs); print(took)"
    )
    took = float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)
    assert took < 0.3


# What is taken


def test_one_record_one_column_and_an_array_are_taken_where_lists_are(things: SimpleNamespace) -> None:
    record = hs.read_bag(BAGS / "beam_multisine", "cam_beam")
    one = hs.identify(record, "cam_beam", "linear", part=np.array([0.0, 0.25]))
    two = hs.identify([record], things.rig, "linear", part=[(0.0, 0.25)])
    assert one.parameters == two.parameters


def test_records_of_arrays_are_those_of_their_bag() -> None:
    read = hs.read_bag(BAGS / "beam_multisine", "cam_beam")
    volts = hs.load_rig("cam_beam").display[0].shown(read.output[:, 0])
    late = hs.record(
        time=1_700_000_000.0 + read.time, inputs={"drive": read.input}, outputs=volts, units={"position": "V"},
        rig="cam_beam",
    )  # fmt: skip
    np.testing.assert_allclose(late.output, read.output, atol=1e-12)
    np.testing.assert_array_equal(late.input, read.input)
    assert late.time == pytest.approx(read.time, abs=1e-4)


def test_columns_by_name_come_in_the_rigs_order() -> None:
    found = given_columns({"b": [3.0, 4.0], "a": [1.0, 2.0]}, "inputs", ["a", "b"], 2)
    np.testing.assert_array_equal(found, [[1.0, 3.0], [2.0, 4.0]])
    frame = given_columns(Frame(b=[3.0, 4.0], a=[1.0, 2.0]), "inputs", ["a", "b"], 2)
    np.testing.assert_array_equal(frame, found)


def test_a_home_is_a_home_wherever_a_folder_is_given(
    things: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    things.model.save("~/x")
    assert (tmp_path / "x" / "model.yaml").is_file()
    assert hs.load_model("~/x").parameters == things.model.parameters


@pytest.mark.parametrize("kind", ["exporters", "policies"])
def test_what_needs_an_extension_says_which(
    things: SimpleNamespace, kind: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    there = extensions.targets
    monkeypatch.setattr(extensions, "targets", lambda name: {} if name == kind else there(name))
    needs: dict[str, list[Callable[[], object]]] = {
        "exporters": [lambda: hs.export(things.model, tmp_path / "x")],
        "policies": [lambda: hs.train_policy("cam_beam", things.model), lambda: hs.certify(things.policy)],
    }
    for call in needs[kind]:
        with pytest.raises(hs.UserError, match=r"hs\.\w+ needs the extension \w+"):
            call()


# What comes back


def test_a_model_prints_as_a_table_without_arrays(things: SimpleNamespace) -> None:
    for text in (str(things.model), repr(things.model), repr(things.record), repr(things.rig), str(things.policy)):
        assert "array(" not in text
        assert len(text.splitlines()) <= 11
    assert "rad/(s^2 V)" in str(things.model)


def test_times_in_single_precision_and_other_units_are_taken() -> None:
    time, wave = np.arange(4800) * 0.005, np.sin(np.arange(4800) * 0.01)
    given = {"inputs": wave, "outputs": wave * 0.1, "rig": "cam_beam"}
    single = hs.record(time=time.astype(np.float32), **given)
    np.testing.assert_allclose(single.time, time, rtol=1e-6)
    own = hs.record(time=time, **given)
    scaled = {**given, "inputs": wave * 1e3, "outputs": np.degrees(wave * 0.1)}
    other = hs.record(time=time, **scaled, units={"position": "deg", "drive": "mV"})
    np.testing.assert_allclose(other.output, own.output, rtol=1e-12)
    np.testing.assert_allclose(other.input, own.input, rtol=1e-12)
    assert hs.record(time=time[:2], **{**given, "inputs": wave[:2], "outputs": wave[:2] * 0.1}).samples == 2


@pytest.mark.parametrize("period", [0.001, 0.003, 0.004, 0.005, 0.008, 0.01, 1 / 610.35, 0.02, 0.03, 0.04, 0.05, 0.07])
def test_the_usual_sampling_follows_a_record_that_has_another_one(period: float) -> None:
    """Where neither the call nor the rig's file says more; times that are in milliseconds stay an error."""
    rig = replace(hs.load_rig("cam_beam"), content={})
    given: Any = [SimpleNamespace(sampling_time=period)]
    found = given_sampling(None, rig, given)
    every, steps = found.period / period, max(found.step, period) / min(found.step, period)
    assert every == pytest.approx(round(every), abs=1e-9)
    assert steps == pytest.approx(round(steps), abs=1e-9)
    assert found.step == pytest.approx(0.005, rel=0.45)
    assert found.period == pytest.approx(0.05, rel=0.45)
    if period in (0.001, 0.005, 0.01, 0.05):
        assert (found.step, found.period) == (0.005, 0.05)
    slower = given_sampling(None, replace(rig, step=0.5), [SimpleNamespace(sampling_time=1.0)])  # type: ignore[list-item]
    assert (slower.step, slower.period) == (0.1, 1.0)
    slow: Any = [SimpleNamespace(sampling_time=1000.0 * period)]
    assert given_sampling(None, rig, slow) == given_sampling(None, rig)
    assert given_sampling({"period": 0.1}, rig, given).period == 0.1


def test_a_model_scores_as_the_command_does(things: SimpleNamespace) -> None:
    record = hs.read_bag(BAGS / "beam_swept_sine", "cam_beam")
    assert things.model.score(record) == evaluate(models.load(TRAINED / "cam_beam" / "model"), record)
    run = things.model.free_run(record, part=(0.5, 1.0))
    assert run.outputs.shape == run.measured.shape == (len(run.time), 1)
    assert run.states.shape == (len(run.time), 2)
    assert things.model.score(record, part=(0.5, 1.0)).rmse == pytest.approx(
        float(np.sqrt(np.mean((run.measured - run.outputs) ** 2)))
    )


def test_an_evaluation_says_what_the_command_says(
    things: SimpleNamespace, command: Callable[..., tuple[int, str, str]]
) -> None:
    bag = str(BAGS / "beam_swept_sine")
    found = things.model.evaluate(hs.read_bag(bag, "cam_beam"))
    _, printed, _ = command("evaluate", TRAINED / "cam_beam" / "model", bag, "--json")
    said = json.loads(printed)["records"]["beam_swept_sine"]
    assert said["r2"] == pytest.approx(found.scores["r2"])
    assert said["judgement"] == found.judgement
    assert said["closed_loop"]["r2"] == pytest.approx(found.loop["r2"])
    assert said["trained_range"]["sentence"] in str(found)
    flight = hs.load_model(TRAINED / "winged_cone" / "model").evaluate(
        hs.read_bag(BAGS / "winged_cone_flight", "winged_cone"), part=(0.75, 1.0)
    )
    assert "meaningless for an unstable system" in str(flight)
    assert not flight.scores


def test_an_unstable_rigs_model_is_scored_under_its_stabiliser() -> None:
    record = hs.read_bag(BAGS / "winged_cone_flight", "winged_cone")
    model = hs.load_model(TRAINED / "winged_cone" / "model")
    assert model.score(record, part=(0.75, 1.0)).outputs


def test_a_loop_repeats_bit_by_bit_and_has_its_arrays_by_name(things: SimpleNamespace) -> None:
    loops = [hs.simulate("cam_beam", things.model, reference="steps", seconds=1.0) for _ in range(2)]
    first, second = loops
    for name in ("time", "states", "outputs", "inputs", "reference", "estimate"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
        assert len(getattr(first, name)) == 50
    assert first.cost == second.cost > 0.0
    assert set(first.score) == {"position"}
    assert "late" not in str(first)
    np.testing.assert_array_equal(first.outputs[:, 0], first.states[:, 0])
    noisy = hs.simulate("cam_beam", things.model, reference="steps", seconds=1.0, seed=1)
    assert not np.array_equal(first.inputs, noisy.inputs)


def test_a_policy_drives_alone_supervised_and_by_name(things: SimpleNamespace) -> None:
    given: dict[str, Any] = {"reference": lambda t: np.sin(t)[:, None], "seconds": 0.5}
    alone = hs.simulate("cam_beam", things.model, controller=things.policy, **given)
    named = hs.simulate("cam_beam", controller="network", **given)
    np.testing.assert_array_equal(alone.inputs, named.inputs)
    held = hs.simulate("cam_beam", things.model, controller="supervised", policy=things.policy, **given)
    assert np.isfinite(held.inputs).all()


def test_a_set_point_is_in_the_unit_that_is_shown(things: SimpleNamespace) -> None:
    loop = hs.simulate(things.rig, things.model, reference=2.0, seconds=0.1, parameters={"controller.horizon": 15})
    np.testing.assert_allclose(things.rig.display[0].shown(loop.reference), 2.0)
    assert loop.problem.horizon == 15


def test_the_order_of_parameters_does_not_matter_and_what_must_be_longer_grows(things: SimpleNamespace) -> None:
    for given in ({"period": 0.1, "stale_after": 1.0}, {"stale_after": 1.0, "period": 0.1}, {"period": 0.1}):
        assert hs.mpc(things.rig, things.model, parameters=given).period == 0.1
    with pytest.raises(UserError, match="must be more than period"):
        hs.mpc(things.rig, things.model, parameters={"stale_after": 0.05, "period": 0.1})


def test_a_model_may_move_in_place_of_the_rig(things: SimpleNamespace) -> None:
    given: dict[str, Any] = {"reference": 2.0, "seconds": 1.0}
    real = hs.simulate("cam_beam", things.model, **given)
    moved = hs.simulate("cam_beam", things.model, plant=things.model, **given)
    assert not np.array_equal(real.states, moved.states)


def test_a_rig_without_a_model_moves_by_the_equations_of_its_class(tmp_path: Path) -> None:
    """As a textbook has them, before anything is recorded."""
    copied = tmp_path / "my_joint"
    shutil.copytree(hs.load_rig("flexible_joint").folder, copied, ignore=shutil.ignore_patterns("__pycache__"))
    rig = hs.load_rig(copied)
    with pytest.warns(RuntimeWarning, match="no model of my_joint is given"):
        used = used_model(rig, None)
    assert used.system is rig.system
    assert used.standard_errors == {}


def test_figures_show_what_was_measured_and_simulated(things: SimpleNamespace) -> None:
    pytest.importorskip("plotly")
    figure = things.model.plot(hs.read_bag(BAGS / "beam_swept_sine", "cam_beam"))
    names = [trace.name for trace in figure.data]
    assert {"measured", "free run"} <= set(names)
    drawn = hs.simulate(things.rig, things.model, seconds=0.1).plot()
    assert {"output", "reference", "input"} <= {trace.name for trace in drawn.data}


@pytest.mark.slow
def test_a_policy_keeps_to_its_model_wherever_that_is_saved(tmp_path: Path) -> None:
    """What is trained on a model that was never saved goes with the folder that it is saved to later."""
    pytest.importorskip("torch")
    record = hs.read_bag(BAGS / "beam_multisine", "cam_beam")
    model = hs.identify(record, "cam_beam", "linear", part=(0.0, 0.25))
    policy = hs.train_policy("cam_beam", model, episodes=2, rounds=1, epochs=1, hidden=(4,), workers=1)
    certificate = hs.certify(policy, loops=2, delta=0.5, workers=1)
    model.save(tmp_path / "model")
    policy.save(tmp_path / "policy")
    certificate.save(tmp_path / "policy")
    again = hs.load_policy(tmp_path / "policy", hs.load_model(tmp_path / "model"))
    assert again.certificate is not None
    assert again.certificate.loops == 2
    assert "array(" not in str(certificate)
    pytest.importorskip("hybrid_sysid_ros.extensions.export")
    assert (hs.export(again, tmp_path / "c", format="c") / "export.json").is_file()
    assert (hs.export(model, tmp_path / "casadi") / "step.casadi").is_file()

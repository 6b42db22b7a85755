"""What a model was trained on: motions like it are accused at the stated rate, others are named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter

from hybrid_sysid_ros.bags import read as bag_of
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.trained_range.live import live_range_of
from hybrid_sysid_ros.extensions.trained_range.older_models import notes_of
from hybrid_sysid_ros.extensions.trained_range.trained_range import WRONGLY, TrainedRange, _places, mean_inputs
from hybrid_sysid_ros.extensions.trained_range.words import reason
from hybrid_sysid_ros.identification import prepare
from hybrid_sysid_ros.models import Sampling, load
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.models.model import NOTES
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture import lecture
from studies.beam_lecture import records as beam_records
from tests.one_joint import Linear

SAMPLING = Sampling(step=0.05, period=0.05)
ROOT = Path(__file__).parents[4]


class DampedCart(System):
    """x'' = u - x'."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("push [m/s^2]",)
    outputs = ("place",)

    def law(self, x, u):
        return x[1], u[0] - x[1]


class SlowTank(System):
    """T^2 x'' = u - x - 2 T x', of which T is an hour."""

    states = ("level [m]", "rate [m/s]")
    inputs = ("flow [m]",)
    outputs = ("level",)

    def law(self, x, u):
        return x[1], (u[0] - x[0]) / 3600.0**2 - 2.0 / 3600.0 * x[1]


def experiment(outputs, inputs):
    """A record of samples."""
    outputs, inputs = np.reshape(outputs, (-1, 1)), np.reshape(inputs, (-1, 1))
    return PreparedRecord(
        name="made", sampling=SAMPLING, inputs=inputs[:-1], outputs=outputs, states=np.zeros((len(outputs), 2))
    )


def wandering(seed, samples=4000):
    """A stationary motion of one kind, and what drives it."""
    drive = lfilter([1.0], [1.0, -0.9], np.random.default_rng(seed).normal(size=samples + 200))
    return lfilter([0.1], [1.0, -1.7, 0.8], drive)[200:], drive[200:]


def trained_on(*motions):
    found = TrainedRange.of(Linear(), [experiment(*motion) for motion in motions])
    assert found is not None
    return found


def outside(found, motion):
    """Share of a motion that is untrained."""
    outputs, inputs = (np.reshape(values, (-1, 1)) for values in motion)
    return found.outside(outputs, inputs)[found.scales.samples[-1] :].mean()


def words(found, motion):
    outputs, inputs = (np.reshape(values, (-1, 1)) for values in motion)
    away = found.outside(outputs, inputs)[found.scales.samples[-1] :]
    return reason(found, found.scales.features(outputs, inputs)[away], Linear(), SAMPLING.period)


def test_motions_of_the_same_kind_are_accused_at_the_stated_rate():
    shares = [outside(trained_on(wandering(k), wandering(k + 100)), wandering(k + 200)) for k in range(8)]
    assert np.mean(shares) == pytest.approx(WRONGLY, abs=0.01)


def test_slow_motion_in_one_direction_is_another_than_in_the_other_and_than_rest():
    """All three pass through places, speeds and inputs that a faster motion had."""
    y, u = wandering(1)
    slow, held = np.linspace(-0.5, 0.5, 1200) * np.std(y), np.full(1200, np.mean(u))
    down, up, still = (-slow, held), (slow, held), (0.0 * slow, held)
    found = trained_on((y, u), down)
    assert outside(found, down) < 0.1
    assert outside(found, up) > 0.9
    assert outside(found, still) > 0.9
    assert "no slow motion of position upwards" in words(found, up)
    assert "no rest of position for 5 s" in words(found, still)


def test_what_an_input_never_was_is_named_with_its_end():
    y, u = wandering(1)
    found = trained_on((y, u))
    away = wandering(2)[0], 3.0 * np.max(u) + wandering(2)[1]
    assert outside(found, away) > 0.9
    assert f"above {np.max(found.typical[:, -1]) * np.std(u):.3g}" in words(found, away)


def test_a_place_that_moves_nothing_is_as_good_as_another():
    """Where the law does not read its position, a cart that wandered off is still the same cart."""
    y, u = wandering(1)
    cart, held = (TrainedRange.of(system, [experiment(y, u)]) for system in (DampedCart(), Linear()))
    assert outside(cart, (y + 1e3, u)) < 0.01
    assert outside(held, (y + 1e3, u)) == 1.0
    joint = load_rig("flexible_joint").system  # the spring reads the difference of its two angles only
    assert _places(joint, 1e-3).tolist() == [0.0, 1.0]


def test_what_goes_on_growing_leaves_what_was_trained_at_its_end():
    """No part of it is like the rest, so that its parts' distances from the rest say nothing."""
    grown, drive = np.exp(np.linspace(0.0, 3.0, 4000)), np.ones(4000) + wandering(1)[1]
    early, later = (grown[:2500], drive[:2500]), (grown[2500:], drive[2500:])
    found = trained_on(early)
    assert outside(found, later) > 0.9
    assert words(found, later).startswith(f"no position above {grown[2499]:.2g}")


def test_a_slow_system_reads_its_place_over_the_step_of_its_fit():
    """A tank of hours: over a millisecond its level moves nothing."""
    assert _places(SlowTank(), 60.0).tolist() == [1.0]


def test_a_trained_range_is_kept_in_a_model_and_read_again():
    found = trained_on(wandering(1))
    again = TrainedRange.from_content(json.loads(json.dumps(found.content)), DampedCart())
    y, u = (np.reshape(values, (-1, 1)) for values in wandering(3))
    np.testing.assert_allclose(found.distance(y, u), again.distance(y, u))


@pytest.mark.parametrize(
    "damage",
    [
        {"reach": "far"}, {"reach": float("nan")}, {"reach": -1.0}, {"outputs": [1.0, 1.0]}, {"inputs": []},
        {"samples": [2, 20]}, {"samples": [20, 2, 100]}, {"samples": [2, 20, 10**9]}, {"typical": []},
        {"typical": ["1 2"]}, {"typical": [3]}, {"places": None}, {"reach": 10**400}, {"none": [0.0]},
    ],
)  # fmt: skip
def test_a_trained_range_that_is_damaged_is_refused_in_a_line(damage):
    content = trained_on(wandering(1)).content | damage
    with pytest.raises(UserError, match=r"fit.trained_range of the model is malformed .*; fit again"):
        TrainedRange.from_content(content, DampedCart())


def test_evaluate_says_before_all_else_whether_a_model_was_trained_for_a_record(command, linear_model):
    bags = ROOT / "bags"
    content = yaml.safe_load((linear_model / "model.yaml").read_text())
    assert len(json.dumps(content["fit"]["trained_range"])) < 8000
    status, out, error = command("evaluate", linear_model, bags / "beam_random_steps")
    assert status == 0, error
    assert out.startswith("beam_random_steps: partly trained: ")
    _, out, _ = command("evaluate", linear_model, bags / "beam_random_steps", "--json")
    found = json.loads(out)["records"]["beam_random_steps"]["trained_range"]
    assert found["verdict"] in found["sentence"]


def test_a_loop_is_told_where_it_leaves_what_its_model_was_trained_on(linear_model):
    """Estimates of a beam that rests for long, which no multisine does."""
    model = load(linear_model)
    found = live_range_of(model, {"rate": 100.0})
    assert found is not None
    still: Any = SimpleNamespace(state=np.zeros(len(model.system.states)), disturbance=np.zeros(1))
    for _ in range(300):
        found.see(still, np.zeros(1))
    assert found.report()[0] == ""
    for _ in range(600):
        found.see(still, np.zeros(1))
    words, values = found.report()
    assert words == "no rest of position for 2.5 s was trained on"
    assert values["untrained_share"] == 1.0
    assert live_range_of(replace(model, fit={}), {"rate": 100.0}) is None


def test_a_report_shows_the_runs_on_a_map_of_what_was_trained_on(command, linear_model, tmp_path):
    page = tmp_path / "page.html"
    status, _, error = command("evaluate", linear_model, ROOT / "bags" / "beam_swept_sine", "--report", page)
    assert status == 0, error
    text = page.read_text(encoding="utf-8")
    assert 'id="further-trained_range"' in text
    assert "mean speed of position over 2.5 s" in text


def test_the_real_beam_in_slow_motion_is_trained_on_in_the_direction_of_the_ramp_alone(data, records, rig):
    ramps = sorted((data / "bab_slow").glob("*.mat"))
    if not ramps:
        pytest.skip("needs the slow ramp in the folder bab_slow")
    slow = beam_records.load(ramps[0])
    output = rig.display[0].si(slow.output)[:, None]
    time = np.arange(len(output), dtype=np.float64) * slow.sampling_time
    all_records = [*records.values(), Record(name=ramps[0].stem, time=time, input=slow.input[:, None], output=output)]
    found = {}
    for number in (2, 3):
        protocol = lecture.arrange(all_records, number)
        used = zip(protocol.training, protocol.parts, strict=True)
        prepared = [prepare(part.of(record, Sampling()), rig.system, Sampling()) for record, part in used]
        found[number] = TrainedRange.of(rig.system, prepared)
    ramp = next(prepare(item, rig.system, Sampling()) for item in all_records if lecture.is_ramp(item.name))
    motion = ramp.outputs, mean_inputs(ramp)
    assert outside(found[2], motion) > 0.9
    assert outside(found[3], motion) < 0.1
    assert outside(found[3], tuple(values[::-1] for values in motion)) > 0.9
    swept = next(prepare(item, rig.system, Sampling()) for item in all_records if "swept" in item.name)
    assert outside(found[2], (swept.outputs, mean_inputs(swept))) < 0.1


def test_an_older_model_gets_notes_beside_its_seal(call, tmp_path: Path) -> None:
    """By its training records, the digest or the score of which it knows; a policy still belongs to it."""
    bags = [ROOT / "bags" / f"wheel_motor_{kind}" for kind in ("multisine", "random_steps")]
    shipped = load(ROOT / "trained/wheel_motor/model")
    replace(shipped, notes={}).save(tmp_path / "model")
    before = load(tmp_path / "model")
    assert before.note("trained_range") is None
    status, _, error = call(app.main, "hybrid-sysid", "trained-range", tmp_path / "model", bags[0])
    assert (status, "as well" in error) == (2, True)
    assert call(app.main, "hybrid-sysid", "trained-range", tmp_path / "model", *bags)[0] == 0
    after = load(tmp_path / "model")
    assert after.seal == before.seal
    assert after.note("trained_range") == shipped.note("trained_range")
    floors = [model.note("bands")["outputs"]["speed"]["floor"] for model in (after, shipped)]
    assert floors[0] == pytest.approx(floors[1], rel=1e-3)
    load(ROOT / "trained/cam_beam/model").save(tmp_path / "other")
    (tmp_path / "model" / NOTES).write_bytes((tmp_path / "other" / NOTES).read_bytes())
    with pytest.raises(UserError, match="of another model"):
        load(tmp_path / "model")
    assert call(app.main, "hybrid-sysid", "trained-range", tmp_path / "model", *bags)[0] == 0
    assert load(tmp_path / "model").note("trained_range") == shipped.note("trained_range")


def test_another_record_by_the_name_of_a_training_record_is_refused() -> None:
    rig, model = load_rig("wheel_motor"), load(ROOT / "trained/wheel_motor/model")
    records = [bag_of(ROOT / "bags" / f"wheel_motor_{kind}", rig.signals) for kind in ("multisine", "random_steps")]
    half = replace(records[0], output=0.9 * records[0].output, digest="")
    with pytest.raises(UserError, match="not the same"):
        notes_of(model, [half, records[1]], rig)

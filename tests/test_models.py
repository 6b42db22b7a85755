"""Models as folders: what is saved is what is loaded, and a bad folder says what is wrong with it."""

import dataclasses
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from hybrid_sysid_ros import models
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.models import Model, Sampling, build, storage, structure_names
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.model import FORMAT
from hybrid_sysid_ros.models.structure import assemble, options_of, parse
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from tests.structures import FURTHER, RANGE

FROM_DATA = {name: made() for name, made in FURTHER.items()}
BUILT = [name for name in structure_names() if name not in FROM_DATA]
SCALES = np.array([0.1, 0.4, 5.0])


def started(structure, seed):
    return FROM_DATA.get(structure) or build(structure, CamBeam(), scales=SCALES, seed=seed)[0]


def model_of(structure, seed=0):
    """A model of a structure with numbers that need every digit."""
    random = np.random.default_rng(seed)
    system = started(structure, seed)
    values = [v + (h - v) * random.uniform(0, 0.1) for v, h in zip(system.values, high(system), strict=True)]
    system = system.with_values(np.array(values))
    if len(system.weights):
        system = system.with_weights(random.normal(size=len(system.weights)) / 3)
    free = tuple(item.name for item in system.parameters if not item.fixed)
    free += tuple(f"weight_{k}" for k in range(len(system.weights)))
    root = random.normal(size=(len(free), len(free)))
    return Model(
        rig="cam_beam",
        structure=structure,
        system=system,
        sampling=Sampling(step=0.005, period=0.05, input="sampled"),
        names=free,
        covariance=root @ root.T / 7,
        training_range={"position": (-0.1 / 3, 0.1), "velocity": (-0.5, 0.5), "drive": (-10.0, 10.0)},
        records=({"name": "a", "source": "a.mcap", "sha256": "0" * 64, "part": [0.0, 0.5]},),
        scores={"a": {"r2": 1 / 3, "rmse": 1e-3, "fit_percent": 90.0}, "b": {"r2": -np.inf, "rmse": np.inf}},
        fit={"relative_error": 0.1, "seconds": 1.0, "evaluations": 10, "seed": 0},
    )


def high(system):
    return [item.high for item in system.parameters]


@pytest.fixture
def folder(tmp_path):
    model_of("hybrid").save(tmp_path / "model")
    return tmp_path / "model"


@pytest.mark.parametrize("structure", structure_names())
def test_a_model_comes_back_to_the_last_bit(tmp_path, structure):
    model = model_of(structure)
    model.save(tmp_path / "model")
    back = models.load(tmp_path / "model")
    np.testing.assert_array_equal(back.system.values, model.system.values)
    np.testing.assert_array_equal(back.system.weights, model.system.weights)
    np.testing.assert_array_equal(back.covariance, model.covariance)
    for name in ("rig", "structure", "sampling", "names", "training_range", "records", "scores", "fit"):
        assert getattr(back, name) == getattr(model, name), name
    assert type(back.system) is type(model.system)
    assert back.standard_errors == model.standard_errors
    inputs = np.random.default_rng(0).uniform(-9, 9, (500, 1))
    runs = [simulate(item.system, np.zeros(len(model.system.states)), inputs, step=0.005) for item in (model, back)]
    np.testing.assert_array_equal(runs[0], runs[1])


def test_a_model_saved_again_has_the_same_seal(folder, tmp_path):
    model = models.load(folder)
    model.save(tmp_path / "again")
    assert models.load(tmp_path / "again").seal == model.seal
    assert storage.digest(folder, kind="model") == model.seal


def test_another_number_gives_another_seal(folder, tmp_path):
    model_of("hybrid", seed=1).save(tmp_path / "other")
    assert models.load(tmp_path / "other").seal != models.load(folder).seal


def test_a_law_that_was_changed_since_the_fit_is_reported(tmp_path, monkeypatch):
    model_of("gray").save(tmp_path)
    law = CamBeam.law

    def stronger(self, x, u):
        speed, acceleration = law(self, x, u)
        return speed, 1.001 * acceleration

    monkeypatch.setattr(CamBeam, "law", stronger)
    with pytest.raises(UserError, match="rig cam_beam has another law than when the model was fitted; fit again"):
        models.load(tmp_path)


def test_parameters_are_written_with_unit_error_and_bounds(folder):
    content = yaml.safe_load((folder / "model.yaml").read_text())
    gain = content["parameters"]["gain"]
    assert gain["unit"] == "rad/(s^2 V)"
    assert gain["bounds"] == [0.1, 40.0]
    assert gain["standard_error"] == model_of("hybrid").standard_errors["gain"]
    assert content["parameters"]["range_low"]["standard_error"] is None  # set, not fitted
    assert content["records"][0]["sha256"] == "0" * 64
    assert {"numpy", "numba", "casadi"} <= set(content["versions"])


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600)])
def test_the_umask_says_who_may_read_a_model(tmp_path, mask, mode):
    """Nodes under another user load it too, and both of its files are alike."""
    before = os.umask(mask)
    try:
        model_of("hybrid").save(tmp_path / "model")
    finally:
        os.umask(before)
    assert {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "model").iterdir()} == {
        "model.yaml": mode,
        "weights.safetensors": mode,
    }


def text(change):
    """Change the text of model.yaml."""

    def apply(folder):
        path = folder / "model.yaml"
        path.write_text(change(path.read_text()))

    return apply


def sealed(change):
    """Change the content of model.yaml and seal it again, as somebody would who knows how."""

    def apply(folder):
        content, arrays = storage.load(folder, kind="model", version=FORMAT)
        change(content, arrays)
        body = {key: value for key, value in content.items() if key not in ("format", "arrays", "seal")}
        storage.save(folder, kind="model", version=FORMAT, content=body, arrays=arrays)

    return apply


def entry(name, value, key="value"):
    def change(content, arrays):
        content["parameters"][name][key] = value

    return change


def flip_a_bit(folder):
    path = folder / "weights.safetensors"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


BAD = {
    "no folder": (shutil.rmtree, "no such model folder"),
    "no yaml": (lambda folder: (folder / "model.yaml").unlink(), r"model\.yaml: is missing"),
    "no arrays": (lambda folder: (folder / "weights.safetensors").unlink(), r"weights\.safetensors: is missing"),
    "altered arrays": (flip_a_bit, r"weights\.safetensors: was altered"),
    "cut arrays": (
        lambda folder: (folder / "weights.safetensors").write_bytes(b"short"),
        r"weights\.safetensors: was altered",
    ),
    "altered number": (text(lambda t: t.replace("seed: 0", "seed: 1")), r"model\.yaml: was altered"),
    "a date": (text(lambda t: t.replace("seed: 0", "seed: 2024-01-01")), r"model\.yaml: was altered"),
    "mixed keys": (text(lambda t: t + "1: 2\nnull: 3\n"), r"model\.yaml: was altered"),
    "no seal": (text(lambda t: t[: t.index("seal: ")]), r"model\.yaml: was altered"),
    "cut yaml": (text(lambda t: t[: len(t) // 2]), r"model\.yaml: (was altered|is no valid YAML)"),
    "empty yaml": (text(lambda t: ""), r"model\.yaml: holds no keys"),
    "not yaml": (text(lambda t: "a: [b"), r"model\.yaml: is no valid YAML"),
    "code": (text(lambda t: t + "x: !!python/object/apply:os.getcwd []\n"), r"model\.yaml: is no valid YAML"),
    "newer format": (text(lambda t: t.replace("format: 2", "format: 3")), r"model\.yaml: format 3 is newer than 2"),
    "older format": (text(lambda t: t.replace("format: 2", "format: 1")), r"model\.yaml: format 1 is older than 2"),
    "out of bounds": (
        sealed(entry("damping", -3.0)),
        r"model\.yaml: .*parameter damping = -3 1/s is outside \[0, 150\]",
    ),
    "not a number": (sealed(entry("gain", float("nan"))), r"model\.yaml: .*parameter gain = nan"),
    "no value": (sealed(entry("gain", None)), r"model\.yaml"),
    "other rig": (sealed(lambda c, a: c.update(rig="crane")), r"model\.yaml: .*crane"),
    "other structure": (sealed(lambda c, a: c.update(structure="linear")), r"model\.yaml: structure linear of rig"),
    "no structure": (sealed(lambda c, a: c.update(structure="magic")), r"model\.yaml: structure 'magic' is unknown"),
    "missing key": (sealed(lambda c, a: c.pop("sampling")), r"model\.yaml: .*sampling"),
    "missing parameter": (sealed(lambda c, a: c["parameters"].pop("gain")), r"model\.yaml: structure hybrid"),
    "missing array": (sealed(lambda c, a: a.pop("weights")), r"model\.yaml: .*weights"),
    "too few weights": (sealed(lambda c, a: a.update(weights=np.zeros(3))), r"model\.yaml: .*3 weights don't fit"),
    "weight not finite": (sealed(lambda c, a: a["weights"].fill(np.nan)), r"model\.yaml: array weights .*not finite"),
    "weights in a column": (
        sealed(lambda c, a: a.update(weights=a["weights"][:, None])),
        r"model\.yaml: array weights has the shape \(\d+, 1\), not \(any\)",
    ),
    "weights of truths": (sealed(lambda c, a: a.update(weights=a["weights"] > 0)), r"array weights is of kind bool"),
    "wrong covariance": (sealed(lambda c, a: a.update(covariance=np.eye(2))), r"model\.yaml: .*covariance"),
    "wrong period": (sealed(lambda c, a: c["sampling"].update(period=0.012)), r"model\.yaml: sampling: the period"),
    "wrong input": (sealed(lambda c, a: c["sampling"].update(input="guessed")), r"model\.yaml: sampling: input"),
    "a size without end": (sealed(lambda c, a: c["design"].update(units=float("inf"))), r"model\.yaml: .*infinity"),
    "unknown key": (sealed(lambda c, a: c["sampling"].update(extra=1)), r"model\.yaml: .*extra"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_folder_gives_one_line_that_names_the_file(folder, case):
    spoil, reason = BAD[case]
    spoil(folder)
    with pytest.raises(UserError, match=reason) as raised:
        models.load(folder)
    assert "\n" not in str(raised.value)
    assert str(folder) in str(raised.value)


def test_weights_of_single_precision_become_numbers_that_compiled_code_takes(tmp_path):
    single = model_of("hybrid").system.weights.astype(np.float32)
    model = dataclasses.replace(model_of("hybrid"), system=model_of("hybrid").system.with_weights(single.astype(float)))
    model.save(tmp_path / "model")
    sealed(lambda content, arrays: arrays.update(weights=single))(tmp_path / "model")
    system = models.load(tmp_path / "model").system
    assert system.weights.dtype == np.float64
    found, wanted = (simulate(each, np.zeros(2), np.ones((5, 1)), step=0.005) for each in (system, model.system))
    np.testing.assert_array_equal(found, wanted)


def test_a_folder_that_is_no_model_is_not_replaced(tmp_path):
    (tmp_path / "notes.txt").write_text("keep me")
    with pytest.raises(UserError, match=r"no model\.yaml"):
        model_of("linear").save(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "keep me"


def test_a_structure_begins_where_no_earlier_fit_leaks_in():
    """The rig's identified values are not the start of a fit."""
    for structure in BUILT:
        system, held = build(structure, CamBeam(), scales=SCALES, seed=0)
        other, _ = build(structure, CamBeam(gain=9.0, coulomb=0.3), scales=SCALES, seed=0)
        for item, value in zip(system.parameters, system.values, strict=True):
            assert item.fixed or value == (item.neutral if item.name in held else item.start)
        np.testing.assert_array_equal(system.values, other.values)
        system.check()


@pytest.mark.parametrize("size", [1.0, 1.1, 1.2, 1.3, 1.4])
def test_a_linear_system_begins_within_its_bounds_to_the_last_digit(size):
    system, _ = build("linear", CamBeam(), scales=np.array([1.0, size, size**3]) * RANGE, seed=0)
    assert isinstance(system, Linear)
    started = system.initialised({item.name: 1e9 for item in system.parameters if not item.fixed})
    started.with_values([item.start for item in started.parameters]).check()


def test_doubtful_terms_are_left_out_and_held_unless_they_are_asked_for():
    plain, held = build("gray", CamBeam(), scales=SCALES, seed=0)
    assert set(held) == {"stribeck_excess", "stribeck_speed", "damping_asymmetry", "creep"}
    assert plain.named["stribeck_excess"] == plain.named["damping_asymmetry"] == plain.named["creep"] == 0.0
    assert plain.named["stribeck_speed"] > 0.0  # a scale of what is zero, and a divisor
    creeping, held = build("gray", CamBeam(), scales=SCALES, seed=0, options={"creep": 1})
    assert "creep" not in held
    assert creeping.named["creep"] == next(item.start for item in creeping.parameters if item.name == "creep")


def test_a_term_that_is_switched_off_does_not_move_the_beam():
    beam, held = build("gray", CamBeam(), scales=SCALES, seed=0, options={"cam": 0, "drive_asymmetry": 0})
    assert {"cam_curvature", "asymmetry"} <= set(held)
    assert isinstance(beam, CamBeam)
    # Without crank and asymmetry the drive is a straight line through the centre: up and down are mirror images.
    beam = dataclasses.replace(beam, centre=0.0, quadratic_stiffness=0.0, friction_slope=0.0)
    up, down = (simulate(beam, np.zeros(2), np.full((200, 1), volts), step=0.005) for volts in (4.0, -4.0))
    np.testing.assert_array_equal(up, -down)


def test_physics_has_its_terms_as_options_and_a_network_its_own():
    assert {"cam", "stribeck", "creep", "starts"} <= set(options_of("gray", CamBeam()))
    assert {"cam", "units", "members", "ridge"} <= set(options_of("hybrid", CamBeam()))
    sensors = {f"position_{quantity}" for quantity in ("gain", "offset", "delay", "window")}
    assert set(options_of("linear", CamBeam())) == {"starts", "input_bias", *sensors}
    for structure in structure_names():
        for name, option in options_of(structure, CamBeam()).items():
            assert option.low <= option.default <= option.high, name


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (
            {"colour": 1},
            "structure black_box has no option colour; it has units, .*ridge, starts, input_bias",
        ),
        ({"units": 0}, "option units = 0 is outside 1 to 32"),
        ({"units": 2.5}, r"option units = 2\.5 must be a whole number"),
        ({"ridge": float("nan")}, "option ridge = nan is outside"),
    ],
)
def test_an_option_that_is_none_is_refused(options, reason):
    with pytest.raises(UserError, match=reason):
        build("black_box", CamBeam(), scales=SCALES, seed=0, options=options)


def test_options_are_written_as_name_and_number():
    assert parse(["units=8", " creep = 1e0"]) == {"units": 8.0, "creep": 1.0}
    assert parse([]) == {}
    for text in ("units", "units=", "units=many", "=8=9"):
        with pytest.raises(UserError, match="write NAME=NUMBER"):
            parse([text])


@pytest.mark.parametrize("structure", sorted(FROM_DATA))
def test_what_is_made_of_its_data_is_not_built_before_them(structure):
    with pytest.raises(UserError, match=f"structure {structure} is selected from data"):
        build(structure, CamBeam(), scales=SCALES, seed=0)


def test_an_unknown_structure_names_those_that_are_known():
    with pytest.raises(UserError, match="structure 'magic' is unknown; choose one of linear, stribeck"):
        build("magic", CamBeam(), scales=SCALES, seed=0)


@pytest.mark.parametrize("structure", sorted(set(structure_names()) - {"linear", "stribeck", "dahl", "lugre", "gray"}))
def test_a_learned_part_needs_its_design_and_its_weights(structure):
    system = started(structure, 0)
    for missing in ({"design": None}, {"weights": None}):
        given = {"design": system.design, "weights": system.weights, **missing}
        with pytest.raises(UserError, match=f"structure {structure}: .*missing"):
            assemble(structure, CamBeam(), **given)
    with pytest.raises(UserError):
        assemble(structure, CamBeam(), design=system.design, weights=system.weights[:-1])


def test_a_rig_of_positions_on_one_side_only_can_be_saved(tmp_path):
    """Records that never cross zero set a range on one side of it."""
    for low, high in ((0.02, 0.11), (-0.11, -0.02)):
        system = CamBeam().trained_on(np.array([low, -1.0]), np.array([high, 1.0]))
        system.check()
        assert (system.range_low, system.range_high) == (low, high)


def test_a_period_is_a_multiple_of_the_step():
    with pytest.raises(UserError, match=r"the period 0\.012 s is no multiple of the step 0\.005 s"):
        Sampling(step=0.005, period=0.012)


@pytest.mark.parametrize(
    ("step", "period"),
    [
        (0.0, 0.05),
        (-0.005, 0.05),
        (0.1, 0.05),
        (math.nan, 0.05),
        (0.005, math.nan),
        (0.005, math.inf),
        (math.inf, math.inf),
        (-math.inf, 0.05),
        (1e308, 1e308),
    ],
)
def test_step_and_period_are_numbers_above_zero(step, period):
    with pytest.raises(UserError, match=r"needs 0 < step <= period <= 1e\+06 s"):
        Sampling(step=step, period=period)


@pytest.mark.parametrize("step", [1e-9, 1e-300, 1e-320, 0.05 / 1001])
def test_a_period_has_no_more_steps_than_can_be_kept(step):
    with pytest.raises(UserError, match=r"more than 1000 of each period of 0\.05 s; take a longer step"):
        Sampling(step=step, period=0.05)
    assert Sampling(step=0.05 / 1000, period=0.05).every == 1000


def test_a_network_counts_with_every_weight():
    system, _ = build("hybrid", CamBeam(), scales=np.ones(3), seed=0)
    names = tuple(item.name for item in system.parameters if not item.fixed)
    physical = Model(
        rig="cam_beam",
        structure="hybrid",
        system=system,
        sampling=Sampling(),
        names=names,
        covariance=np.eye(len(names)),
        training_range={},
    )
    weights = 4 * (3 + 2)  # units: three features, a bias and an output weight each
    assert physical.free_numbers == len(names) + weights
    listed = dataclasses.replace(physical, names=(*names, *(f"weight_{i}" for i in range(weights))))
    assert listed.free_numbers == physical.free_numbers


@pytest.mark.parametrize("structure", ["gray", "hybrid"])
def test_no_spring_pushes_so_no_free_run_grows_without_bound(structure):
    """Ten minutes at full drive from far outside any record: a damped mass on a spring that pulls comes to rest."""
    system, _ = build(structure, CamBeam(), scales=np.array([0.1, 0.4, 5.0]), seed=0)
    bounds = {item.name: item.low for item in system.parameters}
    assert bounds["stiffness"] == 0.0
    system = system.trained_on(np.array([-0.1, -1.0]), np.array([0.1, 1.0]))
    start = np.zeros(len(system.states))
    start[:2] = 3.0, -20.0
    states = simulate(system, start, np.full((120_000, 1), 10.0), step=0.005, every=1000)
    np.testing.assert_allclose(states[-1, :2], states[-2, :2], atol=1e-6)


def test_a_model_of_a_rig_with_other_signals_is_refused(folder, monkeypatch):
    content, arrays = storage.load(folder, kind="model", version=FORMAT)
    body = {key: value for key, value in content.items() if key not in ("format", "arrays", "seal")}
    body["signals"]["inputs"] = ["drive [mV]"]
    storage.save(folder, kind="model", version=FORMAT, content=body, arrays=arrays)
    with pytest.raises(UserError, match=r"drive \[V\].*drive \[mV\]; fit again"):
        models.load(folder)


def test_the_shipped_model_is_read():
    assert evaluate_is_finite(models.load(Path(__file__).parents[1] / "trained" / "cam_beam" / "model"))


def evaluate_is_finite(model):
    states = simulate(model.system, np.zeros(2), np.full((100, 1), 2.0), step=model.sampling.step)
    return bool(np.isfinite(states).all())


LIGHT = """
import sys
from hybrid_sysid_ros import models
models.load(sys.argv[1])
heavy = ("torch", "sysidentpy", "scipy.optimize", "plotly", "hybrid_sysid_ros.identification")
assert not [name for name in heavy if name in sys.modules], [name for name in heavy if name in sys.modules]
"""


@pytest.mark.parametrize("structure", ["gray", "hybrid", *FURTHER])
def test_a_model_is_loaded_without_what_fits_it(structure, tmp_path):
    model_of(structure).save(tmp_path / "model")
    subprocess.run([sys.executable, "-c", LIGHT, tmp_path / "model"], check=True, timeout=120)

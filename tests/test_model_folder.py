"""Models as folders: what is saved is what is loaded, and a bad folder says what is wrong with it."""

import dataclasses
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
from hybrid_sysid_ros.models import storage, structure_names
from hybrid_sysid_ros.models.model import FORMAT
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from tests.model_samples import model_of
from tests.structures import FURTHER


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
for folder in sys.argv[1:]:
    models.load(folder)
heavy = ("torch", "sysidentpy", "scipy.optimize", "plotly", "hybrid_sysid_ros.identification")
assert not [name for name in heavy if name in sys.modules], [name for name in heavy if name in sys.modules]
"""


def test_models_are_loaded_without_what_fits_them(tmp_path):
    folders = [tmp_path / structure for structure in ("gray", "hybrid", *FURTHER)]
    for folder in folders:
        model_of(folder.name).save(folder)
    subprocess.run([sys.executable, "-c", LIGHT, *folders], check=True, timeout=120)

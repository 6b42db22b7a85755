"""An exported policy: what C and ONNX answer is what the policy answers."""

import ctypes
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.control.safety.certificate import Certificate, SeedCounts
from hybrid_sysid_ros.extensions.export import compiler, onnx_graph
from hybrid_sysid_ros.extensions.export import policy_folder as folder
from hybrid_sysid_ros.extensions.export.vectors import asked as vectors_of
from hybrid_sysid_ros.extensions.export.vectors import bounded, parts, vectors
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256
from tests.command_line import refused
from tests.small_policies import PROBLEM, TWO, correction_of, policy_of

SEAL = "0123abcd"
CORRECTION = correction_of(PROBLEM, hidden=(7,))
CAREFUL = replace(PROBLEM, rate_limits=(0.7,))
POLICIES = {
    "one input": policy_of(),
    "a plan": policy_of(hidden=(16,), plan=True),
    "a plan of limited rate": policy_of(hidden=(9, 6), problem=CAREFUL, plan=True),
    "a corrected plan": policy_of(hidden=(6,), problem=CAREFUL, plan=True, correction=CORRECTION),
    "two inputs": policy_of(hidden=(7, 6), problem=replace(TWO, rate_limits=(np.inf, 0.4)), plan=True),
    "two corrected inputs": policy_of(hidden=(6,), problem=TWO, correction=correction_of(TWO, plan=False)),
}

COMPILER = compiler.found() or ""
needs_compiler = pytest.mark.skipif(not COMPILER, reason="needs a C compiler: cc, gcc or clang")


@pytest.fixture(params=POLICIES)
def policy(request):
    return POLICIES[request.param]


@pytest.fixture
def command(call):
    """Run hybrid-sysid policy export with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid", "policy", "export")


def instances(policy, count=3000, seed=1):
    """Ordinary ones, ones far out, and every kind of number that is none at every place; with their answers."""
    random = np.random.default_rng(seed)
    n, m, p = policy.states, policy.inputs, policy.outputs
    parameters = 0 if policy.correction is None else 2
    size = n + 2 * m + policy.horizon * p
    asked = random.normal(size=(count, size + parameters))
    asked[:, n + m : n + 2 * m] *= 8.0  # previous inputs beyond their bounds
    asked[:, size:] = np.array([5.0, 2.0])[:parameters] + random.normal(size=(count, parameters))
    far = slice(count // 2, 3 * count // 4)
    asked[far] *= 10.0 ** random.uniform(-8, 8, (far.stop - far.start, 1))
    for k in range(3 * count // 4, count):
        asked[k, random.integers(size)] = random.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0])
        asked[k, size:] = random.choice([np.nan, np.inf, -np.inf, 1e300, 0.0], parameters)
    return asked, vectors_of(policy, asked)


def library(place, name):
    """The C functions, by ctypes."""
    path = place / "library.so"
    subprocess.run([COMPILER, "-std=c99", "-shared", "-fPIC", f"{place / name}.c", "-o", path, "-lm"], check=True)
    return ctypes.CDLL(str(path))


# C


@needs_compiler
def test_the_c_code_answers_as_the_policy_does_whatever_it_is_asked(policy, tmp_path):
    folder.write_export(policy, tmp_path / "out", name="policy", seal=SEAL, form="c")
    functions = library(tmp_path / "out", "policy")
    doubles = np.ctypeslib.ndpointer(dtype=float, flags="C")
    parameters = [doubles] if policy.correction is not None else []
    functions.policy.argtypes = [doubles] * 5 + parameters
    functions.policy_inside.argtypes = [doubles] * 4
    asked, known = instances(policy)
    assert 0.02 < np.mean(~known.answered) < 0.3
    assert 0.05 < np.mean(known.inside) < 0.9
    found = np.full_like(known.inputs, np.nan)
    for k, given in enumerate(zip(*parts(policy, asked), strict=True)):
        *instance, more = (np.ascontiguousarray(part).ravel() for part in given)
        answered = functions.policy(*instance, *([more] if parameters else []), found[k])
        assert answered == known.answered[k, 0]
        assert functions.policy_inside(*instance) == known.inside[k, 0]
    np.testing.assert_allclose(found, known.inputs, rtol=0.0, atol=1e-9)
    ordinary = np.max(np.abs(asked), axis=1) < 10.0
    np.testing.assert_allclose(found[ordinary], known.inputs[ordinary], rtol=0.0, atol=1e-12)
    assert np.all((found >= policy.problem.input_low) & (found <= policy.problem.input_high))


@needs_compiler
def test_the_c_code_compiles_without_a_warning_and_its_test_passes(policy, tmp_path):
    (check,) = folder.write_export(policy, tmp_path / "out", name="policy", seal=SEAL, form="c")
    assert float(check.largest_difference or 0.0) < 1e-12
    assert COMPILER in check.by
    strict = [*compiler.FLAGS, "-Werror", "-Wconversion", "-Wshadow", "-Wmissing-prototypes", "-Wdouble-promotion"]
    command = [COMPILER, *strict, "policy.c", "policy_test.c", "-o", "policy_test", "-lm"]
    subprocess.run(command, cwd=tmp_path / "out", check=True)
    reported = subprocess.run(
        ["./policy_test"], cwd=tmp_path / "out", check=True, capture_output=True, text=True
    ).stdout
    assert f"0 of {len(vectors(policy))} vectors wrong" in reported


@needs_compiler
@pytest.mark.parametrize("what", ["b2[1] = {\n    ", "input_high[1] = {\n    ", "lowest[8] = {\n    "])
def test_the_c_test_finds_a_wrong_number(what, tmp_path):
    folder.write_export(POLICIES["one input"], tmp_path / "out", name="policy", seal=SEAL, form="c")
    source = tmp_path / "out" / "policy.c"
    text = source.read_text()
    assert text.count(what) == 1
    source.write_text(text.replace(what, f"{what}4.0 + "))
    with pytest.raises(UserError, match="does not answer as the policy does"):
        compiler.run_test(COMPILER, tmp_path / "out", "policy", tmp_path)


@needs_compiler
def test_the_c_code_refuses_to_be_compiled_without_nan(tmp_path):
    folder.write_export(POLICIES["one input"], tmp_path / "out", name="policy", seal=SEAL, form="c")
    command = [COMPILER, "-ffast-math", "-c", "policy.c"]
    refused = subprocess.run(command, cwd=tmp_path / "out", capture_output=True, text=True, check=False)
    assert refused.returncode
    assert "compile without it" in refused.stderr


def test_without_a_compiler_the_c_code_is_written_and_said_to_be_unchecked(command, tmp_path, monkeypatch):
    POLICIES["one input"].save(tmp_path / "my policy")
    monkeypatch.setenv("PATH", str(tmp_path))
    status, out, _ = command(tmp_path / "my policy", tmp_path / "out", "--format", "c")
    assert status == 0
    assert "NOT CHECKED, for there is no C compiler here: cc -std=c99 -O2 my_policy.c" in out
    manifest = json.loads((tmp_path / "out" / "export.json").read_text())
    assert manifest["checks"] == [{"file": "my_policy.c", "by": "", "largest_difference": None}]


# ONNX


def test_the_graph_answers_as_the_policy_does_whatever_it_is_asked(policy, tmp_path):
    """By ONNX Runtime, which shares nothing with us."""
    runtime = pytest.importorskip("onnxruntime", reason="needs ONNX Runtime: install hybrid_sysid_ros[dev]")
    folder.write_export(policy, tmp_path / "out", name="policy", seal=SEAL, form="onnx")
    session = runtime.InferenceSession(tmp_path / "out" / "policy.onnx", providers=["CPUExecutionProvider"])
    asked, known = instances(policy)
    found = session.run(["inputs", "answered", "inside"], onnx_graph.feed(policy, asked))
    np.testing.assert_allclose(found[0], known.inputs, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(found[1], known.answered)
    np.testing.assert_array_equal(found[2], known.inside)


def test_the_graph_says_where_it_comes_from(tmp_path):
    onnx = pytest.importorskip("onnx", reason="needs ONNX: install hybrid_sysid_ros[export]")
    folder.write_export(POLICIES["a corrected plan"], tmp_path / "out", name="policy", seal=SEAL, form="onnx")
    whole = onnx.load(tmp_path / "out" / "policy.onnx")
    reported = {item.key: item.value for item in whole.metadata_props}
    assert reported["policy"] == SEAL
    assert reported["model"] == POLICIES["a corrected plan"].model
    assert (reported["rig"], reported["period"], reported["rate_limit"]) == ("cam_beam", "0.05 s", "0.7 a period")
    assert reported["state"] == "position [rad], velocity [rad/s]"
    assert [item.name for item in whole.graph.input] == ["x", "d", "u_previous", "preview", "parameters"]


def test_what_is_exported_carries_the_certificate_of_the_network(tmp_path):
    policy = POLICIES["a plan"]
    assert folder.about(policy, SEAL)["certificate"] == "none"
    failed = {"steps": {"input": 3, "all": 3}, "rests": {"input": 0, "all": 0}}
    counts = SeedCounts(
        seed=0, loops={"steps": 10_000, "rests": 10_000}, failed={"network": failed}, check={}, exact={}, made={}
    )
    certificate = Certificate(
        policy=SEAL,
        model=policy.model,
        delta=0.03,
        distribution={},
        criteria={},
        ledger=[counts],
        worst=[],
    )
    folder.write_export(replace(policy, certificate=certificate), tmp_path / "out", name="policy", seal=SEAL, form="c")
    said = "certificate: 20000 loops; rate at least 0.9989 in steps (delta 0.03)"
    assert said in (tmp_path / "out" / "policy.h").read_text()


def test_without_onnx_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(
        UserError, match=r"onnx is missing; install the extra: pip install 'hybrid_sysid_ros\[export\]'"
    ):
        folder.write_export(POLICIES["one input"], tmp_path / "out", name="policy", seal=SEAL)
    assert not (tmp_path / "out").exists()


# What it is held against


def test_plans_are_bounded_one_after_the_other():
    """By hand: from 9.5 at most 0.7 a step, at most 10."""
    answers = np.array([[20.0, 20.0, 0.0, 9.4], [-3.0, 9.0, 9.1, 9.2]])[:, :, None]
    inputs = bounded(answers, np.array([[9.5], [44.0]]), CAREFUL)
    np.testing.assert_allclose(inputs[:, :, 0], [[10.0, 10.0, 9.3, 9.4], [9.3, 9.0, 9.1, 9.2]])


@pytest.mark.parametrize("form", ["onnx", pytest.param("c", marks=needs_compiler)])
@pytest.mark.parametrize("place", ["features", "inputs"])
def test_a_tampered_vector_is_found_and_nothing_is_written(form, place, tmp_path):
    policy = POLICIES["a plan"]
    folder.write_export(policy, tmp_path / "out", name="policy", seal=SEAL, form=form)
    before = sha256(tmp_path / "out")
    features, inputs = policy.check[0].copy(), policy.check[1].copy()
    {"features": features, "inputs": inputs}[place][3, 0] += 1e-6
    with pytest.raises(UserError, match="policy"):
        folder.write_export(
            replace(policy, check=(features, inputs)), tmp_path / "out", name="policy", seal=SEAL, form=form
        )
    assert sha256(tmp_path / "out") == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_vectors_are_those_of_the_policy_and_the_edge_of_what_may_be_asked():
    policy = POLICIES["a corrected plan"]
    made = vectors(policy)
    known = len(policy.check[1])
    assert np.all(made.answered[:known])
    np.testing.assert_allclose(
        made.inputs[:known, 0, 0], np.clip(policy.check[1][:, 0, 0], *_near(made, known)), atol=1e-12
    )
    spoilt = ~np.all(np.isfinite(made.instances[:, :8]), axis=1)
    np.testing.assert_array_equal(made.answered[:, 0], ~spoilt)
    assert np.all(np.any(~np.isfinite(made.instances), axis=0))  # at every place
    assert np.any(np.abs(made.instances[:, 3]) > 10.0)
    assert np.any(made.instances[:, 8:] != CORRECTION.nominal)


def _near(made, known):
    """Bounds of the first inputs: within the rate's of the previous ones."""
    previous = np.clip(made.instances[:known, 3], -10.0, 10.0)
    return np.maximum(previous - 0.7, -10.0), np.minimum(previous + 0.7, 10.0)


# Files


def test_the_manifest_vouches_for_every_file(tmp_path):
    POLICIES["a plan"].save(tmp_path / "policy")
    folder.export(tmp_path / "policy", tmp_path / "out")
    manifest = json.loads((tmp_path / "out" / "export.json").read_text())
    assert set(manifest["files"]) == {"policy.onnx", "policy.h", "policy.c", "policy_test.c"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*manifest["files"], "export.json"}
    for name, digest in manifest["files"].items():
        assert sha256(tmp_path / "out" / name) == digest
    example = manifest["vectors"]["examples"][0]
    plan = POLICIES["a plan"].control(example["x"], example["d"], example["u_previous"], example["preview"])
    np.testing.assert_allclose(plan.inputs, example["inputs"], atol=1e-12)
    assert manifest["vectors"]["tolerance"] == 1e-9


def test_an_export_replaces_an_older_one_and_nothing_else(tmp_path):
    policy = POLICIES["one input"]
    policy.save(tmp_path / "policy")
    folder.export(tmp_path / "policy", tmp_path / "out", form="onnx")
    with pytest.raises(UserError, match="--overwrite"):
        folder.export(tmp_path / "policy", tmp_path / "out", form="c")
    folder.export(tmp_path / "policy", tmp_path / "out", form="c", overwrite=True)
    assert not (tmp_path / "out" / "policy.onnx").exists()
    with pytest.raises(UserError, match="other files"):
        folder.export(tmp_path / "policy", tmp_path / "policy")
    with pytest.raises(UserError, match="no such policy folder"):
        folder.export(tmp_path / "none", tmp_path / "out", overwrite=True)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("policy", "policy"),
        ("My Policy-2", "my_policy_2"),
        ("cam_beam", "policy_cam_beam"),
        ("double", "policy_double"),
        ("tanh", "policy_tanh"),
        ("2nd_policy", "policy_2nd_policy"),
        ("__policy__", "policy"),
        ("größe.v1", "policy_gr_e_v1"),
        ("⛐", "policy"),
        ("x" * 200 + "policy", "policy_" + "x" * 48),
    ],
)
def test_any_folder_s_name_makes_an_identifier(given, name):
    assert folder.identifier(given) == name


@needs_compiler
@pytest.mark.parametrize("given", ["double", "int main(void)", "2nd policy; rm -rf", 'a"b\\c%s*/', "größe"])
def test_odd_names_of_folders_compile(given, tmp_path):
    POLICIES["one input"].save(tmp_path / given)
    (check,) = folder.export(tmp_path / given, tmp_path / "out folder", form="c")
    assert COMPILER in check.by


@needs_compiler
def test_the_shipped_policy_is_exported_both_ways(command, tmp_path):
    status, out, error = command(configuration.shipped("cam_beam", "policy"), tmp_path / "out")
    assert (status, error) == (0, "")
    lines = out.splitlines()
    assert [line.split(":")[0] for line in lines] == [str(tmp_path / "out" / f"policy.{end}") for end in ("onnx", "c")]
    assert all("answers as the policy does" in line for line in lines)


def test_an_unknown_format_is_refused(command, tmp_path):
    refused(command(tmp_path, tmp_path, "--format", "pickle"), "'pickle' is not one of 'onnx', 'c', 'both'")


@needs_compiler
def test_a_compiler_that_fails_is_named(tmp_path, monkeypatch):
    (tmp_path / "cc").write_text("#!/bin/sh\necho no libc >&2\nexit 1\n")
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with pytest.raises(UserError, match=r"policy\.c: cc does not compile it: no libc"):
        folder.write_export(POLICIES["one input"], tmp_path / "out", name="policy", seal=SEAL, form="c")
    assert not (tmp_path / "out").exists()

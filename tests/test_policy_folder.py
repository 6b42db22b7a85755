"""The folder of a policy: what it holds comes back, and what was altered is refused."""

import numpy as np
import pytest
from small_policies import SEAL, model_of, policy_of, questions  # type: ignore[import-not-found]

from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError


@pytest.fixture
def folder(tmp_path):
    policy_of().save(tmp_path / "policy")
    return tmp_path / "policy"


def test_a_policy_answers_the_same_after_a_round_trip(folder):
    policy, back = policy_of(), policies.load(folder)
    for question in questions(200):
        assert back.control(*question).input[0] == policy.control(*question).input[0]
    assert back.problem == policy.problem
    assert back.training == policy.training
    assert (back.horizon, back.period, back.rig) == (4, 0.05, "cam_beam")
    back.save(folder.parent / "again")
    assert storage.digest(folder.parent / "again", kind="policy") == storage.digest(folder, kind="policy")


def sealed(change):
    def apply(folder):
        content, arrays = storage.load(folder, kind="policy", version=policies.FORMAT)
        change(content, arrays)
        body = {key: value for key, value in content.items() if key not in ("format", "arrays", "seal")}
        storage.save(folder, kind="policy", version=policies.FORMAT, content=body, arrays=arrays)

    return apply


def old(folder):
    content, arrays = storage.load(folder, kind="policy", version=policies.FORMAT)
    body = {key: value for key, value in content.items() if key not in ("format", "arrays", "seal")}
    storage.save(folder, kind="policy", version=1, content=body, arrays=arrays)


def nudge(content, arrays):
    arrays["W1"][0, 0] += 1e-6


def flip_a_bit(folder):
    path = folder / "weights.safetensors"
    content = bytearray(path.read_bytes())
    content[-5] ^= 4
    path.write_bytes(content)


BAD = {
    "altered arrays": (flip_a_bit, r"weights\.safetensors: was altered"),
    "older format": (
        old,
        r"policy\.yaml: format 1 is older than 2; make the policy again \(hybrid-sysid policy train\)",
    ),
    "no arrays": (lambda folder: (folder / "weights.safetensors").unlink(), r"weights\.safetensors: is missing"),
    "no yaml": (lambda folder: (folder / "policy.yaml").unlink(), r"policy\.yaml: is missing"),
    "sealed arrays": (sealed(nudge), r"policy\.yaml: does not reproduce its self-check"),
    "weights of NaN": (sealed(lambda c, a: a["b0"].fill(np.nan)), r"policy\.yaml: does not reproduce its self-check"),
    "no self-check": (
        sealed(lambda c, a: a.update(check_features=np.zeros((0, 8)), check_inputs=np.zeros((0, 1)))),
        r"policy\.yaml: .*self-check",
    ),
    "wrong self-check": (sealed(lambda c, a: a.update(check_features=np.zeros((5, 3)))), r"policy\.yaml: .*self-check"),
    "missing layer": (sealed(lambda c, a: a.pop("W2")), r"policy\.yaml: .*W2"),
    "too few layers": (
        sealed(lambda c, a: c.update(layers=2)),
        r"policy\.yaml: policy: 3 outputs are neither 1 nor the horizon",
    ),
    "other shape": (sealed(lambda c, a: a.update(W1=np.zeros((3, 4)))), r"policy\.yaml: network: a layer of 5 units"),
    "other horizon": (
        sealed(lambda c, a: c["problem"].update(horizon=5)),
        r"policy\.yaml: policy: a network of 8 features",
    ),
    "bad problem": (sealed(lambda c, a: c["problem"].update(period=-1.0)), r"policy\.yaml: mpc: period is -1"),
    "missing key": (sealed(lambda c, a: c.pop("problem")), r"policy\.yaml: .*problem"),
    "other output": (sealed(lambda c, a: c.update(output=7)), r"policy\.yaml: .*output"),
    "no scale": (sealed(lambda c, a: a["scale"].fill(0.0)), r"policy\.yaml: policy: centre and scale"),
    "no range": (sealed(lambda c, a: a.pop("range_low")), r"policy\.yaml: .*range_low"),
    "empty range": (sealed(lambda c, a: a["range_low"].fill(9.0)), r"policy\.yaml: policy: the training range"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_folder_gives_one_line_that_names_the_file(folder, case):
    spoil, reason = BAD[case]
    spoil(folder)
    with pytest.raises(UserError, match=reason) as raised:
        policies.load(folder)
    assert "\n" not in str(raised.value)
    assert str(folder) in str(raised.value)


def test_a_policy_for_another_model_is_refused(folder):
    assert policies.load(folder, model=model_of(SEAL)).model == SEAL
    with pytest.raises(UserError, match=r"policy\.yaml: was trained for another model"):
        policies.load(folder, model=model_of("0ther"))

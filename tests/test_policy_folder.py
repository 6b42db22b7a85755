"""The folder of a policy: what it holds comes back, and what was altered is refused."""

import numpy as np
import pytest
from small_policies import PROBLEM, SEAL, TWO, instances, model_of, policy_of  # type: ignore[import-not-found]

from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError


@pytest.fixture
def folder(tmp_path):
    policy_of().save(tmp_path / "policy")
    return tmp_path / "policy"


@pytest.mark.parametrize("problem", [PROBLEM, TWO], ids=["one input", "two inputs"])
def test_a_policy_answers_the_same_after_a_round_trip(problem, tmp_path):
    policy = policy_of(problem=problem, plan=True)
    policy.save(tmp_path / "policy")
    back = policies.load(tmp_path / "policy")
    for instance in instances(200, problem):
        np.testing.assert_array_equal(back.control(*instance).inputs, policy.control(*instance).inputs)
    assert back.problem == policy.problem
    assert back.training == policy.training
    back.save(tmp_path / "again")
    assert storage.digest(tmp_path / "again", kind="policy") == storage.digest(tmp_path / "policy", kind="policy")


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
    "altered arrays": (flip_a_bit, "weights.safetensors"),
    "older format": (old, "hybrid-sysid policy train"),
    "no arrays": (lambda folder: (folder / "weights.safetensors").unlink(), "weights.safetensors"),
    "no yaml": (lambda folder: (folder / "policy.yaml").unlink(), "policy.yaml"),
    "sealed arrays": (sealed(nudge), "self-check"),
    "weights of NaN": (sealed(lambda c, a: a["b0"].fill(np.nan)), "array b0 holds numbers that are not finite"),
    "weights of truths": (sealed(lambda c, a: a.update(W0=a["W0"] > 0)), "array W0 is of kind bool"),
    "output map of NaN": (sealed(lambda c, a: a["output_map"].fill(np.nan)), "array output_map"),
    "flat layer": (sealed(lambda c, a: a.update(W1=a["W1"].ravel())), "array W1 has the shape"),
    "no self-check": (
        sealed(lambda c, a: a.update(check_features=np.zeros((0, 8)), check_inputs=np.zeros((0, 1, 1)))),
        "self-check",
    ),
    "wrong self-check": (sealed(lambda c, a: a.update(check_features=np.zeros((5, 3)))), "self-check"),
    "missing layer": (sealed(lambda c, a: a.pop("W2")), "W2"),
    "too few layers": (sealed(lambda c, a: c.update(layers=2)), "3 answers"),
    "other shape": (sealed(lambda c, a: a.update(W1=np.zeros((3, 4)))), "layer of 5 units"),
    "other horizon": (sealed(lambda c, a: c["problem"].update(horizon=5)), "8 features"),
    "horizon with a point": (sealed(lambda c, a: c["problem"].update(horizon=3.0)), "horizon is 3.0"),
    "bad problem": (sealed(lambda c, a: c["problem"].update(period=-1.0)), "period is -1"),
    "half a problem": (sealed(lambda c, a: c["problem"].update(rate_weights=[1.0, 2.0])), "each input"),
    "missing key": (sealed(lambda c, a: c.pop("problem")), "problem"),
    "other output map": (sealed(lambda c, a: a.update(output_map=np.zeros((2, 2)))), "output map"),
    "no scale": (sealed(lambda c, a: a["scale"].fill(0.0)), "scale"),
    "no range": (sealed(lambda c, a: a.pop("range_low")), "range_low"),
    "empty range": (sealed(lambda c, a: a["range_low"].fill(9.0)), "training range"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_folder_gives_one_line_that_names_the_file_and_the_fault(folder, case):
    spoil, reason = BAD[case]
    spoil(folder)
    with pytest.raises(UserError) as raised:
        policies.load(folder)
    assert "\n" not in str(raised.value)
    assert str(folder) in str(raised.value)
    assert reason in str(raised.value)


def test_a_policy_for_another_model_is_refused(folder):
    assert policies.load(folder, model=model_of(SEAL)).model == SEAL
    with pytest.raises(UserError, match="another model"):
        policies.load(folder, model=model_of("0ther"))

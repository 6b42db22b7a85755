"""The approximate MPC: the network it claims to be, the folder it lives in, and the MPC it imitates."""

import dataclasses
import os
from itertools import pairwise

import numpy as np
import pytest

from hybrid_sysid_ros import configuration, models
from hybrid_sysid_ros.control import ExactMpc, Problem, Status
from hybrid_sysid_ros.control import policy as policies
from hybrid_sysid_ros.control.closed_loop import run_loop
from hybrid_sysid_ros.control.policy import Policy
from hybrid_sysid_ros.control.sample_store import SampleStore
from hybrid_sysid_ros.control.sampling import Samples, Spread, sample
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.models import Model, Sampling, storage
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.rigs.excitation import hardware_reference
from hybrid_sysid_ros.rigs.plant import Plant

PROBLEM = Problem(
    horizon=4,
    period=0.05,
    substeps=10,
    output_weight=100.0,
    rate_weight=1.0,
    input_limit=10.0,
    output_scale=0.0227,
    smoothing=0.005,
    max_iterations=50,
)
SPREAD = Spread(amplitude=4.0, disturbance=0.3, input_jitter=1.0, kick=(0.01, 0.2))
SEAL = "5ea1"


def policy_of(seed=0, widths=(8, 5, 3, 1)):
    """A network of random weights with self-check vectors that are its own answers."""
    random = np.random.default_rng(seed)
    layers = tuple(
        (random.normal(size=(after, before)) / np.sqrt(before), random.normal(size=after) / 5)
        for before, after in pairwise(widths)
    )
    bare = Policy(
        problem=PROBLEM,
        model=SEAL,
        rig="cam_beam",
        states=2,
        output=0,
        centre=random.normal(size=8) / 7,
        scale=random.uniform(0.1, 3.0, 8),
        layers=layers,
        training={"seed": seed},
    )
    features = random.normal(size=(20, 8))
    return dataclasses.replace(bare, check=(features, by_hand(bare, features)))


def by_hand(policy, features):
    """The network in matrices: standardised features, tanh layers, a straight output in units of the limit."""
    signal = (features - policy.centre) / policy.scale
    for matrix, bias in policy.layers[:-1]:
        signal = np.tanh(signal @ matrix.T + bias)
    matrix, bias = policy.layers[-1]
    return policy.problem.input_limit * (signal @ matrix.T + bias)[:, 0]


def questions(count, seed=0):
    random = np.random.default_rng(seed)
    for _ in range(count):
        state, preview = random.normal(size=2) * [0.05, 0.3], 0.08 * random.normal(size=4)
        yield state, random.normal(size=1), 5 * random.normal(size=1), preview


def test_it_is_the_network_of_its_layers():
    policy = policy_of()
    for state, d, previous, preview in questions(50):
        features = np.concatenate([state, d, previous, preview - state[0]])
        expected = np.clip(by_hand(policy, features[None])[0], -10.0, 10.0)
        plan = policy.control(state, d, previous, preview)
        assert plan.input[0] == pytest.approx(expected, rel=1e-12)
        assert plan.status is Status.POLICY


def test_it_answers_errors_of_the_reference_and_not_where_the_beam_is():
    """Features are q - y: at the same error elsewhere only the position itself makes a difference."""
    policy = policy_of()
    blind = dataclasses.replace(
        policy, layers=((policy.layers[0][0] * (np.arange(8) > 0), policy.layers[0][1]), *policy.layers[1:])
    )
    state, d, previous, preview = next(questions(1))
    moved = blind.control(state + np.array([0.1, 0.0]), d, previous, preview + 0.1)
    np.testing.assert_allclose(moved.input, blind.control(state, d, previous, preview).input, rtol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e12])
@pytest.mark.parametrize("place", ["position", "velocity", "disturbance", "previous input", "preview"])
def test_the_input_is_finite_and_bounded_whatever_it_is_asked(place, value):
    policy = policy_of()
    for state, d, previous, preview in questions(5):
        target = {"position": state[:1], "velocity": state[1:], "disturbance": d, "previous input": previous}
        target.get(place, preview)[:1] = value
        plan = policy.control(state, d, previous, preview)
        assert np.isfinite(plan.input[0])
        assert abs(plan.input[0]) <= 10.0
        if not np.isfinite(value):
            # What is not a number says nothing: the input before, or none.
            assert plan.status is Status.HELD
            assert plan.input[0] == (np.clip(previous[0], -10, 10) if place != "previous input" else 0.0)


def test_an_input_held_is_within_its_bounds():
    state, d, _, preview = next(questions(1))
    plan = policy_of().control(state * np.nan, d, np.array([55.0]), preview)
    assert plan.input[0] == 10.0


# The folder


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
        content, arrays = storage.load(folder, kind="policy", version=1)
        change(content, arrays)
        body = {key: value for key, value in content.items() if key not in ("format", "arrays", "seal")}
        storage.save(folder, kind="policy", version=1, content=body, arrays=arrays)

    return apply


def nudge(content, arrays):
    arrays["W1"][0, 0] += 1e-6


def flip_a_bit(folder):
    path = folder / "weights.safetensors"
    content = bytearray(path.read_bytes())
    content[-5] ^= 4
    path.write_bytes(content)


BAD = {
    "altered arrays": (flip_a_bit, r"weights\.safetensors: was altered"),
    "no arrays": (lambda folder: (folder / "weights.safetensors").unlink(), r"weights\.safetensors: is missing"),
    "no yaml": (lambda folder: (folder / "policy.yaml").unlink(), r"policy\.yaml: is missing"),
    "sealed arrays": (sealed(nudge), r"policy\.yaml: does not reproduce its self-check"),
    "weights of NaN": (sealed(lambda c, a: a["b0"].fill(np.nan)), r"policy\.yaml: does not reproduce its self-check"),
    "no self-check": (
        sealed(lambda c, a: a.update(check_features=np.zeros((0, 8)), check_inputs=np.zeros(0))),
        r"policy\.yaml: .*self-check",
    ),
    "wrong self-check": (sealed(lambda c, a: a.update(check_features=np.zeros((5, 3)))), r"policy\.yaml: .*self-check"),
    "missing layer": (sealed(lambda c, a: a.pop("W2")), r"policy\.yaml: .*W2"),
    "too few layers": (sealed(lambda c, a: c.update(layers=2)), r"policy\.yaml: policy: 8 features don't fit"),
    "other shape": (sealed(lambda c, a: a.update(W1=np.zeros((3, 4)))), r"policy\.yaml: policy: a layer has shape"),
    "other horizon": (sealed(lambda c, a: c["problem"].update(horizon=5)), r"policy\.yaml: policy: 8 features"),
    "bad problem": (sealed(lambda c, a: c["problem"].update(period=-1.0)), r"policy\.yaml: mpc: period is -1"),
    "missing key": (sealed(lambda c, a: c.pop("problem")), r"policy\.yaml: .*problem"),
    "other output": (sealed(lambda c, a: c.update(output=7)), r"policy\.yaml: .*output"),
    "no scale": (sealed(lambda c, a: a["scale"].fill(0.0)), r"policy\.yaml"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_folder_gives_one_line_that_names_the_file(folder, case):
    spoil, reason = BAD[case]
    spoil(folder)
    with pytest.raises(UserError, match=reason) as raised:
        policies.load(folder)
    assert "\n" not in str(raised.value)
    assert str(folder) in str(raised.value)


def model_of(seal=""):
    equation = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
    names = tuple(item.name for item in equation.parameters)
    return Model(
        rig="cam_beam",
        structure="linear",
        equation=equation,
        sampling=Sampling(),
        names=names,
        covariance=np.eye(len(names)),
        training_range={},
        seal=seal,
    )


def test_a_policy_for_another_model_is_refused(folder):
    assert policies.load(folder, model=model_of(SEAL)).model == SEAL
    with pytest.raises(UserError, match=r"policy\.yaml: was trained for another model"):
        policies.load(folder, model=model_of("0ther"))


# Samples of the exact MPC


def test_samples_are_answers_of_the_exact_mpc():
    model = model_of()
    samples = sample(model.equation, PROBLEM, SPREAD, 7)
    assert len(samples.inputs) + samples.dropped == round(8.0 / PROBLEM.period)
    assert np.all(np.abs(samples.inputs) <= 10.0)
    assert np.max(np.abs(samples.previews)) <= 4.0 * PROBLEM.output_scale * (1 + 1e-9)
    assert np.ptp(samples.disturbances) == 0.0
    expert = ExactMpc(model.equation, PROBLEM)
    for k in range(0, len(samples.inputs), 10):
        expert.reset()
        again = expert.control(
            samples.states[k], samples.disturbances[k : k + 1], samples.previous[k : k + 1], samples.previews[k]
        )
        assert again.input[0] == pytest.approx(samples.inputs[k], abs=2e-3)


def test_a_solver_that_never_converges_gives_no_samples(rig):
    hopeless = dataclasses.replace(PROBLEM, max_iterations=1)
    samples = sample(rig.equation, hopeless, SPREAD, 7)
    assert len(samples.inputs) + samples.dropped == round(8.0 / PROBLEM.period)
    assert samples.dropped > 100


def some_samples(seed):
    random = np.random.default_rng(seed)
    return Samples(
        states=random.normal(size=(5, 2)),
        disturbances=random.normal(size=5),
        previous=random.normal(size=5),
        previews=random.normal(size=(5, 4)),
        inputs=random.normal(size=5),
        dropped=3,
    )


def nothing_solved():
    none = {name: getattr(some_samples(0), name)[:0] for name in Samples.__dataclass_fields__ if name != "dropped"}
    return Samples(**none, dropped=160)


def test_stored_samples_are_found_again_if_their_purpose_is_the_same(tmp_path):
    store = SampleStore(tmp_path / "samples", "a model")
    assert store.find(1) is None
    store.keep(1, some_samples(1))
    found = SampleStore(tmp_path / "samples", "a model").find(1)
    assert found is not None
    for name in ("states", "disturbances", "previous", "previews", "inputs"):
        np.testing.assert_array_equal(getattr(found, name), getattr(some_samples(1), name))
    assert found.dropped == 3
    assert SampleStore(tmp_path / "samples", "another model").find(1) is None
    assert store.find(2) is None
    (file,) = (tmp_path / "samples").iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert store.find(1) is None
    store.remove()
    assert not (tmp_path / "samples").exists()


# Training


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A tiny training: a linear beam, nine closed loops in two rounds; twice, by different ways to the same samples."""
    training = pytest.importorskip("hybrid_sysid_ros.control.policy_training", exc_type=ImportError)
    settings = training.Settings(
        episodes=(6, 3), hidden=(16,), epochs=60, batch=128, workers=min(2, os.cpu_count() or 1)
    )
    model = model_of(SEAL)
    store = SampleStore(tmp_path_factory.mktemp("store") / "samples", "tiny")
    first = training.train(model, PROBLEM, SPREAD, settings, seed=1, store=store)
    again = training.train(model, PROBLEM, SPREAD, settings, seed=1, store=store)
    return first, again


def test_a_tiny_training_imitates_better_than_a_constant(trained):
    policy, _ = trained
    fresh = sample(model_of().equation, PROBLEM, SPREAD, 424242)
    rows = zip(fresh.states, fresh.disturbances, fresh.previous, fresh.previews, strict=True)
    answers = [policy.control(x, np.array([d]), np.array([u]), q).input[0] for x, d, u, q in rows]
    assert np.mean((np.array(answers) - fresh.inputs) ** 2) < 0.3 * np.var(fresh.inputs)


def test_a_training_tells_how_it_was_made(trained):
    record = trained[0].training
    assert record["rounds"] == [6, 3]
    assert record["samples"] + record["validation_samples"] + record["dropped"] == 9 * 160
    assert 0 < record["train_mse"] < 100
    assert record["validation_mse"] > 0
    assert trained[0].model == SEAL


def test_a_seed_decides_a_training(trained):
    first, again = trained
    for (w, b), (w_again, b_again) in zip(first.layers, again.layers, strict=True):
        np.testing.assert_array_equal(w, w_again)
        np.testing.assert_array_equal(b, b_again)


def test_the_network_of_torch_answers_the_same_without_torch(trained, tmp_path):
    policy, _ = trained
    assert len(policy.check[1]) > 30  # of torch itself
    np.testing.assert_allclose(by_hand(policy, policy.check[0]), policy.check[1], atol=1e-9)
    policy.save(tmp_path / "policy")
    policies.load(tmp_path / "policy", model=model_of(SEAL))


def test_a_training_without_loops_to_hold_out_or_without_answers_is_refused(tmp_path):
    training = pytest.importorskip("hybrid_sysid_ros.control.policy_training", exc_type=ImportError)
    store = SampleStore(tmp_path / "samples", "hopeless")
    settings = training.Settings(episodes=(2,), epochs=1, workers=1)
    for seed in (0, 1):
        store.keep(seed, nothing_solved())
    with pytest.raises(UserError, match="the exact MPC found no solution"):
        training.train(model_of(SEAL), PROBLEM, SPREAD, settings, seed=0, store=store)
    for episodes in ((), (1,), (5, 0)):
        with pytest.raises(UserError, match="at least 2 closed loops in every round"):
            training.Settings(episodes=episodes)


# What is shipped


@pytest.fixture(scope="module")
def shipped():
    model = models.load(configuration.shipped("cam_beam", "model"))
    return model, policies.load(configuration.shipped("cam_beam", "policy"), model=model)


def test_the_shipped_policy_imitates_the_exact_mpc_of_the_shipped_model(shipped):
    model, policy = shipped
    expert = ExactMpc(model.equation, policy.problem)
    errors = []
    for row in policy.check[0][::4]:
        state, d, previous, preview = row[:2], row[2:3], row[3:4], row[4:] + row[0]
        expert.reset()
        exact = expert.control(state, d, previous, preview)
        errors.append(policy.control(state, d, previous, preview).input[0] - exact.input[0])
    assert np.sqrt(np.mean(np.square(errors))) < 0.5


def test_the_shipped_policy_tracks_the_author_s_reference(shipped, rig):
    """On the noisy plant at 200 Hz: at most .50 V on the steps and .10 V on the sine; the rig: 1.080 and .500."""
    model, policy = shipped
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    latency = 0.001
    loop = run_loop(
        Plant(rig, seed=5, bias=0.03),
        ExtendedKalmanFilter(model.equation, tuning, period=0.005, latency=latency),
        policy,
        hardware_reference,
        duration=51.0,
        period=0.005,
        lead=model.equation.delay + latency,
    )
    scale = rig.sensor.radians_per_volt
    assert loop.tracking_rmse(0.0, 29.0) / scale <= 0.50
    assert loop.tracking_rmse(30.0, 50.0) / scale <= 0.10
    at_rest = np.mean(loop.position[loop.time > 50.7]) / scale
    assert at_rest == pytest.approx(0.0, abs=0.05)
    assert loop.statuses == {Status.POLICY: 10_200}

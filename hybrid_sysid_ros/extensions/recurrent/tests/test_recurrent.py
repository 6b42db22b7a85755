"""The recurrent network: three forms that agree, a bound that holds, and training on a system of known motion."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.linalg import expm

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Variable, one_step, simulate
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.extensions.recurrent.recurrent import Recurrent, step_within
from hybrid_sysid_ros.extensions.recurrent.training import TrainingSchedule, rollout, train_network, untrained
from hybrid_sysid_ros.identification import free_run, prepare, score
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear, recurrent

SAMPLING = Sampling(step=0.05)


def network(units=5, seed=0, **more):
    """A network whose weights all matter."""
    system = recurrent(units, **more)
    return system.with_weights(np.random.default_rng(seed).normal(size=len(system.weights)))


def by_hand(system, x, u):
    """One step as Cho et al. write it, in matrices."""
    parts, units = system.parts(system.weights), system.units
    h = x[2:]
    driven = parts["drive"] @ np.atleast_1d(u / system.scales[2]) + parts["bias"]
    r, k, n = (slice(i * units, (i + 1) * units) for i in range(3))

    def sigmoid(a):
        return 1 / (1 + np.exp(-a))

    reset = sigmoid(driven[r] + parts["recurrent"][r] @ h)
    keep = sigmoid(driven[k] + parts["recurrent"][k] @ h)
    new = np.tanh(driven[n] + reset * (parts["recurrent"][n] @ h + parts["reset_bias"]))
    after = keep * h + (1 - keep) * new
    (position,) = system.scales[0] * (parts["readout"] @ after + parts["readout_bias"])
    return np.array([position, (position - x[0]) / system.period, *after])


def test_the_compiled_and_the_casadi_form_are_the_textbook_step():
    system, random = network(period=0.05), np.random.default_rng(1)
    symbolic = symbolic_step(system, step=0.05)
    for _ in range(100):
        x, u = random.uniform(-1, 1, 7), random.normal(size=1) * 6.0
        following = one_step(system, x, u, step=0.05)
        np.testing.assert_allclose(following, by_hand(system, x, u), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(np.array(symbolic(x, u)).ravel(), following, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("period", "step"), [(0.05, 0.025), (0.1, 0.025), (0.02, 0.02), (0.01, 0.01), (0.03, 0.015), (0.06, 0.02)]
)
def test_a_network_steps_by_a_whole_part_of_any_period(period, step):
    assert Sampling(step=step_within(period), period=period).step == pytest.approx(step)


def test_torch_simulates_as_the_compiled_form_does():
    torch = pytest.importorskip("torch")
    system, random = network(period=0.025), np.random.default_rng(2)
    starts, inputs = random.normal(size=(4, 2)) * [0.05, 0.2], random.normal(size=(60, 4, 1)) * 5.0
    expected = []
    for i in range(4):
        start = system.record_map().states_from_record(starts[i : i + 1, :1], starts[i : i + 1, 1:], inputs[:1, i])[0]
        expected.append(simulate(system, start, np.ascontiguousarray(inputs[:, i]), step=0.025, every=2)[1:, 0])
    found = rollout(system, torch.from_numpy(system.weights), starts, inputs, 2)
    np.testing.assert_allclose(found.numpy()[:, :, 0], np.transpose(expected), rtol=1e-10, atol=1e-13)


def test_all_forms_agree_with_several_inputs_and_outputs():
    torch = pytest.importorskip("torch")
    random = np.random.default_rng(5)
    names = [tuple(Variable(name=f"{kind}_{i}", unit="V") for i in range(2)) for kind in "yu"]
    system = Recurrent(units=4, outputs=names[0], inputs=names[1], scales=(0.5, 2.0, 1.0, 3.0, 4.0, 0.5))
    system = system.with_weights(random.normal(size=len(system.weights)))
    symbolic = symbolic_step(system, step=0.05)
    for _ in range(20):
        x, u = random.uniform(-1, 1, 8), random.normal(size=2)
        np.testing.assert_allclose(one_step(system, x, u, step=0.05), np.array(symbolic(x, u)).ravel(), rtol=1e-12)
    starts, inputs = random.normal(size=(1, 4)), random.normal(size=(40, 1, 2))
    start = system.record_map().states_from_record(starts[:, :2], starts[:, 2:], inputs[:1, 0])[0]
    expected = simulate(system, start, np.ascontiguousarray(inputs[:, 0]), step=0.05)[1:, :2]
    found = rollout(system, torch.from_numpy(system.weights), starts, inputs, 1)
    np.testing.assert_allclose(found.numpy()[:, 0], expected, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("drive", [1e6, -1e6, 1e300])
def test_no_input_drives_the_position_beyond_its_bound(drive):
    system = network()
    parts = system.parts(system.weights)
    bound = system.scales[0] * (np.abs(parts["readout"]).sum() + abs(parts["readout_bias"][0]))
    inputs = np.full((400, 1), drive)
    inputs[::2] *= -1
    start = system.record_map().states_from_record(np.array([[1e3]]), np.array([[-1e3]]), inputs[:1])[0]
    states = simulate(system, start, inputs, step=system.period)
    assert np.all(np.abs(states[1:, 0]) <= bound)
    assert np.all(np.abs(states[:, 2:]) <= 1.0)


def test_the_velocity_is_the_difference_of_positions():
    system = network()
    states = simulate(system, np.zeros(7), np.random.default_rng(3).normal(size=(50, 1)), step=system.period)
    np.testing.assert_allclose(states[1:, 1], np.diff(states[:, 0]) / system.period, rtol=1e-12)


def test_a_design_goes_through_yaml_and_gives_the_same_network():
    system = network(period=0.025)
    again = Recurrent.of(yaml.safe_load(yaml.safe_dump(system.design)), system.weights)
    assert again.design == system.design
    assert again.states == system.states
    np.testing.assert_array_equal(again.weights, system.weights)
    with pytest.raises(UserError, match=r"recurrent network: 3 weights, but 5 units have 131"):
        Recurrent.of(system.design, np.zeros(3))


def spring_record(seed, *, seconds=60.0, name="spring"):
    """A spring and damper without noise, q'' + 4 q' + 16 q = u, driven by steps of random height.

    Its motion between two steps is that of the matrix exponential.
    """
    random = np.random.default_rng(seed)
    samples, each = round(seconds / 0.01) + 1, 60
    drive = np.repeat(random.uniform(-8, 8, samples // each + 1), each)[:samples]
    whole = expm(0.01 * np.array([[0.0, 1.0, 0.0], [-16.0, -4.0, 1.0], [0.0, 0.0, 0.0]]))
    x, positions = np.array([random.normal() * 0.1, 0.0]), []
    for u in drive:
        positions.append(x[0])
        x = whole[:2, :2] @ x + whole[:2, 2] * u
    time = np.arange(samples) * 0.01
    return Record(name=name, time=time, input=drive[:, None], output=np.array(positions)[:, None])


def trained(records, rig, sampling, *, units=24, **settings):
    """A new network on the signals of a rig, trained on records."""
    network = untrained(rig, sampling.step, units)
    return train_network(network, [prepare(record, network, sampling) for record in records], **settings)


@pytest.fixture(scope="module")
def spring():
    """A network trained on three such records, with the settings and the progress of its training."""
    pytest.importorskip("torch")
    records = [spring_record(seed) for seed in range(3)]
    heard = []
    schedule = TrainingSchedule(stages=((20, 150), (40, 250)))
    fitted = trained(records, Linear(), SAMPLING, units=8, schedule=schedule, progress=lambda *news: heard.append(news))
    return fitted, heard


def test_training_learns_a_spring_from_steps(spring):
    fitted, heard = spring
    unseen = prepare(spring_record(9), fitted.system, SAMPLING)
    assert score(unseen.outputs[:, 0], free_run(fitted.system, unseen)[:, 0]).r2 > 0.995
    assert fitted.relative_error == min(error for _, _, error in heard) < 0.06
    assert fitted.evaluations == heard[-1][1] == 400


def test_the_trained_network_answers_a_step_as_the_spring_does(spring):
    """Of q'' + 4 q' + 16 q = 5 from rest: q = 5 / 16 (1 - e^(-2 t) (cos w t + 2 / w sin w t)), w = sqrt(12)."""
    system = spring[0].system
    time = np.arange(61) * 0.05
    w = np.sqrt(12.0)
    exact = 5 / 16 * (1 - np.exp(-2 * time) * (np.cos(w * time) + 2 / w * np.sin(w * time)))
    start = system.record_map().states_from_record(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))[0]
    simulated = simulate(system, start, np.full((60, 1), 5.0), step=0.05)[:, 0]
    assert np.max(np.abs(simulated - exact)) < 0.05 * 5 / 16


SHORT = TrainingSchedule(stages=((10, 20),), check=10)


def test_the_same_seed_trains_the_same_network():
    pytest.importorskip("torch")
    records = [spring_record(seed, seconds=10.0) for seed in range(2)]
    first, again, other = (
        trained(records, Linear(), SAMPLING, units=3, seed=seed, schedule=SHORT).system.weights for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert np.max(np.abs(first - other)) > 1e-3


def test_a_network_may_run_faster_than_it_is_scored():
    pytest.importorskip("torch")
    sampling = Sampling(step=0.01)
    fitted = trained([spring_record(0, seconds=10.0)], Linear(), sampling, units=3, schedule=SHORT)
    assert isinstance(fitted.system, Recurrent)
    assert fitted.system.period == 0.01
    experiment = prepare(spring_record(0, seconds=10.0), fitted.system, sampling)
    error = (free_run(fitted.system, experiment) - experiment.outputs)[:, 0] / np.std(experiment.outputs)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(fitted.relative_error, rel=1e-9)


def test_records_that_cannot_be_learned_from_are_refused():
    pytest.importorskip("torch")
    long, short = spring_record(0, seconds=10.0), spring_record(1, seconds=0.9, name="hop")
    with pytest.raises(UserError, match="hop: 19 samples are too short: training needs rollouts of 20"):
        trained([long, short], Linear(), SAMPLING)
    with pytest.raises(UserError, match="spring: input or output is constant"):
        trained([replace(long, input=np.ones_like(long.input))], Linear(), SAMPLING)


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(
        UserError, match=r"torch is missing; install the extra: pip install 'hybrid_sysid_ros\[train\]'"
    ):
        trained([], Linear(), SAMPLING)

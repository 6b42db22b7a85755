"""A constant bias of the inputs: what a record's beginning tells of it, and what that is worth over the rest."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Dry, System, one_step, rollouts
from hybrid_sysid_ros.extensions.input_bias.input_bias import KNOWN, LASTS, adapt, estimate
from hybrid_sysid_ros.identification.validation.unstable import UnstableError
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear, narx, recurrent
from tests.upright import GAINS, Upright

SAMPLING = Sampling(step=0.005, period=0.05)
SECONDS = 20.0
SPRING = 20.0  # 1/s^2


def experiment(system, bias, *, amplitude=1.0, noise=0.0, seed=0):
    """A record whose inputs had a bias of which it does not tell."""
    random, m = np.random.default_rng(seed), len(system.inputs)
    time = np.linspace(0.0, SECONDS, round(SECONDS / SAMPLING.step) + 1)
    phases = 2 * np.pi * np.arange(m)[:, None] / 3
    inputs = amplitude * (np.sin(2.3 * time + phases) + 0.6 * np.sin(5.1 * time + 2 * phases)).T
    starts = np.array([[0, 0, len(time), 0]])
    first = np.zeros((1, len(system.states)))
    _, outputs = rollouts(system, starts, first, inputs[:-1] + bias, step=SAMPLING.step)
    outputs = outputs + noise * random.normal(size=outputs.shape)
    return Record(name="biased", time=time, input=inputs, output=outputs)


class PushedSled(System):
    """x'' = u - F sgn x'."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("push [m/s^2]",)
    contacts = (Dry(on="speed", level=0.5, viscous=2.0),)

    def law(self, x, u):
        return x[1], u[0]


class Sleds(System):
    """Two of them, joined by a spring; the force in it is measured, and where the first one is."""

    states = ("left [m]", "right [m]", "left_speed [m/s]", "right_speed [m/s]")
    inputs = ("left_push [m/s^2]", "right_push [m/s^2]")
    outputs = ("left", "force [m/s^2]")
    contacts = (Dry(on="left_speed", level=0.3, viscous=2.0), Dry(on="right_speed", level=0.2, viscous=1.0))

    def law(self, x, u):
        force = SPRING * (x[1] - x[0])
        return x[2], x[3], u[0] + force, u[1] - force

    def output(self, x, u):
        return x[0], SPRING * (x[1] - x[0])


@pytest.mark.parametrize(("system", "bias"), [(Linear(), 0.05), (PushedSled(), -0.08)], ids=["linear", "dry"])
def test_a_known_bias_is_found_and_the_rest_of_the_record_met(system, bias):
    found = adapt(system, experiment(system, bias), sampling=SAMPLING, prior=np.array([0.1]), seconds=5.0)
    assert found.estimated[0] == pytest.approx(bias, abs=0.02 * abs(bias))
    assert found.bias[0] == LASTS * found.estimated[0]
    assert 1.0 - found.adapted.r2 == pytest.approx((1.0 - LASTS) ** 2 * (1.0 - found.without.r2), rel=0.2)


@pytest.mark.slow
def test_each_input_has_a_bias_of_its_own_through_sensors_with_noise():
    system, bias = Sleds(), np.array([0.05, -0.04])
    record = experiment(system, bias, noise=1e-3, seed=1)
    found = adapt(system, record, sampling=SAMPLING, prior=np.array([0.06, 0.06]), seconds=5.0)
    assert found.estimated == pytest.approx(bias, abs=0.005)
    assert found.adapted.r2 > max(0.99, found.without.r2)
    assert list(found.content(system)["bias"]) == ["left_push", "right_push"]


def test_what_comes_after_the_first_seconds_has_no_say_in_the_bias():
    system = PushedSled()
    record = experiment(system, 0.05)
    later = np.where(record.time[:, None] > 5.0, 3.0, 0.0)
    other = replace(record, input=record.input + later, output=record.output + later * record.time[:, None])
    reported = [adapt(system, r, sampling=SAMPLING, prior=np.array([0.1]), seconds=5.0) for r in (record, other)]
    np.testing.assert_array_equal(reported[0].bias, reported[1].bias)


def test_without_a_bias_both_free_runs_are_one():
    """They begin at one state and are scored on the same samples: a bias that can only be zero changes nothing."""
    found = adapt(PushedSled(), experiment(PushedSled(), 0.05), sampling=SAMPLING, prior=np.array([1e-11]), seconds=5.0)
    assert found.without.r2 == pytest.approx(found.adapted.r2, abs=1e-6)


def test_friction_that_never_lets_go_tells_of_no_bias():
    """Any bias that keeps the push below the level is as likely as another, and their mean is none."""
    system = PushedSled()
    record = experiment(system, 0.0, amplitude=0.1, noise=1e-4)
    assert np.ptp(record.output) < 2e-3
    bias, deviation = estimate(system, record, sampling=SAMPLING, prior=np.array([0.1]))
    assert bias == pytest.approx(0.0, abs=0.03)
    assert deviation > KNOWN * 0.1
    found = adapt(system, record, sampling=SAMPLING, prior=np.array([0.1]), seconds=5.0)
    assert found.bias == 0.0
    assert "do not tell" in found.reason


def test_a_bias_that_does_not_stay_is_not_held():
    """It ends after the first half: what that half says makes the other one worse."""
    system = Linear()
    time = np.linspace(0.0, SECONDS, round(SECONDS / SAMPLING.step) + 1)
    record = experiment(system, np.where(time[:-1, None] < 2.5, 0.1, 0.0), noise=1e-4)
    found = adapt(system, record, sampling=SAMPLING, prior=np.array([0.1]), seconds=5.0)
    assert found.bias == 0.0
    assert "bear out" in found.reason


def test_errors_that_training_had_are_no_bias():
    """A model that misses by as much as the bias moves it can't tell a bias."""
    system, prior = Linear(), np.array([0.1])
    record = experiment(system, 0.05)
    exact, rough = (estimate(system, record, sampling=SAMPLING, prior=prior, error=np.array([e])) for e in (0.0, 1.0))
    assert exact[1] < 0.1 * rough[1]
    assert rough[1] == pytest.approx(0.1, rel=0.3)
    assert abs(rough[0]) < 0.03


def test_maps_from_sample_to_sample_have_biases_too():
    """A NARX that settles at u + bias, and a network of zeros, on which an input does nothing."""
    wide = (-9.0, 9.0)
    lag = narx(
        exponents=[(1, 0), (0, 1)],
        coefficients=[0.9, 0.1],
        output_lags=1,
        input_lags=1,
        output_range=wide,
        input_range=wide,
    )
    random = np.random.default_rng(0)
    u = np.repeat(random.uniform(-1, 1, 40), 100)[:, None]
    y = np.zeros_like(u)
    for k in range(0, len(u) - 10, 10):
        y[k + 10 : k + 20] = 0.9 * y[k] + 0.1 * (u[k] + 0.06)
    record = Record(name="lag", time=np.linspace(0.0, 0.005 * (len(u) - 1), len(u)), input=u, output=y)
    sampling = replace(SAMPLING, step=0.05)
    found = adapt(lag, record, sampling=sampling, prior=np.array([0.04]), seconds=5.0)
    assert found.estimated[0] == pytest.approx(0.06, abs=0.002)
    assert found.adapted.r2 > found.without.r2
    still = adapt(recurrent(3), record, sampling=sampling, prior=np.array([0.04]), seconds=5.0)
    assert still.adapted.r2 == still.without.r2


@pytest.mark.parametrize("seconds", [0.2, 0.9, 19.8, 60.0, float("nan"), float("inf")])
def test_a_record_that_leaves_no_rest_is_refused(seconds):
    with pytest.raises(UserError, match="parted"):
        adapt(PushedSled(), experiment(PushedSled(), 0.0), sampling=SAMPLING, prior=np.array([0.01]), seconds=seconds)


def test_a_model_whose_free_run_says_nothing_tells_no_bias():
    """Errors of its beginning grow by e in a third of a second: what is seen in 5 s says nothing of the next 15."""
    random, h = np.random.default_rng(0), SAMPLING.step
    time = np.linspace(0.0, SECONDS, round(SECONDS / h) + 1)
    states, torque, fallen = np.zeros((len(time), 2)), np.zeros((len(time), 1)), Upright()
    for k in range(len(time) - 1):
        torque[k] = 0.3 * random.normal() - np.array(GAINS) @ states[k]
        states[k + 1] = one_step(fallen, states[k], torque[k], step=h)
    record = Record(name="held", time=time, input=torque, output=states[:, :1])
    with pytest.raises(UnstableError, match="held: an open free run over 20 s is meaningless"):
        adapt(fallen, record, sampling=SAMPLING, prior=np.array([0.2]), seconds=5.0)

"""The criterion of prediction errors, against a linear system's dense likelihood, and records with a known walk."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import multivariate_normal

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.core.rollout import one_step
from hybrid_sysid_ros.extensions.prediction_error.innovations import innovations
from hybrid_sysid_ros.identification import identify, prepare
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_bench import held_levels, record_of
from tests.test_input_handling import Lag

STEP, EVERY, WALK, NOISE = 0.01, 4, 2.0, 0.03
SAMPLING = Sampling(step=STEP, period=STEP * EVERY)
GIVEN = {"walks": np.array([WALK]), "noise": np.array([NOISE]), "spreads": np.array([1.0])}


def recorded(seed: int, samples: int = 500, walk: float = WALK) -> Record:
    """A lag under held levels with an offset that walks, by its own steps."""
    random = np.random.default_rng(seed)
    inputs = held_levels(seed, samples * EVERY + 1, hold=40)
    offset = np.cumsum(walk * np.sqrt(STEP) * random.normal(size=inputs.shape), axis=0)
    states = simulate(Lag(), np.zeros(1), (inputs + offset)[:-1], step=STEP)
    return record_of(inputs, states + NOISE * random.normal(size=states.shape), STEP, name=f"record_{seed}")


def matrices() -> tuple[np.ndarray, float]:
    """F of (speed, offset) over a step, and the input's effect."""
    a = one_step(Lag(), np.ones(1), np.zeros(1), step=STEP)[0]
    b = one_step(Lag(), np.zeros(1), np.ones(1), step=STEP)[0]
    return np.array([[a, b], [0.0, 1.0]]), float(b)


def test_the_criterion_is_the_likelihood_of_all_samples_together() -> None:
    """The joint normal distribution of all readings, by matrices, knows no filter."""
    record = prepare(recorded(1, samples=80), Lag(), SAMPLING)
    errors, variances = innovations(Lag(), record, **GIVEN)
    found = -0.5 * np.sum(errors**2 / variances + np.log(2 * np.pi * variances))
    step, gain = matrices()
    count = record.samples - 1
    mean, moves = np.array([record.followed[0, 0], 0.0]), np.zeros((2, 2 + count * EVERY))
    moves[:, :2] = np.diag([NOISE, 10.0 * WALK])
    means, rows = [], []
    for k in range(count * EVERY):
        moves, mean = step @ moves, step @ mean + np.array([gain * record.inputs[k, 0], 0.0])
        moves[1, 2 + k] += WALK * np.sqrt(STEP)
        if (k + 1) % EVERY == 0:
            means.append(mean[0])
            rows.append(moves[0].copy())
    joint = np.array(rows) @ np.array(rows).T + NOISE**2 * np.eye(count)
    dense = multivariate_normal(np.array(means), joint).logpdf(record.followed[1:, 0])
    assert found == pytest.approx(dense, abs=1e-6)


def test_the_variance_of_innovations_settles_at_that_of_riccati() -> None:
    """Ljung (1999), section 4.3: the predictor's variance, from the discrete algebraic Riccati equation."""
    _, variances = innovations(Lag(), prepare(recorded(0), Lag(), SAMPLING), **GIVEN)
    step, _ = matrices()
    noise = np.diag([0.0, WALK**2 * STEP])
    over, spread = np.linalg.matrix_power(step, EVERY), np.zeros((2, 2))
    for _ in range(EVERY):
        spread = step @ spread @ step.T + noise
    seen = np.array([[1.0, 0.0]])
    covariance = solve_discrete_are(over.T, seen.T, spread, np.array([[NOISE**2]]))
    assert variances[-1, 0] == pytest.approx(covariance[0, 0] + NOISE**2, rel=1e-6)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return replace(load("wheel_motor"), system=Lag(), structures={})


def fitted(rig: Rig, criterion: str, seeds: tuple[int, ...] = (0, 1), walk: float = WALK) -> Model:
    records = [recorded(seed, walk=walk) for seed in seeds]
    return identify(records, rig, "gray", sampling=SAMPLING, criterion=criterion)


def test_a_walk_is_found_and_no_longer_spoils_the_parameters(rig: Rig) -> None:
    by_prediction, by_simulation = fitted(rig, "prediction"), fitted(rig, "simulation")
    errors = by_prediction.standard_errors
    for name, truth in (("gain", 0.15), ("rate", 20.0)):
        assert abs(by_prediction.system.named[name] - truth) < 3.5 * errors[name]
    assert abs(by_prediction.system.named["gain"] - 0.15) < 0.2 * abs(by_simulation.system.named["gain"] - 0.15)
    assert errors["gain"] < 0.2 * by_simulation.standard_errors["gain"]
    found = by_prediction.fit["prediction"]
    for name, truth in (("walk of pwm [counts/sqrt(s)]", WALK), ("noise of speed [rad/s]", NOISE)):
        assert abs(found[name]["value"] - truth) < 3.0 * found[name]["standard_error"] < 0.5 * truth


def test_without_a_walk_both_criteria_agree(rig: Rig) -> None:
    by_prediction, by_simulation = (fitted(rig, name, walk=0.0) for name in ("prediction", "simulation"))
    for name, error in by_simulation.standard_errors.items():
        assert by_prediction.system.named[name] == pytest.approx(by_simulation.system.named[name], abs=2.0 * error)
    assert by_prediction.fit["prediction"]["walk of pwm [counts/sqrt(s)]"]["value"] < 0.05 * WALK


def test_what_has_no_filter_is_refused(rig: Rig) -> None:
    record = recorded(0)
    for options, reason in (
        ({"input_bias": 0.001}, "input_bias is for free runs"),
        ({"speed_delay": 0.01}, "leave delay"),
    ):
        with pytest.raises(UserError, match=f"criterion prediction: .*{reason}"):
            identify([record], rig, "gray", sampling=SAMPLING, options=options, criterion="prediction")
    with pytest.raises(UserError, match="fits no physics alone"):  # before any fit, for which the record is too short
        identify([record.between(0, 3)], rig, "black_box", sampling=SAMPLING, criterion="prediction")
    with pytest.raises(UserError, match="criterion predicton"):
        identify([record], rig, "gray", sampling=SAMPLING, criterion="predicton")

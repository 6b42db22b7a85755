"""Parameters of the equation that an estimator follows: friction, the drive's centre, and what can't be told apart."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.rigs.excitation import multisine
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError

PERIOD = 0.005
STILL = "damping=1e-9"  # followed as well, and hardly moving: two parameters are what is compiled already


@pytest.fixture(scope="module")
def changed(rig):
    """Measurements and inputs of a beam with 30 % more friction and its centre .3 V lower, under its P controller."""
    beam = dataclasses.replace(rig.system, coulomb=1.3 * rig.system.coulomb, centre=rig.system.centre - 0.3)
    plant = Plant(dataclasses.replace(rig, system=beam), seed=4)
    reference = multisine(2, amplitude=4.0, low=0.1, high=1.5, lines=15, period=10.0)
    u, rows = 0.0, []
    for _ in range(6000):
        measured = plant.measure()
        rows.append((measured.time, measured.outputs[0], u))
        u = float(np.clip(3 * (reference(measured.time) - rig.display[0].shown(measured.filtered[0])), -10, 10))
        for _ in range(5):
            plant.advance(u)
    return beam, rows


def tuning(rig, followed, **changes):
    values = configuration.defaults("cam_beam", "estimator") | {"followed": followed} | changes
    return configuration.estimator_tuning(values, rig)


def test_friction_and_centre_are_found_while_the_beam_moves(kind, rig, changed):
    beam, rows = changed
    ours = kind(rig.system, tuning(rig, "coulomb=0.2 centre=0.05", disturbance_noise=0.0), period=PERIOD)
    estimates = [ours.update(t, np.array([y]), np.array([u])) for t, y, u in rows]
    coulomb, centre = np.mean([e.parameters for e in estimates[-2000:]], axis=0)
    assert coulomb == pytest.approx(beam.coulomb, rel=0.1)
    assert centre == pytest.approx(beam.centre, abs=0.05)
    # To whoever has the equation as it was, a centre .3 V lower is an input .3 V higher.
    offsets = [e.disturbance[0] for e in estimates[-2000:]]
    assert np.mean(offsets) == pytest.approx(rig.system.centre - centre, abs=1e-6)
    assert estimates[-1].covariance.shape == (7, 7)
    deviations = np.sqrt(np.diag(estimates[-1].covariance))[5:]
    assert np.all((deviations > 0) & (deviations < [0.6, 0.3]))


def test_a_followed_parameter_makes_the_innovations_as_small_as_they_are_said_to_be(rig, changed):
    """The model that is right but for its friction: following it brings the squares back to one."""
    _, rows = changed
    means = []
    for followed in ("", f"coulomb=0.2 {STILL}"):
        ours = estimator_class("ekf")(rig.system, tuning(rig, followed), period=PERIOD)
        squares = [ours.update(t, np.array([y]), np.array([u])).normalised_innovation for t, y, u in rows]
        means.append(np.mean(squares[2000:]))
    assert means[1] < means[0]


def test_a_followed_parameter_stays_within_its_bounds(kind, rig):
    """The beam is said to be stuck under full drive: no friction of the equation explains it."""
    ours = kind(rig.system, tuning(rig, f"coulomb=20.0 {STILL}", disturbance_noise=0.0, gate=1e6), period=PERIOD)
    for k in range(1000):
        estimate = ours.update(k * PERIOD, np.zeros(1), np.array([10.0 if k % 200 < 150 else -10.0]))
        assert 0.0 <= estimate.parameters[0] <= 40.0
        assert np.all(np.isfinite(estimate.covariance))


def test_the_centre_and_the_disturbance_are_one(kind, rig):
    with pytest.raises(UserError, match="parameter centre can't be distinguished from an offset of input drive"):
        kind(rig.system, tuning(rig, "centre=0.02"), period=PERIOD)


def test_of_a_hybrid_the_centre_is_nearly_an_input(rig):
    """Its network reads the input as well, and not the centre: to whoever has the model as it was, still an offset."""
    hybrid = load(configuration.shipped("cam_beam", "model")).system
    with pytest.raises(UserError, match="parameter centre can't be distinguished from an offset of input drive"):
        estimator_class("ukf")(hybrid, tuning(rig, "centre=0.05"), period=PERIOD)
    ours = estimator_class("ukf")(hybrid, tuning(rig, "centre=0.05 coulomb=0.1", disturbance_noise=0.0), period=PERIOD)
    centre = hybrid.named["centre"]
    for k in range(400):  # rises evenly at .1 rad/s, though the drive is .3 V less than that takes
        drive = centre - 0.3 + (0.1 * hybrid.named["damping"] + hybrid.named["coulomb"]) / hybrid.named["gain"]
        estimate = ours.update(k * PERIOD, np.array([0.1 * k * PERIOD - 0.1]), np.array([drive]))
    assert estimate.parameters[0] < centre - 0.1
    assert estimate.disturbance[0] == pytest.approx(centre - estimate.parameters[0], rel=0.05)


@pytest.mark.parametrize(
    ("followed", "reason"),
    [
        ("friction=0.1", "CamBeam has no parameter friction to follow: it has gain, centre"),
        ("input_delay=0.001", "parameter input_delay can't be followed"),
        ("range_low=0.1", "parameter range_low can't be followed"),
        ("coulomb=0.0", "parameter coulomb drifts by 0 per root of a second"),
        ("coulomb", "'coulomb' is no NAME=DRIFT"),
        ("coulomb=much", "'coulomb=much' is no NAME=DRIFT"),
    ],
)
def test_what_can_t_be_followed_is_reported(rig, followed, reason):
    with pytest.raises(UserError, match=reason):
        estimator_class("ekf")(rig.system, tuning(rig, followed), period=PERIOD)


def test_a_plant_that_changes_goes_on_as_the_other_one(rig):
    """Noise-free: from where it is, it moves as a plant that always had the new friction."""
    beam = dataclasses.replace(rig.system, coulomb=4.0)
    other = Plant(dataclasses.replace(rig, system=beam), seed=0, noisy=False)
    plant = Plant(rig, seed=0, noisy=False)
    for _ in range(200):
        plant.advance(5.0)
    other.reset(plant.state, inputs=5.0)
    plant.change(coulomb=4.0)
    for _ in range(200):
        plant.advance(5.0)
        other.advance(5.0)
    np.testing.assert_array_equal(plant.state, other.state)
    assert rig.system.coulomb != 4.0

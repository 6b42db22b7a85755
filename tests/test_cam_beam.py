"""The cam-driven beam: what is known of the rig, and its records."""

import dataclasses
import math

import numpy as np
import pytest

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.rigs import excitation
from hybrid_sysid_ros.rigs.cam_beam.system import SMALLEST_SQUARED_COSINE, CamBeam
from hybrid_sysid_ros.rigs.plant import Plant
from tests.one_joint import Linear
from tests.straight_beam import straight


def study(p, x, u, *, step):
    """The gray box g14 as its study printed it, on a crank: the same physics in another order of operations.

    Friction after the drive, then damping implicitly; positions in rad.
    """
    q, v = x
    path = [(q, v)]
    for w in u.tolist():
        xc = min(max(q, p.range_low), p.range_high)
        e = w - p.centre
        e *= 1 + p.asymmetry if e > 0 else 1 - p.asymmetry
        sine = xc * p.cam_curvature**0.5
        crank = math.asin(sine)
        drive = p.gain * e * math.cos(crank) - p.stiffness * q - p.quadratic_stiffness * xc**2
        drive -= v * v * sine / math.cos(crank) ** 2 * p.cam_curvature**0.5
        level = p.coulomb + p.stribeck_excess / (1 + (v / p.stribeck_speed) ** 2) ** 2
        friction = max(0.0, level * (1 + p.friction_slope * xc + p.friction_curvature * xc**2))
        v += step * drive
        if abs(v) > step * friction + p.creep:
            v = math.copysign(abs(v) - step * friction, v)
        else:
            v *= p.creep / (p.creep + step * friction)
        v /= 1 + step * p.damping * (1 + p.damping_asymmetry * math.copysign(1.0, v))
        q += step * v
        path.append((q, v))
    return np.array(path)


def test_the_beam_moves_as_in_the_study_that_identified_it():
    """Two orders of operations in one step, one motion in the limit."""
    beam = CamBeam(input_delay=0.0)
    volts = 4.0 * np.sign(np.sin(2 * np.pi * 0.7 * np.arange(0, 3, 1e-3))) + beam.centre
    errors = []
    for parts in (1, 5):
        u = np.repeat(volts, parts)
        ours = simulate(beam, np.array([0.02, 0.3]), u[:, None], step=1e-3 / parts, every=parts)
        theirs = study(beam, (0.02, 0.3), u, step=1e-3 / parts)[::parts]
        errors.append(np.max(np.abs(ours - theirs)[:, 0]))
    assert errors[0] < 3e-3 * np.ptp(ours[:, 0])
    assert errors[1] < 0.3 * errors[0]


BARE = {"stiffness": 0.0, "quadratic_stiffness": 0.0, "damping": 0.0, "coulomb": 0.0, "asymmetry": 0.0}
WIDE = {"range_low": -1.0, "range_high": 1.0, "range_speed": 100.0, "input_delay": 0.0}
"""So that no term is held at the edge of the records."""


@pytest.mark.parametrize("curvature", [20.0, 48.84])
def test_a_crank_that_nothing_drives_turns_at_a_constant_speed(curvature):
    """q = sin(phi) / sqrt(cam_curvature) with phi' constant, from near one dead centre to near the other."""
    beam = CamBeam(cam_curvature=curvature, gain=0.0, **BARE, **WIDE)
    length, turn = curvature**-0.5, 0.8
    phi = -1.2 + turn * np.arange(0, 3.0 + 1e-9, 0.01)
    start = np.array([length * np.sin(phi[0]), length * turn * np.cos(phi[0])])
    errors = []
    for step in (1e-3, 5e-4, 2.5e-4):
        every = round(0.01 / step)
        states = simulate(beam, start, np.zeros((300 * every, 1)), step=step, every=every)
        assert np.max(np.abs(states[:, 1] - length * turn * np.cos(phi))) < 10 * step * length * turn
        errors.append(np.max(np.abs(states[:, 0] - length * np.sin(phi))))
    assert errors[-1] < 1e-3 * length
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=0.05)  # first order


@pytest.mark.parametrize("degrees", [-60.0, -30.0, 0.0, 30.0, 60.0])
def test_the_drive_fades_as_the_cosine_of_the_crank(degrees):
    beam = CamBeam(centre=0.9, **BARE, **WIDE)
    phi = np.deg2rad(degrees)
    rest = np.array([np.sin(phi) / beam.cam_curvature**0.5, 0.0])
    speed = simulate(beam, rest, np.full((1, 1), 2.9), step=1e-4)[-1, 1]
    assert speed / 1e-4 == pytest.approx(beam.gain * 2.0 * np.cos(phi), rel=1e-9)


def test_without_a_crank_the_drive_does_not_fade():
    beam = CamBeam(cam_curvature=0.0, centre=0.0, **BARE, **WIDE)
    for angle in (-0.1, 0.0, 0.1):
        states = simulate(beam, np.array([angle, 0.5]), np.full((100, 1), 3.0), step=1e-3)
        assert states[-1, 1] == pytest.approx(0.5 + beam.gain * 3.0 * 0.1, rel=1e-9)


def test_a_straight_beam_without_friction_is_the_linear_one():
    linear = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.004)
    random = np.random.default_rng(0)
    start, inputs = random.normal(size=2), random.uniform(-10.0, 10.0, (200, 1))
    beam, expected = (simulate(system, start, inputs, step=0.005) for system in (straight(linear), linear))
    np.testing.assert_allclose(beam, expected, rtol=1e-12)


def test_the_records_stay_away_from_the_dead_centres(records, rig):
    """The crank's angle, asin(q sqrt(cam_curvature)), stays below 65 degrees: the law's own limit is 71.6."""
    widest = max(float(np.max(np.abs(record.output))) for record in records.values())
    assert np.rad2deg(np.arcsin(widest * rig.system.cam_curvature**0.5)) < 65.0
    assert np.rad2deg(np.arccos(SMALLEST_SQUARED_COSINE**0.5)) == pytest.approx(71.6, abs=0.05)


def moves(beam, volts, position=0.0):
    states = simulate(beam, np.array([position, 0.0]), np.full((1000, 1), volts), step=1e-3)
    return bool(np.any(states[:, 1] != 0.0)), states[-1, 1]


def break_away(beam, direction):
    """The voltage at which the beam starts to move from rest at 0, by bisection [V]."""
    stuck, free = beam.centre, beam.centre + 5.0 * direction
    for _ in range(50):
        middle = (stuck + free) / 2
        stuck, free = (stuck, middle) if moves(beam, middle)[0] else (middle, free)
    return free


def test_the_beam_stays_stuck_below_the_break_away_voltage():
    beam = CamBeam(creep=0.0)
    # Torque balance at rest: gain (1 +- asymmetry) |u - centre| = coulomb + stribeck_excess.
    level = beam.coulomb + beam.stribeck_excess
    for direction in (1.0, -1.0):
        expected = beam.centre + direction * level / (beam.gain * (1 + direction * beam.asymmetry))
        assert break_away(beam, direction) == pytest.approx(expected, rel=1e-9)
        inside = beam.centre + 0.999 * (expected - beam.centre)
        assert moves(beam, inside) == (False, 0.0)
        slips, speed = moves(beam, beam.centre + 1.02 * (expected - beam.centre))
        assert slips
        assert speed * direction > 0


def test_a_stuck_beam_stays_where_it_is_for_a_minute():
    beam = CamBeam(creep=0.0)
    states = simulate(beam, np.array([0.01, 0.0]), np.full((60_000, 1), 1.0), step=1e-3)
    assert np.all(states[:, 0] == 0.01)


def test_the_beam_balances_at_about_one_volt():
    """0.9 to 1.2 V at the middle of the records, within a Coulomb band of about +-0.45 V."""
    beam = CamBeam(creep=0.0)
    high, low = break_away(beam, 1.0), break_away(beam, -1.0)
    assert 0.9 <= (low + high) / 2 <= 1.2
    assert 0.3 <= (high - low) / 2 <= 0.6


def test_the_beam_goes_up_more_easily_than_down():
    beam = CamBeam(input_delay=0.0)
    up = simulate(beam, np.zeros(2), np.full((300, 1), beam.centre + 5.0), step=1e-3)[-1, 0]
    down = simulate(beam, np.zeros(2), np.full((300, 1), beam.centre - 5.0), step=1e-3)[-1, 0]
    assert up > -down > 0


@pytest.mark.slow
def test_a_whole_experiment_follows_from_its_reference_alone(experiments, rig):
    """u = clip(3 (ref - yf), +-10), the 20 Hz filter and the beam: R2 of y at least .98 on every record."""
    scale = rig.display[0].scale
    quiet = Plant(rig, seed=0, noisy=False)
    for name, experiment in experiments.items():
        quiet.reset(np.array([scale * experiment.output[0], 0.0]))
        simulated = np.empty(len(experiment.output))
        for k, reference in enumerate(experiment.reference):
            measured = quiet.measure()
            simulated[k] = measured.outputs[0] / scale
            quiet.advance(rig.experiments.loops[0].gain * (reference - measured.filtered[0] / scale))
        errors = simulated - experiment.output
        r2 = 1 - np.sum(errors**2) / np.sum((experiment.output - experiment.output.mean()) ** 2)
        assert r2 >= 0.98, name


def drive(plant, volts, steps=300):
    plant.reset(np.zeros(2), inputs=plant.rig.system.centre)
    for _ in range(steps):
        plant.advance(volts)
    return plant.state.copy()


def test_the_drive_saturates_at_ten_volts(rig):
    plant = Plant(rig, seed=0)
    for sign in (1.0, -1.0):
        at_limit = drive(plant, sign * 10.0)
        np.testing.assert_array_equal(drive(plant, sign * 1e6), at_limit)
        np.testing.assert_array_equal(drive(plant, sign * np.inf), at_limit)
        assert abs(drive(plant, sign * 9.9)[0]) < abs(at_limit[0])


def test_a_command_that_is_not_a_number_is_zero(rig):
    plant = Plant(rig, seed=0)
    np.testing.assert_array_equal(drive(plant, float("nan")), drive(plant, 0.0))


def test_a_bias_is_a_voltage_that_no_command_shows(rig):
    biased, plain = Plant(rig, seed=0, bias=0.5), Plant(rig, seed=0)
    np.testing.assert_allclose(drive(biased, 4.0, 50), drive(plain, 4.5, 50), rtol=0.05)
    assert moves(dataclasses.replace(rig.system, creep=0.0), rig.system.centre + 0.5)[0]


def test_the_plant_is_its_equation(rig):
    """Stepping with whole and part delays gives what a simulation in one go gives."""
    volts = np.random.default_rng(0).uniform(-8, 8, 400).repeat(5)
    plant = Plant(rig, seed=0, noisy=False)
    plant.reset(np.zeros(2), inputs=volts[0])
    states = [plant.state.copy()]
    for u in volts:
        plant.advance(u)
        states.append(plant.state.copy())
    np.testing.assert_allclose(states, simulate(rig.system, np.zeros(2), volts[:, None], step=rig.step), atol=1e-12)
    assert plant.time == pytest.approx(2.0)


def test_a_plant_is_the_same_for_a_seed_and_another_for_another(rig):
    def measured(seed):
        plant = Plant(rig, seed=seed)
        for _ in range(50):
            plant.advance(5.0)
        return plant.measure().outputs.tolist()

    assert measured(1) == measured(1)
    assert measured(1) != measured(2)


def test_the_hardware_reference_is_the_author_s(rig):
    schedule = rig.schedule("hardware")
    reference = schedule.of(0)
    t = np.arange(0, 51, 1e-3)
    q = reference(t)
    steps, pause, sine, end = q[t < 29], q[(t >= 29) & (t < 30)], q[(t >= 30) & (t < 50)], q[t >= 50]
    levels = steps.reshape(29, 1000)
    assert np.all(np.ptp(levels, axis=1) == 0.0)  # a level every second
    assert len(np.unique(levels[:, 0])) == 29
    assert np.all(np.abs(steps) <= 4.0)
    assert np.ptp(steps) > 7.0
    assert np.all(pause == 0.0)
    assert np.all(end == 0.0)
    np.testing.assert_allclose(np.max(sine), 4.0, rtol=1e-4)
    np.testing.assert_allclose(sine[:2000], sine[2000:4000], atol=1e-9)  # 0.5 Hz
    assert np.all(sine[1:999] > 0)
    # 4 (2 frac(43758.5453 sin 12.9898) - 1), worked out with 50 digits
    assert reference(1.5) == pytest.approx(4 * (2 * 0.9216903897888 - 1), abs=1e-9)
    assert reference(0.5) == -4.0  # frac(0) = 0
    assert schedule.duration == 51.0
    assert reference(-0.1) == 0.0


def test_excitations_keep_their_amplitude_and_band():
    t = np.arange(0, 20, 1e-3)
    sines = excitation.multisine(1, amplitude=3.0, low=0.1, high=2.0, lines=15, period=10.0)
    assert np.max(np.abs(sines(t))) == pytest.approx(3.0, rel=1e-3)
    np.testing.assert_allclose(sines(t + 10.0), sines(t), atol=1e-9)
    spectrum = np.abs(np.fft.rfft(sines(t[:10_000]))) / 5000
    inside = (np.fft.rfftfreq(10_000, 1e-3) >= 0.1 - 1e-9) & (np.fft.rfftfreq(10_000, 1e-3) <= 2.0 + 1e-9)
    assert np.max(spectrum[~inside]) < 1e-9
    levels = excitation.random_steps(1, amplitude=2.0, hold=0.5, duration=20.0)(t)
    assert np.max(np.abs(levels)) <= 2.0
    assert np.flatnonzero(np.diff(levels)).tolist() == [500 * k - 1 for k in range(1, 40)]
    sweep = excitation.swept_sine(amplitude=2.0, low=0.5, high=3.0, duration=20.0)(t)
    crossings = t[1:][np.diff(np.sign(sweep)) > 0]
    assert 1 / np.diff(crossings)[0] == pytest.approx(0.5, rel=0.3)
    assert 1 / np.diff(crossings)[-1] == pytest.approx(3.0, rel=0.05)

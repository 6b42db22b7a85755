"""Identification of an unstable system under a loop: free initial states, what is refused, and what stands instead."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.core import (
    ImplicitFriction,
    RungeKutta,
    Sensitivities,
    System,
    bounded,
    one_step,
    rollouts,
    simulate,
)
from hybrid_sysid_ros.core.mathematics import sin
from hybrid_sysid_ros.core.wrappers import feedback_of
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.identification.parameter_groups import groups
from hybrid_sysid_ros.identification.shooting import (
    MultipleShootingProblem,
    UnstableFitSettings,
    fastest_growth,
    growth_along,
    parts_from,
)
from hybrid_sysid_ros.identification.validation.unstable import (
    UnstableError,
    check_free_run,
    predictions,
    stabilised_run,
)
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.rigs.excitation import multisine
from hybrid_sysid_ros.support.errors import UserError

STEP, NOISE = 0.02, np.array([0.002, 0.01])
GAINS = np.array([[40.0, 8.0]])
"""Of a loop that holds the pendulum."""


@dataclass(frozen=True, kw_only=True)
class Upright(System):
    """J q'' = w sin q + g u: a pendulum on its head, whose inertia, weight and gain count only by their ratios."""

    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("angle", "rate")
    stepper = RungeKutta()

    inertia: float = bounded(0.5, 0.3, 0.8, spread=0.05, unit="kg m^2")
    weight: float = bounded(2.0, 1.0, 4.0, spread=0.3, unit="N m")
    gain: float = bounded(0.25, 0.1, 0.5, spread=0.03, unit="1")

    def law(self, x, u):
        return x[1], (self.weight * sin(x[0]) + self.gain * u[0]) / self.inertia


PLANT = Upright(inertia=0.53, weight=2.3, gain=0.24)
SETTINGS = UnstableFitSettings(noise=NOISE, stabiliser=GAINS)
SAMPLING = Sampling(step=STEP, period=STEP)


def flown(seed: int, *, seconds: float = 40.0, system: System = PLANT, noise: float = 1.0) -> PreparedRecord:
    """The pendulum under its loop, moved by a random torque."""
    random = np.random.default_rng(seed)
    count = round(seconds / STEP)
    pushed = np.repeat(random.uniform(-6.0, 6.0, count // 20 + 1), 20)[:count]
    x = np.zeros(len(system.states))
    states, inputs = [x], []
    disturbed = noise * NOISE * random.standard_normal((count + 1, 2))
    for k in range(count):
        u = pushed[k : k + 1] - GAINS @ (x[:2] + disturbed[k])
        x = one_step(system, x, u, step=STEP)
        states.append(x)
        inputs.append(u)
    outputs = np.array(states)[:, :2] + disturbed
    known = np.pad(outputs, ((0, 0), (0, len(x) - 2)))
    return PreparedRecord(name="flown", sampling=SAMPLING, inputs=np.array(inputs), outputs=outputs, states=known)


@pytest.fixture(scope="module")
def record() -> PreparedRecord:
    return flown(1)


def loop_of(inputs, first, feedback):
    """The same run in plain Python, (samples, states)."""
    x, found = first.copy(), [first.copy()]
    for u in inputs:
        x = one_step(PLANT, x, u - feedback @ x, step=STEP)
        found.append(x)
    return np.array(found)


def test_a_run_with_a_feedback_is_the_loop_and_its_slopes_are_those_of_differences():
    random = np.random.default_rng(0)
    inputs, first = random.normal(size=(60, 1)), np.array([0.1, -0.2])
    starts = np.array([[0, 0, 61, 0]])
    given: dict[str, Any] = {"step": STEP, "every": 1, "feedback": GAINS}
    states, _ = rollouts(PLANT, starts, first[None], inputs, **given)
    np.testing.assert_allclose(states, loop_of(inputs, first, GAINS), atol=1e-12)
    sensitivities = Sensitivities(PLANT)
    jacobian = np.empty((61, 2, sensitivities.count))
    sensitivities.rollouts(PLANT, starts, first[None], inputs, **given, out=jacobian)
    nudge = 1e-6
    for k in range(5):
        values, begin = PLANT.values, first.copy()
        if k < 3:
            values[k] += nudge
        else:
            begin[k - 3] += nudge
        other, _ = rollouts(PLANT.with_values(values), starts, begin[None], inputs, **given)
        np.testing.assert_allclose(jacobian[:, :, k], (other - states) / nudge, atol=2e-4)
    with pytest.raises(ValueError, match="give 1 rows and 2 columns"):
        rollouts(PLANT, starts, first[None], inputs, step=STEP, feedback=np.zeros((2, 2)))


def test_windows_grow_as_the_fastest_mode_does(record):
    assert fastest_growth(PLANT) == pytest.approx(np.sqrt(2.3 / 0.53))
    problem = MultipleShootingProblem(Upright(), [record], SETTINGS)
    assert problem.stages == tuple(round(rate / 2.0 / STEP) for rate in (1.4, 3.6))
    closed = MultipleShootingProblem(Upright(), [record], replace(SETTINGS, closed=10.0))
    assert closed.stages[-1] == 500


@dataclass(frozen=True, kw_only=True)
class Warming(Upright):
    """It warms as it leans, which no sensor shows."""

    states = ("angle [rad]", "rate [rad/s]", "warmth [K]")  # type: ignore[assignment]
    outputs = ("angle", "rate")

    def law(self, x, u):
        return *super().law(x, u), x[0] ** 2 - 0.2 * x[2]


def test_what_no_record_shows_is_carried_through_windows_by_a_run_that_is_held():
    random, samples = np.random.default_rng(3), 1501
    pushed = np.repeat(random.uniform(-6.0, 6.0, 75), 20)[:, None]
    feedback = np.pad(GAINS, ((0, 0), (0, 1)))
    starts = np.array([[0, 0, samples, 0]])
    states, outputs = rollouts(Warming(), starts, np.zeros((1, 3)), pushed, step=STEP, feedback=feedback)
    seen = np.pad(outputs, ((0, 0), (0, 1)))
    inputs = pushed - states[:-1] @ feedback.T
    record = PreparedRecord(name="warm", sampling=SAMPLING, inputs=inputs, outputs=outputs, states=seen)
    problem = MultipleShootingProblem(Warming(), [record], SETTINGS)
    problem.carry(problem.start, problem.stages[0])
    begins, first, _, _ = problem.windows(problem.stages[0])
    np.testing.assert_allclose(first[:, 2], states[begins[:, 1], 2], rtol=1e-6)


@pytest.mark.parametrize("closed", [0.0, 5.0])
def test_derivatives_are_those_of_a_fit_of_all_initial_states(record, closed):
    """The gradient of the sum of squares over parameters alone, by differences."""
    problem = MultipleShootingProblem(Upright(), [record], replace(SETTINGS, closed=closed))
    horizon = problem.stages[-1]
    residuals, jacobian = problem.residuals(horizon), problem.jacobian(horizon, map)
    at = problem.start
    gradient = jacobian(at).T @ residuals(at)
    for k in range(len(at)):
        ahead, behind = at.copy(), at.copy()
        ahead[k] += 1e-4
        behind[k] -= 1e-4
        change = 0.5 * (np.sum(residuals(ahead) ** 2) - np.sum(residuals(behind) ** 2)) / 2e-4
        assert gradient[k] == pytest.approx(change, rel=2e-3)


@pytest.mark.parametrize("closed", [0.0, 5.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_fit_finds_what_the_data_tell_with_its_error(seed, closed):
    """Weight and gain per inertia, within three standard errors of less than .5 %; chi squared is that of the noise."""
    found = fit(Upright(), [flown(seed)], unstable=replace(SETTINGS, closed=closed))
    values = found.system.named
    for name in ("weight", "gain"):
        ratio, truth = values[name] / values["inertia"], PLANT.named[name] / PLANT.inertia
        powers = np.array([{"inertia": -1.0, name: 1.0}.get(item, 0.0) / values[item] for item in found.names])
        error = np.sqrt(powers @ found.covariance @ powers)
        assert error < 5e-3
        assert abs(ratio / truth - 1.0) < 3.0 * error
    assert found.chi_squared == pytest.approx(1.0, abs=0.15)
    assert [group.exponents for group in groups(found)] == [
        {"inertia": 1.0, "gain": -1.0},
        {"weight": 1.0, "gain": -1.0},
    ]


@dataclass(frozen=True, kw_only=True)
class Stepped(Upright):
    """By Euler's semi-implicit method, whose errors are of first order in the step."""

    stepper = ImplicitFriction()  # type: ignore[assignment]


def halved(record: PreparedRecord) -> PreparedRecord:
    """A record for simulations at half the step."""
    return replace(record, sampling=replace(SAMPLING, step=0.5 * STEP), inputs=np.repeat(record.inputs, 2, axis=0))


def test_what_the_step_moves_in_a_fit_over_open_windows_is_in_its_standard_errors(record):
    """Of w / J and g / J; the step error is twice what a fit of half the step moves, within a third."""
    found, finer = (
        fit(Stepped(inertia=0.53), [each], unstable=replace(SETTINGS, stabiliser=None), hold=["inertia"])
        for each in (record, halved(record))
    )
    twice = 2.0 * (finer.system.values - found.system.values)[1:]
    errors = (found.system.values - PLANT.values)[1:]
    deviations = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(errors) < 3.0 * deviations)
    np.testing.assert_allclose(np.abs(found.step_error), np.abs(twice), rtol=0.35)


def test_groups_are_the_products_that_a_covariance_leaves(record):
    """Three parameters known within 3 %, S r / m within .02 %: only that product is determined."""

    @dataclass(frozen=True, kw_only=True)
    class Wing(Upright):
        inertia: float = bounded(2.0, 0.1, 10.0, spread=0.06, unit="kg")
        weight: float = bounded(5.0, 0.1, 10.0, spread=0.15, unit="m^2")
        gain: float = bounded(7.0, 0.1, 10.0, spread=0.21, unit="kg/m^3")

    system = Wing()
    spreads, values = np.array([item.spread for item in system.parameters]), system.values
    row = np.array([-1.0, 1.0, 1.0]) / values
    information = np.diag(1.0 / spreads**2) + np.outer(row, row) / 2e-4**2
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    found = Fit(
        system=system, names=tuple(item.name for item in system.parameters), covariance=4.0 * covariance,
        by_cost=covariance, nuisances={}, relative_error=0.0, seconds=0.0, evaluations=0,
    )  # fmt: skip
    (group,) = groups(found)
    assert group.exponents == {"inertia": -1.0, "weight": 1.0, "gain": 1.0}
    assert group.value == pytest.approx(5.0 * 7.0 / 2.0)
    assert group.relative_error == pytest.approx(4e-4, rel=1e-3)  # by the robust covariance
    assert str(group) == "weight gain / inertia = 17.5 (standard error 0.04 %)"
    assert groups(replace(found, by_cost=np.diag((0.01 * spreads) ** 2))) == []
    assert groups(replace(found, by_cost=np.diag(spreads**2))) == []


def test_an_open_free_run_is_refused_with_the_reason(record):
    with pytest.raises(UnstableError, match=r"open free run over 40 s is meaningless .* by e in 0\.48 s"):
        check_free_run(PLANT, record)
    hanging = Upright(weight=1.0)
    short = replace(record, inputs=record.inputs[:20], outputs=record.outputs[:21], states=record.states[:21])
    check_free_run(hanging, short)  # .4 s: a nudge does not grow yet


def test_what_grows_into_a_bounded_motion_that_follows_the_record_is_not_refused():
    """Van der Pol's oscillator is linearly unstable at rest, and its limit cycle is not."""

    @dataclass(frozen=True, kw_only=True)
    class Oscillator(Upright):
        def law(self, x, u):
            return x[1], self.weight * (1.0 - x[0] ** 2) * x[1] - x[0] + self.gain * u[0]

    system, inputs = Oscillator(), np.sin(0.3 * np.arange(2000))[:, None]
    states = simulate(system, np.array([1.0, 0.0]), inputs, step=STEP)
    record = PreparedRecord(name="o", sampling=SAMPLING, inputs=inputs, outputs=states, states=states.copy())
    assert fastest_growth(system) * 40.0 > np.log(1e6)
    check_free_run(system, record)


def test_predictions_of_the_plant_itself_err_by_what_the_noise_tells():
    """Without noise not at all; with it at first by the error of the state that the readings before leave. An error of
    the pendulum grows by e in (J / w)^.5, half a second, which stands for a second.
    """
    exact = predictions(PLANT, flown(4, noise=0.0), SETTINGS)
    second = np.sqrt(PLANT.inertia / PLANT.weight)
    assert [item.closed for item in exact] == [False, False, True]
    np.testing.assert_allclose([item.seconds for item in exact], second * np.array([1.0, 5.0, 20.0]), rtol=1e-6)
    for item in exact:
        for score in item.scores.outputs.values():
            assert score.rmse < 1e-7
    noisy, *_ = predictions(PLANT, flown(4), SETTINGS)
    angle = noisy.scores.outputs["angle"].rmse
    assert NOISE[0] < angle < 3.0 * NOISE[0]
    wrong, *_ = predictions(replace(PLANT, weight=2.0), flown(4, noise=0.0), SETTINGS)
    assert wrong.scores.outputs["angle"].rmse > 100.0 * exact[0].scores.outputs["angle"].rmse


def test_what_no_output_shows_does_not_run_away_with_the_open_run():
    """A strap that stretches with the angle and pulls back: a state that only a run that stays upright tells."""

    @dataclass(frozen=True, kw_only=True)
    class Strapped(Upright):
        states = (*Upright.states, "stretch [rad]")  # type: ignore[assignment]

        def law(self, x, u):
            rate, acceleration = super().law(x, u)
            return rate, acceleration - 0.5 * x[2], 5.0 * (x[0] - x[2])

    strapped = Strapped(inertia=0.53, weight=2.3, gain=0.24)
    one_second, *_ = predictions(strapped, flown(4, system=strapped), SETTINGS)
    assert NOISE[0] < one_second.scores.outputs["angle"].rmse < 3.0 * NOISE[0]


def test_a_run_that_the_stabiliser_closes_is_the_record_s_own(record):
    clean = flown(5, noise=0.0)
    np.testing.assert_allclose(stabilised_run(PLANT, clean, GAINS)[1], clean.outputs, atol=1e-9)
    open_run = simulate(PLANT, clean.states[0] + 1e-9, clean.inputs, step=STEP)
    assert np.max(np.abs(open_run - clean.outputs)) > 0.1


def test_a_run_that_a_late_stabiliser_closes_is_the_record_s_own():
    """Of a pendulum whose torque comes a step late: the stabiliser's part of it is of the angle a step before."""

    class Late(Upright):
        delays: ClassVar[dict[str, float]] = {"torque": STEP}

    system, inputs = Late(inertia=0.53, weight=2.3, gain=0.24), np.zeros((500, 1))
    states, pushed = np.zeros((501, 2)), np.repeat(np.random.default_rng(6).uniform(-6.0, 6.0, 25), 20)
    for k in range(500):
        inputs[k] = pushed[k] - GAINS @ states[k]
        states[k + 1] = one_step(system, states[k], inputs[max(k - 1, 0)], step=STEP)
    late = PreparedRecord(name="late", sampling=SAMPLING, inputs=inputs, outputs=states.copy(), states=states)
    found = stabilised_run(system, late, GAINS)[1]
    np.testing.assert_allclose(found[200:], states[200:], atol=1e-6)  # what acted before the record has faded


def test_what_a_stabiliser_needs_is_reported(record):
    coarse = replace(record, sampling=Sampling(step=STEP, period=2.0 * STEP))
    with pytest.raises(UserError, match="give a period as long as the step"):
        stabilised_run(PLANT, coarse, GAINS)

    @dataclass(frozen=True, kw_only=True)
    class Tip(Upright):
        outputs = ("angle", "tip [m]")

        def output(self, x, u):
            return x[0], sin(x[0])

    with pytest.raises(UserError, match="tip is fed back, but it is no state"):
        feedback_of(Tip(), GAINS)


UPRIGHT = """
from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import sin


@dataclass(frozen=True, kw_only=True)
class Law(System):
    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("angle", "rate")
    stepper = RungeKutta()
    weight: float = bounded(1.0, 0.1, 50.0, unit="1/s^2")
    gain: float = bounded(2.0, 0.01, 5.0, unit="1/(kg m^2)")

    def law(self, x, u):
        return x[1], self.weight * sin(x[0]) + self.gain * u[0]
"""
VALUES = f"""
step: {STEP}
sensors: {{angle: {{white_noise: {NOISE[0]}}}, rate: {{white_noise: {NOISE[1]}}}}}
actuators: {{torque: {{low: -40.0, high: 40.0}}}}
demo: {{step: {STEP}, period: {STEP}}}
"""


def test_an_unstable_rig_whose_loop_nobody_declared_is_fitted_and_judged(tmp_path, record):
    """Free runs fail. Open windows find w / J and g / J of the simulation, and predictions judge them."""
    folder = tmp_path / "upright"
    folder.mkdir()
    (folder / "system.py").write_text(UPRIGHT)
    (folder / "rig.yaml").write_text(VALUES)
    rig, time = hs.load_rig(folder), STEP * np.arange(record.samples - 1)
    recorded = hs.record(time=time, inputs=record.inputs, outputs=record.outputs[:-1], rig=rig)
    model = hs.identify(recorded, rig, "gray", part=(0, 0.6))
    assert model.parameters["weight"] == pytest.approx(PLANT.weight / PLANT.inertia, rel=0.02)
    assert model.parameters["gain"] == pytest.approx(PLANT.gain / PLANT.inertia, rel=0.02)
    found = model.evaluate(recorded, part=(0.6, 1))
    assert "an error grows by e in 0.48 s" in found.unstable
    first, *_ = found.ahead
    assert first.scores.r2 > 0.98
    assert all(scores["r2"] > 0.98 for scores in model.scores.values())


def test_modes_grow_where_the_record_passes_an_unstable_point():
    """s^2 = w cos q / J: at the bottom, q = pi, nothing grows, and at the top it does by sqrt(w / J)."""
    angles = np.linspace(np.pi, 2.0 * np.pi, 41)
    states = np.column_stack([angles, np.zeros(41)])
    passing = PreparedRecord(name="p", sampling=SAMPLING, inputs=np.zeros((40, 1)), outputs=states, states=states)
    resting = replace(passing, states=states[:10], outputs=states[:10], inputs=np.zeros((9, 1)))
    assert growth_along(PLANT, resting) == pytest.approx(0.0, abs=1e-9)
    assert growth_along(PLANT, passing) == pytest.approx(np.sqrt(PLANT.weight / PLANT.inertia), rel=0.01)


@pytest.mark.parametrize(("first", "part"), [(0.0001, True), (np.pi + 0.5, False), (0.5, False)])
def test_runs_part_where_the_noise_of_a_start_decides_on_which_side_of_the_top_they_fall(first, part):
    """Of .0005 rad, which the first 40 samples leave open, comes an error of a radian in log(2000) / 2.08 = 3.65 s."""
    states = simulate(PLANT, np.array([first, 0.0]), np.zeros((300, 1)), step=STEP)
    record = PreparedRecord(
        name="fallen", sampling=SAMPLING, inputs=np.zeros((300, 1)), outputs=states, states=states, noise=NOISE,
        deviations=NOISE,
    )  # fmt: skip
    found = parts_from(PLANT, record)
    assert (found is not None and 3.0 < found < 5.5) if part else found is None


@dataclass(frozen=True, kw_only=True)
class Cart(System):
    """m q'' = u."""

    states = ("place [m]", "rate [m/s]")
    inputs = ("push [N]",)
    outputs = ("place",)
    stepper = RungeKutta()

    mass: float = bounded(2.0, 0.1, 10.0, unit="kg")

    def law(self, x, u):
        return x[1], u[0] / self.mass


def test_runs_that_only_integrate_do_not_part():
    """An error of the first rate grows to twice the motion, and as far to either side."""
    states = simulate(Cart(), np.zeros(2), np.sin(np.arange(500)[:, None]), step=STEP)
    record = PreparedRecord(
        name="cart", sampling=SAMPLING, inputs=np.sin(np.arange(500)[:, None]), outputs=states[:, :1], states=states,
        noise=np.array([1e-3]), deviations=np.array([1e-3, 2.0 * float(np.std(states[:, 0]))]),
    )  # fmt: skip
    assert parts_from(Cart(), record) is None


HANGING = """
from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import sin


@dataclass(frozen=True, kw_only=True)
class Hanging(System):
    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("angle",)
    stepper = RungeKutta()
    inertia: float = bounded(0.03, 0.001, 1.0, unit="kg m^2")
    weight: float = bounded(0.5, 0.0, 10.0, unit="N m")
    damping: float = bounded(0.02, 0.0, 1.0, unit="N m s/rad")

    def law(self, x, u):
        return x[1], (u[0] - self.weight * sin(x[0]) - self.damping * x[1]) / self.inertia
"""
GOING_ROUND = """
step: 0.01
actuators: {torque: {low: -1.5, high: 1.5}}
sensors: {angle: {white_noise: 0.0005}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_a_pendulum_that_goes_over_the_top_is_found_within_its_errors(tmp_path, seed):
    """Free runs go to either side of the top, so that their slopes say nothing: an error was 20 000 deviations."""
    folder = tmp_path / "hanging"
    folder.mkdir()
    (folder / "system.py").write_text(HANGING)
    (folder / "rig.yaml").write_text(GOING_ROUND)
    times, x, angles = 0.01 * np.arange(2000), np.zeros(2), []
    torques = multisine(seed, amplitude=0.9, low=0.1, high=3.0, lines=30, period=20.0)(times)

    def law(_, x, torque):
        return x[1], (torque - 0.8 * np.sin(x[0]) - 0.01 * x[1]) / 0.02

    for torque in torques.tolist():
        angles.append(x[0])
        x = solve_ivp(law, (0.0, 0.01), x, args=(torque,), rtol=1e-9, atol=1e-9).y[:, -1]
    assert np.ptp(angles) > 2.0 * np.pi
    measured = np.array(angles) + 0.0005 * np.random.default_rng(seed).standard_normal(2000)
    rig = hs.load_rig(folder)
    model = hs.identify(hs.record(time=times, inputs=torques, outputs=measured, rig=rig), rig, "gray")
    for name, true in {"inertia": 0.02, "weight": 0.8, "damping": 0.01}.items():
        error = model.standard_errors[name]
        assert abs(model.parameters[name] - true) < 3.0 * error < 0.01 * true

"""State spaces: every form agrees, derivatives are exact, and known systems come back."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import dlsim

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.core import System, Variable, one_step, rollouts
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.extensions.state_space import tangents
from hybrid_sysid_ros.extensions.state_space.identification import (
    StateSpaceSettings,
    _free_runs,
    identify_state_space,
    options_of,
)
from hybrid_sysid_ros.extensions.state_space.order_selection import comparable, select_order
from hybrid_sysid_ros.extensions.state_space.periods import period_of, spectrum_of
from hybrid_sysid_ros.extensions.state_space.refinement import _roles, free_weights, simulated, unit_states
from hybrid_sysid_ros.extensions.state_space.state_space import StateSpace
from hybrid_sysid_ros.extensions.state_space.subspace import (
    completed,
    in_frequency,
    in_time,
    observability,
    poles_and_readout,
)
from hybrid_sysid_ros.extensions.state_space.tests.systems import state_space
from hybrid_sysid_ros.identification import free_run, score
from hybrid_sysid_ros.identification.validation.left_out import free_run_of, left_out
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.models.structure import structure_of
from hybrid_sysid_ros.support.errors import UserError

A = np.array([[0.9, 0.3, 0.0], [-0.3, 0.9, 0.2], [0.0, 0.0, 0.5]])
B = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, -1.0]])
C = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, -1.0]])
D = np.array([[0.0, 0.2], [0.0, 0.0]])
POLES: Any = np.sort_complex(np.linalg.eigvals(A))


def simulation(inputs, noise=0.0, seed=0):
    _, outputs, _ = dlsim((A, B, C, D, 1.0), inputs, x0=[1.0, -1.0, 0.5])
    return outputs + noise * np.random.default_rng(100 + seed).normal(size=outputs.shape)


def noise_driven(samples=1500, noise=0.0, seed=0):
    inputs = np.random.default_rng(seed).normal(size=(samples, 2))
    return inputs, simulation(inputs, noise, seed)


def prepared(inputs, outputs, name="arrays"):
    return PreparedRecord(
        name=name, sampling=Sampling(step=0.05, period=0.05), inputs=inputs[:-1], outputs=outputs,
        states=np.zeros((len(outputs), 3)),
    )  # fmt: skip


@pytest.mark.parametrize("power", [0, 3])
def test_the_compiled_and_the_casadi_form_are_the_equation(power):
    system, random = state_space(power=power), np.random.default_rng(1)
    n, wide, units = system.order, system.order + 2, system.units
    state, rest = np.split(system.weights, [n * wide])
    rest, output = np.split(rest, [units * (wide + n)])
    state, rest = state.reshape(n, wide), rest.reshape(units, wide + n)
    symbolic = symbolic_step(system, step=0.05)
    for _ in range(20):
        x, u = random.normal(size=n), random.normal(size=1) * 4.0
        z = np.concatenate([x, (u - 0.3) / 4.0, [1.0]])
        s = rest[:, :wide] @ z
        hidden = np.clip(s, -3.0, 3.0) ** power if power else np.tanh(s)
        following = one_step(system, x, u, step=0.05)
        np.testing.assert_allclose(following, state @ z + rest[:, wide:].T @ hidden, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(np.array(symbolic(x, u)).ravel(), following, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(output_of(system, x, u), 0.01 + 0.05 * (output @ z), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("units", "power"), [(0, 0), (2, 0), (2, 3)])
def test_tangents_are_what_simulations_differ_by(units, power):
    random = np.random.default_rng(1)
    sizes = tangents.Sizes(states=3, inputs=2, outputs=2, units=units, power=power)
    weights = 0.2 * random.normal(size=sizes.count)
    weights[: 3 * sizes.wide].reshape(3, -1)[:, :3] = np.triu(0.4 * random.normal(size=(3, 3)))
    inputs, wanted, first = random.normal(size=(50, 2)), random.normal(size=(50, 2)), random.normal(size=3)
    free = free_weights(weights, sizes, through=True)
    columns = len(free) + 3
    jacobian, errors, tangent = np.empty((100, columns)), np.empty((50, 2)), np.zeros((3, columns))
    tangent[:, len(free) :] = np.eye(3)
    roles = _roles(free, sizes)
    tangents.tangents(weights, sizes.numbers, roles, inputs, wanted, first.copy(), tangent, errors, jacobian)
    np.testing.assert_allclose(wanted - errors, simulated(weights, sizes, inputs, first), rtol=1e-12)
    for column in range(columns):
        moved = []
        for change in (1e-6, -1e-6):
            others, begin = weights.copy(), first.copy()
            if column < len(free):
                others[free[column]] += change
            else:
                begin[column - len(free)] += change
            moved.append(simulated(others, sizes, inputs, begin).ravel())
        np.testing.assert_allclose(jacobian[:, column], (moved[0] - moved[1]) / 2e-6, atol=1e-8)


def test_states_of_another_size_are_the_same_model():
    random = np.random.default_rng(2)
    sizes = tangents.Sizes(states=3, inputs=1, outputs=1, units=2, power=3)
    weights, inputs = state_space(power=3).weights, random.normal(size=(200, 1))
    first = random.normal(size=(1, 3))
    before = simulated(weights, sizes, inputs, first[0])
    changed, starts = unit_states(weights, sizes, [(inputs, before)], first)
    np.testing.assert_allclose(simulated(changed, sizes, inputs, starts[0]), before, rtol=1e-9)


def test_subspaces_in_time_find_the_system_that_made_the_data():
    stretches = [noise_driven(seed=0), noise_driven(400, seed=1)]
    a, c = poles_and_readout(observability(in_time(stretches, 8), 8, 2, 2)[0], 3, 2)
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(a)), POLES, atol=1e-9)
    model = completed(a, c, stretches, True)
    np.testing.assert_allclose(model.d, D, atol=1e-9)
    gain = model.c @ np.linalg.solve(np.eye(3) - model.a, model.b)
    np.testing.assert_allclose(gain, C @ np.linalg.solve(np.eye(3) - A, B), atol=1e-8)


def test_subspaces_in_frequency_find_the_system_from_its_steady_periods():
    period = np.random.default_rng(3).normal(size=(200, 2))
    inputs = np.tile(period, (5, 1))
    assert period_of(inputs) == 200
    spectrum = spectrum_of((inputs, simulation(inputs)))
    assert spectrum is not None
    a, _ = poles_and_readout(observability(in_frequency([spectrum], 8), 8, 2, 2)[0], 3, 2)
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(a)), POLES, atol=1e-6)


@pytest.mark.parametrize("inputs", [np.random.default_rng(0).normal(size=(600, 1)), np.arange(600.0)[:, None]])
def test_an_input_that_does_not_repeat_itself_has_no_period(inputs):
    assert period_of(inputs) == 0


def test_the_order_and_the_way_through_are_those_of_the_system():
    inputs, outputs = noise_driven(2000, noise=0.05)
    found = select_order([(inputs, outputs)], orders=(1, 2, 3, 4, 5, 6), through=None)
    assert (found.order, found.through) == (3, True)
    later = simulation(inputs) - inputs @ D.T
    assert not select_order([(inputs, later + 0.05)], orders=(2, 3), through=None).through


def test_a_fit_needs_only_inputs_and_outputs_and_predicts_unseen_records():
    y, u = (tuple(Variable(name=f"{kind}{i}", unit="V") for i in range(2)) for kind in "yu")
    inputs, outputs = noise_driven(1200, noise=0.05)
    unseen, truth = noise_driven(500, seed=9)
    fit = identify_state_space([prepared(inputs, outputs)], y, u, StateSpaceSettings(highest=5))
    system: Any = fit.system
    assert system.order == 3
    assert score(truth[:, 0], free_run(system, prepared(unseen, truth))[:, 0]).r2 > 0.999
    poles: Any = np.sort_complex(np.linalg.eigvals(system.matrices()[0]))
    np.testing.assert_allclose(poles, POLES, atol=0.01)


@dataclass(frozen=True, kw_only=True)
class LateLag(System):
    """T y' = u - y, 2 s late."""

    states = ("y [V]",)
    inputs = ("u [V]",)
    delays = {"u": 2.0}

    def law(self, x, u):
        return (u[0] - x[0],)


def smooth_and_steps(order, samples=1500):
    """A lag of two states under a multisine up to a fortieth of the sampling rate, with noise, and under jumps."""
    random, times = np.random.default_rng(0), np.arange(samples)
    hertz = np.geomspace(0.002, 0.025, 20)
    smooth = np.sin(2 * np.pi * (np.outer(times, hertz) + random.uniform(size=20))).sum(axis=1, keepdims=True)
    jumps = np.repeat(random.uniform(-5, 5, samples // 30), 30)[:, None]
    law = np.array([[0.95, 0.1], [-0.1, 0.9]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)), 1.0
    answers = [dlsim(law, inputs)[1] for inputs in (smooth, jumps)]
    noise = 0.05 * answers[0].std() * random.normal(size=(samples, 1))
    pairs = ((smooth, answers[0] + noise), (jumps, answers[1]))
    return tuple(replace(prepared(*pair), states=np.zeros((samples, order))) for pair in pairs)


def test_what_no_record_excites_stays_small_in_a_model_of_too_high_an_order():
    (y,), (u,) = ((Variable(name=name, unit="V"),) for name in "yu")
    record, unseen = smooth_and_steps(8)
    system = identify_state_space([record], (y,), (u,), StateSpaceSettings(order=8)).system
    assert score(unseen.outputs[:, 0], free_run(system, unseen)[:, 0]).r2 > 0.99


@pytest.mark.parametrize(("order", "noise", "seed"), [(2, 0.01, 3), (3, 0.1, 0), (5, 0.01, 4)])
def test_an_integrator_in_noise_is_not_fitted_as_what_runs_away(order, noise, seed):
    """Its pole at 1 is as often found beyond the circle as within."""
    (y,), (u,) = ((Variable(name=name, unit="V"),) for name in "yu")
    random = np.random.default_rng(seed)
    inputs = np.repeat(random.uniform(-1.0, 1.0, (40, 1)), 30, axis=0)
    charge = np.cumsum(inputs, axis=0) - inputs
    record = prepared(inputs, charge + noise * charge.std() * random.normal(size=charge.shape))
    system: Any = identify_state_space([record], (y,), (u,), StateSpaceSettings(order=order)).system
    assert 0.99 < system.radius < 1.0 + 1e-9
    without: list[Any] = [block.system for block in left_out(system, [record], {}, 1.0)]
    assert all(other.radius < 1.0 + 1e-9 for other in without)


def saturating_drive(seed, samples=1500):
    """x+ = .8 x + .25 tanh(u) (1 + .3 x) - .05 x^3, of which any linear model has slow errors."""
    random = np.random.default_rng(seed)
    u, x, filled = np.empty(samples), np.zeros(samples), 0
    while filled < samples:
        held = int(random.integers(3, 30))
        u[filled : filled + held], filled = random.uniform(-2.5, 2.5), filled + held
    for k in range(samples - 1):
        x[k + 1] = 0.8 * x[k] + 0.25 * np.tanh(u[k]) * (1.0 + 0.3 * x[k]) - 0.05 * x[k] ** 3
    return prepared(u[:, None], (x + 0.01 * random.normal(size=samples))[:, None])


def missed(record, **settings):
    given = Variable(name="y", unit="1"), Variable(name="u", unit="1")
    system = identify_state_space([record], (given[0],), (given[1],), StateSpaceSettings(**settings)).system
    assert isinstance(system, StateSpace)
    return _free_runs(system, [record])


def test_an_order_is_not_chosen_for_modes_that_its_first_states_alone_move():
    record = saturating_drive(seed=16)
    assert missed(record) < missed(record, order=2)


def test_units_move_although_the_linear_part_stands_on_the_circle():
    assert missed(saturating_drive(seed=1), order=4, units=4, starts=1) < 1e-3


def test_a_block_is_left_out_of_a_fit_that_goes_on_without_it():
    (y,), (u,) = ((Variable(name=name, unit="V"),) for name in "yu")
    record, _ = smooth_and_steps(2)
    broken = replace(record, outputs=record.outputs.copy())
    broken.outputs[400:700] *= 2.0
    system = identify_state_space([broken], (y,), (u,), StateSpaceSettings(order=2)).system
    blocks = left_out(system, [broken], {}, 1.0)
    assert [block.samples for block in blocks] == [slice(k, k + 375) for k in range(0, 1500, 375)]
    gains = [score(record.outputs, free_run_of(block.system, record)).r2 for block in blocks]
    assert np.argmax(gains) == 1  # most of what is broken


def test_a_declared_dead_time_needs_no_states():
    """A lag of two states behind 40 samples: the sample that is left of these is a third state."""
    structure = structure_of("state_space", LateLag())
    record, unseen = smooth_and_steps(3)
    late = [replace(item, outputs=np.vstack([np.zeros((40, 1)), item.outputs[:-40]])) for item in (record, unseen)]
    context: Any = SimpleNamespace(
        experiments=lambda system: late[:1],
        options={name: item.default for name, item in structure.options.items()} | {"order": 3},
        sampling=record.sampling, seed=0, progress=None,
    )  # fmt: skip
    system: Any = structure.fit(context).system
    assert system.input_delays.tolist() == [pytest.approx(39 * 0.05)]
    assert structure.assemble(system.design, system.weights).delays == system.delays
    run = free_run(system, late[1])  # of its first samples no record has the input
    assert score(late[1].outputs[100:, 0], run[100:, 0]).r2 > 0.99


def test_a_band_limited_input_is_read_when_the_outputs_are():
    """The mean of two samples of it would hide what acts at once."""
    structure = structure_of("state_space", hs.load_rig("wheel_motor").system)
    holds = structure.sampling(Sampling(step=0.005, period=0.02, input="interpolated"))
    assert (holds.step, holds.input) == (0.02, "sampled")
    assert structure.sampling(Sampling()).input == "averaged"


@pytest.mark.parametrize(
    ("pole", "words"), [(0.5, "mode: time constant 0.07213 s"), (-0.5, "mode: 10.24 Hz, damping 0.215")]
)
def test_a_pole_that_changes_its_sign_each_sample_is_an_oscillation(pole, words):
    """Of half the sampling rate, 10 Hz, damped by ln 2 / sqrt(pi^2 + ln^2 2)."""
    system = state_space(order=1, units=0)
    structure = structure_of("state_space", hs.load_rig("wheel_motor").system)
    assert structure.lines(system.with_weights(np.array([pole, *system.weights[1:]])))[1] == words


def test_units_in_the_feedback_learn_a_spring_that_hardens():
    """A resonance with a cubic spring, where a linear model is wrong by tenths."""
    random, x = np.random.default_rng(4), np.zeros(2)
    inputs, outputs = random.normal(size=(3000, 1)), np.empty((3000, 1))
    for k, u in enumerate(inputs[:, 0]):
        outputs[k] = x[0]
        x = np.array([x[0] + 0.3 * x[1], 0.85 * x[1] - 0.3 * x[0] - 0.4 * x[0] ** 3 + 0.05 * u])
    signals = (Variable(name="y", unit="V"),), (Variable(name="u", unit="V"),)
    known: dict[str, Any] = {"order": 2, "through": False}
    more_or_less: tuple[dict[str, Any], ...] = ({}, {"units": 1, "power": 3, "starts": 1})
    errors = [
        identify_state_space([prepared(inputs, outputs)], *signals, StateSpaceSettings(**known, **more)).relative_error
        for more in more_or_less
    ]
    assert errors[0] > 0.05
    assert errors[1] < 1e-3


def test_units_do_not_hold_what_runs_away_where_they_saturate():
    """x+ = 1.05 x - .25 tanh x + .3 u is stable where the record is, and leaves it for ever beyond 5."""
    inputs = np.random.default_rng(0).normal(size=(800, 1))
    x = np.zeros((801, 1))
    for k in range(800):
        x[k + 1] = 1.05 * x[k] - 0.25 * np.tanh(x[k]) + 0.3 * inputs[k]
    assert np.abs(x).max() < 3.0
    record = prepared(np.vstack([inputs, [[0.0]]]), x)
    settings = StateSpaceSettings(order=1, units=1, through=False)
    found = identify_state_space([record], (Variable(name="y", unit=""),), (Variable(name="u", unit=""),), settings)
    assert found.relative_error < 0.2
    assert isinstance(found.system, StateSpace)
    assert found.system.radius <= 1.0


def test_beginnings_of_units_are_compared_by_free_runs_from_the_first_samples():
    """A model over its own run misses nothing, whatever state the run begins in; one whose input turned round does."""
    system, random = state_space(), np.random.default_rng(0)
    inputs = random.normal(size=(300, len(system.inputs)))
    first = random.normal(size=len(system.states))
    starts = np.array([[0, 0, 300, 0]])
    outputs = rollouts(system, starts, first[None], inputs, step=0.05)[1]
    record = prepared(inputs, outputs)
    assert _free_runs(system, [record]) < 1e-3
    assert _free_runs(system, [replace(record, inputs=-record.inputs)]) > 0.1


def test_too_few_samples_to_compare_orders_are_said_with_what_to_do() -> None:
    with pytest.raises(UserError, match=r"80 samples, in parts of 59 at most, .* or an order"):
        comparable([(np.zeros((count, 3)), np.zeros((count, 1))) for count in (59, 21)], 10)


def test_what_can_not_be_fitted_is_refused():
    signals = (Variable(name="y", unit="V"),), (Variable(name="u", unit="V"),)
    short = prepared(np.random.default_rng(0).normal(size=(60, 1)), np.random.default_rng(1).normal(size=(60, 1)))
    with pytest.raises(UserError, match="59 samples"):
        identify_state_space([short], *signals, StateSpaceSettings())
    options = {"order": 2, "highest": 4, "feedthrough": 2, "units": 0, "power": 3, "ridge": 1e-8, "starts": 1}
    for wrong, reason in (({}, "power is that of units"), ({"units": 1, "power": 1}, "is linear")):
        with pytest.raises(UserError, match=reason):
            options_of({**options, **wrong})


@pytest.mark.slow
def test_its_model_is_kept_estimated_and_controlled_as_any_other(tmp_path):
    """By the exact MPC, from an estimator that has to find states that nobody measures."""
    rig = hs.load_rig("wheel_motor")
    record = hs.read_bag(Path(__file__).parents[4] / "bags" / "wheel_motor_multisine", rig)
    hs.identify(record, rig, "state_space", options={"order": 2, "feedthrough": 0}).save(tmp_path / "model")
    model = hs.load_model(tmp_path / "model")
    loop = hs.simulate(rig, model, controller="exact", reference=[150.0], seconds=1)
    late = loop.outputs[-20:, 0] - loop.reference[-20:, 0]
    assert np.abs(late).max() < 0.1 * loop.reference[-1, 0]

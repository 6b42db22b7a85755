"""A slow controller above a stabiliser: when it is asked, what it is told, and what comes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc, MpcSolution, StageTerm, Status
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.core import RungeKutta, System, simulate
from hybrid_sysid_ros.core.wrappers import RateDisturbanceModel, Stabilised
from hybrid_sysid_ros.extensions.shared.steady_motion import steady_motion
from hybrid_sysid_ros.support.errors import UserError
from tests.upright import GAINS, Upright

SAMPLE, PERIOD, HORIZON = 0.02, 0.5, 8
LIMITS = np.array([-4.0]), np.array([4.0])


class Asked:
    """Answers with how often it was asked."""

    horizon, period = HORIZON, PERIOD

    def __init__(self) -> None:
        self.times: list[float] = []
        self.before: list[float] = []
        self.prepared: list[float] = []
        self.now = 0.0

    def control(self, state, disturbance, previous_input, preview):
        self.times.append(self.now)
        self.before.append(float(previous_input[0]))
        value = np.array([float(len(self.times))])
        return MpcSolution(value, np.tile(value, (HORIZON, 1)), np.ones((HORIZON, 2)), Status.SOLVED)

    def prepare(self, elapsed):
        self.prepared.append(elapsed)

    def reset(self):
        pass


@pytest.fixture
def stabilised() -> Stabilised:
    return Stabilised(physics=Upright(), gains=GAINS)


def asked(cascade: Cascade, state: np.ndarray, previous: float = 0.0) -> MpcSolution:
    return cascade.control(state, np.zeros(1), np.array([previous]), np.zeros((HORIZON, 1)))


def test_parameters_of_the_stages_reach_the_controller_and_are_refused_where_there_are_none(stabilised):
    inner = ExactMpc(
        stabilised,
        ControlProblem(
            horizon=HORIZON,
            period=PERIOD,
            substeps=10,
            output_weights=(1.0,),
            input_low=(-4.0,),
            input_high=(4.0,),
            terms=(StageTerm(name="bounded", value=f"{stabilised.inputs[0].name} - most", high=0.0),),
            stage_parameters=(("most", (3.0,)),),
        ),
    )
    Cascade(inner, stabilised, LIMITS).assign(most=1.0)
    np.testing.assert_array_equal(inner.shooting.prediction.stage, 1.0)
    with pytest.raises(UserError, match="Asked has no assign"):
        Cascade(Asked(), stabilised, LIMITS).assign(most=1.0)


def test_the_controller_is_asked_once_a_period_and_prepares_once(stabilised):
    inner = Asked()
    cascade = Cascade(inner, stabilised, LIMITS)
    for k in range(101):
        inner.now = k * SAMPLE
        asked(cascade, np.zeros(2))
        cascade.prepare(SAMPLE)
    assert np.allclose(inner.times, [0.0, 0.5, 1.0, 1.5, 2.0], atol=1e-9)
    assert inner.prepared == [PERIOD] * 5


def test_the_stabiliser_answers_every_state_within_the_limits(stabilised):
    cascade = Cascade(Asked(), stabilised, LIMITS)
    for state in ([0.0, 0.0], [0.05, -0.1], [1.0, 1.0], [-1.0, -1.0]):
        plan = asked(cascade, np.array(state))
        assert plan.input[0] == np.clip(1.0 - np.dot(GAINS[0], state), -4.0, 4.0)
        assert cascade.held(np.array(state))[0] == np.clip(-np.dot(GAINS[0], state), -4.0, 4.0)  # when it is stopped
        cascade.prepare(0.0)


def test_the_controller_is_told_what_was_added_before(stabilised):
    inner = Asked()
    cascade = Cascade(inner, stabilised, LIMITS)
    state = np.array([0.1, 0.2])
    for _ in range(2):
        asked(cascade, state, previous=0.5)  # of the first plan it follows from the input itself
        cascade.prepare(PERIOD)
    assert inner.before == [pytest.approx(0.5 + np.dot(GAINS[0], state)), 1.0]


def test_a_state_that_is_no_number_gives_a_finite_input(stabilised):
    cascade = Cascade(Asked(), stabilised, LIMITS)
    assert np.isfinite(asked(cascade, np.array([np.nan, 0.0])).input).all()


def problem(**values) -> ControlProblem:
    return ControlProblem(
        horizon=HORIZON, period=PERIOD, substeps=10, output_weights=(1.0,), rate_weights=(1e-3,),
        input_low=(-3.0,), input_high=(3.0,), **values,
    )  # fmt: skip


@pytest.mark.slow
def test_it_brings_what_falls_to_a_reference_by_plans_half_a_second_apart(stabilised):
    mpc = ExactMpc(stabilised, problem())
    cascade, x, u = Cascade(mpc, stabilised, LIMITS), np.array([0.1, 0.0]), np.zeros(1)
    for _ in range(300):
        plan = cascade.control(x, np.zeros(1), u, np.full((HORIZON, 1), 0.2))
        u = plan.input
        x = simulate(Upright(), x, u[None], step=SAMPLE)[-1]
        cascade.prepare(SAMPLE)
    assert x == pytest.approx([0.2, 0.0], abs=2e-3)


def test_an_offset_of_a_rate_that_is_planned_with_leaves_no_error():
    """A wind at the place itself, which no input can answer at once: p' = s + w, s' = u."""

    @dataclass(frozen=True, kw_only=True)
    class Carried(System):
        states = ("place [m]", "speed [m/s]")
        inputs = ("push [m/s^2]",)
        outputs = ("place",)
        stepper = RungeKutta()

        def law(self, x, u):
            return x[1], u[0]

    system, wind = RateDisturbanceModel(physics=Carried(), on=("place",)), 0.3
    found = {}
    for reported in (wind, 0.0):
        mpc, x, u = ExactMpc(system, problem()), np.array([0.0, 0.0, wind]), np.zeros(1)
        for _ in range(80):
            u = mpc.control(np.array([*x[:2], reported]), np.zeros(1), u, np.full((HORIZON, 1), 1.0)).input
            x = simulate(system, x, np.tile(u, (10, 1)), step=PERIOD / 10)[-1]
            mpc.prepare(PERIOD)
        found[reported] = x
    assert found[wind][:2] == pytest.approx([1.0, -wind], abs=1e-3)
    assert abs(found[0.0][0] - 1.0) > 0.05


def test_an_offset_has_no_part_in_a_steady_motion(stabilised):
    """It could hold what an input is to hold, but nothing moves it."""
    system = RateDisturbanceModel(physics=stabilised, on=("speed",))
    motion = steady_motion(system, problem().sized(system), np.array([0.2]))
    assert motion.state == pytest.approx([0.2, 0.0, 0.0], abs=1e-9)

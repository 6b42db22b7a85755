"""Mechanical problems: a swing-up, a chain, cars, a disc of thrust, an obstacle that moves, masses, a kite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from benchmarks.mpc_gallery.case import Case
from hybrid_sysid_ros.control import ControlProblem, StageTerm
from hybrid_sysid_ros.core import RungeKutta, System
from hybrid_sysid_ros.core.mathematics import Scalar, cos, maximum, sin, sqrt

Values = Sequence[Scalar]


@dataclass(frozen=True, kw_only=True)
class CartPendulum(System):
    """A pole of 0.1 kg and 0.8 m on a cart of 1 kg; at an angle of 0 it stands."""

    states = ("position [m]", "angle [rad]", "speed [m/s]", "rate [rad/s]")
    inputs = ("force [N]",)
    outputs = ("position", "angle", "speed", "rate")
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        mass, pole, length, g = 1.0, 0.1, 0.8, 9.81
        below = mass + pole - pole * cos(x[1]) ** 2
        pull = pole * length * sin(x[1]) * x[3] ** 2
        push = pole * g * cos(x[1]) * sin(x[1]) - pull + u[0]
        turn = u[0] * cos(x[1]) + (mass + pole) * g * sin(x[1]) - pull * cos(x[1])
        return x[2], x[3], push / below, turn / (length * below)


def swing_up() -> Case:
    """From hanging to standing within a second, with at most 80 N."""
    problem = ControlProblem(
        horizon=20,
        period=0.05,
        substeps=1,
        output_weights=(1e3, 1e3, 1e-2, 1e-2),
        input_weights=(1e-2,),
        input_low=(-80.0,),
        input_high=(80.0,),
        max_iterations=500,
    )
    return Case(
        source="acados, getting started",
        system=CartPendulum(),
        problem=problem,
        state=(0.0, np.pi, 0.0, 0.0),
        drawn=("", "angle"),
    )


@dataclass(frozen=True, kw_only=True)
class Chain(System):
    """Masses of 0.03 kg in space between a fixed end and one whose velocity is the input, on springs of 1 N/m that are
    33 mm long at rest.
    """

    states = tuple(
        f"{what}{number}_{axis} [{unit}]"
        for what, unit, last in (("p", "m", 3), ("v", "m/s", 2))
        for number in range(1, last + 1)
        for axis in "xyz"
    )
    inputs = ("x_speed [m/s]", "y_speed [m/s]", "z_speed [m/s]")
    outputs = ("p3_x", "p3_y", "p3_z", *(f"v{number}_{axis}" for number in (1, 2) for axis in "xyz"))
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        places = [[0.0, 0.0, 0.0], *([x[3 * i + k] for k in range(3)] for i in range(3))]
        forces = []
        for one, other in pairwise(places):
            along = [b - a for a, b in zip(one, other, strict=True)]
            stretch = 1.0 - 0.033 / sqrt(sum(part * part for part in along) + 1e-12)
            forces.append([stretch * part for part in along])
        rates = [
            (forces[i + 1][k] - forces[i][k]) / 0.03 - (9.81 if k == 2 else 0.0) for i in range(2) for k in range(3)
        ]
        return [*x[9:], *u, *rates]


def chain() -> Case:
    """The free end is brought back from the side, and the masses keep clear of a wall behind it (softly)."""
    wall = tuple(StageTerm(name=f"clear{i}", value=f"p{i}_y", low=-0.05, soft_linear=10.0) for i in (1, 2, 3))
    problem = ControlProblem(
        horizon=20,
        period=0.2,
        substeps=2,
        output_weights=(25.0, 25.0, 25.0, *[1.0] * 6),
        input_weights=(0.01,),
        input_low=(-1.0,),
        input_high=(1.0,),
        terms=wall,
    )
    start = (0.3, 0.05, -0.3, 0.6, 0.1, -0.3, 0.8, 0.3, 0.1, *[0.0] * 6)
    target = (1.0, 0.0, 0.0, *[0.0] * 6)
    return Case(
        source="acados, chain of masses",
        system=Chain(),
        problem=problem,
        state=start,
        target=target,
        drawn=("p3_x", "p3_y"),
    )


@dataclass(frozen=True, kw_only=True)
class RaceCar(System):
    """A small car along a track of changing bend: a kinematic bicycle in coordinates of the track."""

    states = ("s [m]", "n [m]", "heading [rad]", "speed [m/s]", "duty [1]", "steering [rad]")
    inputs = ("duty_rate [1/s]", "steering_rate [rad/s]")
    outputs = ("s", "n", "duty", "steering")
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        _, n, heading, speed, duty, steering = x
        bend, slip = 1.5 * sin(2.0 * x[0]), 0.5 * steering
        forward = ((0.28 - 0.05 * speed) * duty - 0.006 * speed**2 - 0.011) / 0.043
        along = speed * cos(heading + slip) / (1.0 - n * bend)
        turn = speed * 15.5 * steering
        return along, speed * sin(heading + slip), turn - bend * along, forward * cos(slip), u[0], u[1]


def race_car() -> Case:
    """As far as possible within a second, on the track and within the grip."""
    terms = (
        StageTerm(name="progress", value="s", price=-1.0, final=True),
        StageTerm(name="grip", value="speed**2 * 15.5 * steering", low=-4.0, high=4.0, soft_linear=1.0),
        StageTerm(name="obstacle", value="(s - 1.6)**2 + (n - 0.05)**2", low=0.01, soft_linear=100.0),
    )
    problem = ControlProblem(
        horizon=50,
        period=0.02,
        substeps=1,
        output_weights=(0.0, 1e-2, 1e-3, 5e-3),
        input_weights=(1e-5, 5e-4),
        input_low=(-10.0, -2.0),
        input_high=(10.0, 2.0),
        state_low=(-np.inf, -0.12, -np.inf, -np.inf, -1.0, -0.4),
        state_high=(np.inf, 0.12, np.inf, np.inf, 1.0, 0.4),
        soft_linear=(100.0,),
        terms=terms,
        max_iterations=300,
    )
    return Case(
        source="modelled on acados, race cars",
        system=RaceCar(),
        problem=problem,
        state=(0.0, 0.0, 0.0, 1.0, 0.3, 0.0),
        drawn=("s", "n"),
    )


@dataclass(frozen=True, kw_only=True)
class Unicycle(System):
    """A vehicle with a speed and a turning rate of its own."""

    states = ("x [m]", "y [m]", "heading [rad]", "speed [m/s]", "turn [rad/s]")
    inputs = ("acceleration [m/s^2]", "turn_rate [rad/s^2]")
    outputs = ("x", "y", "speed")
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        return x[3] * cos(x[2]), x[3] * sin(x[2]), x[4], u[0], u[1]


def moving_obstacle() -> Case:
    """Straight ahead, around a disc that crosses from the right."""
    stages = 0.1 * np.arange(1, 31)
    terms = (StageTerm(name="clearance", value="(x - disc_x)**2 + (y - disc_y)**2", low=0.64, soft_linear=50.0),)
    problem = ControlProblem(
        horizon=30,
        period=0.1,
        substeps=1,
        output_weights=(1.0, 1.0, 0.1),
        input_weights=(0.05, 0.05),
        input_low=(-1.0,),
        input_high=(1.0,),
        state_low=(-np.inf, -np.inf, -np.inf, 0.0, -1.5),
        state_high=(np.inf, np.inf, np.inf, 1.5, 1.5),
        terms=terms,
        stage_parameters=(("disc_x", (2.0,)), ("disc_y", tuple(-1.2 + 0.8 * stages))),
        max_iterations=300,
    )
    return Case(
        source="textbook unicycle",
        system=Unicycle(),
        problem=problem,
        state=(0.0, 0.0, 0.0, 1.0, 0.0),
        target=(3.5, 0.0, 0.0),
        drawn=("x", "y"),
    )


@dataclass(frozen=True, kw_only=True)
class Hovercraft(System):
    """A point of 1 kg in the plane, with drag that grows with the square of its speed."""

    states = ("x [m]", "y [m]", "x_speed [m/s]", "y_speed [m/s]")
    inputs = ("x_force [N]", "y_force [N]")
    outputs = ("x", "y")
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        drag = 0.3 * sqrt(x[2] ** 2 + x[3] ** 2 + 1e-4)
        return x[2], x[3], u[0] - drag * x[2], u[1] - drag * x[3]


def thrust_disc() -> Case:
    """The force is within a disc, without exception, and changes by at most 4 N/s."""
    problem = ControlProblem(
        horizon=25,
        period=0.1,
        substeps=1,
        output_weights=(10.0, 10.0),
        final_output_weights=(100.0, 100.0),
        input_weights=(0.1,),
        input_low=(-2.0,),
        input_high=(2.0,),
        rate_limits=(0.4,),
        terms=(StageTerm(name="thrust", value="x_force**2 + y_force**2", high=1.0, hard=True),),
    )
    return Case(
        source="modelled on acados, hover craft and disc constraint",
        system=Hovercraft(),
        problem=problem,
        state=(1.0, -0.6, 0.0, 0.5),
        drawn=("x", "y"),
    )


@dataclass(frozen=True, kw_only=True)
class Masses(System):
    """Two masses of 1 kg between walls on three springs of 1 N/m, each pushed."""

    states = ("first [m]", "first_speed [m/s]", "second [m]", "second_speed [m/s]")
    inputs = ("force [N]",)
    outputs = ("first", "first_speed", "second", "second_speed")
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        return x[1], -2.0 * x[0] + x[2] + u[0], x[3], x[0] - 2.0 * x[2]


def masses() -> Case:
    """All comes to rest, within 4 of every position and 0.5 of the force."""
    problem = ControlProblem(
        horizon=20,
        period=0.5,
        substeps=2,
        output_weights=(1.0,),
        rate_weights=(1e-4,),
        input_low=(-0.5,),
        input_high=(0.5,),
        state_low=(-4.0,),
        state_high=(4.0,),
        soft_linear=(10.0,),
    )
    return Case(
        source="do-mpc, oscillating masses",
        system=Masses(),
        problem=problem,
        state=(2.5, 1.0, -2.0, 0.5),
        drawn=("", "first"),
    )


def masses_uneven() -> Case:
    """The same over twice the time, by ten intervals and inputs in place of forty."""
    case = masses()
    problem = replace(case.problem, horizon=40, intervals=(1, 1, 1, 1, 2, 2, 4, 4, 8, 16))
    return replace(case, source="modelled on acados, non-uniform grids", problem=problem)


@dataclass(frozen=True, kw_only=True)
class Kite(System):
    """A kite on 400 m of rope in 10 m/s of wind; steering costs some of its glide ratio of 6."""

    states = ("polar [rad]", "azimuth [rad]", "heading [rad]")
    inputs = ("steering [1]",)
    outputs = ("polar", "azimuth")
    stepper = RungeKutta()

    def law(self, x: Values, u: Values) -> Values:
        glide = 6.0 - 0.028 * u[0] ** 2
        rate = 10.0 * glide * cos(x[0]) / 400.0
        turn = -rate / maximum(sin(x[0]), 0.01) * sin(x[2])
        return rate * (cos(x[2]) - sin(x[0]) / cos(x[0]) / glide), turn, rate * u[0] + turn * cos(x[0])


def kite() -> Case:
    """As much pull as possible, above 100 m (softly)."""
    glide = "(6 - 0.028 * steering**2)"
    pull = f"cos(polar)**3 * ({glide} + 1) * sqrt({glide}**2 + 1)"
    problem = ControlProblem(
        horizon=40,
        period=0.15,
        substeps=1,
        output_weights=(0.0,),
        rate_weights=(1e-2,),
        input_low=(-10.0,),
        input_high=(10.0,),
        terms=(
            StageTerm(name="pull", value=pull, price=-0.1),
            StageTerm(name="height", value="sin(polar) * cos(azimuth)", low=0.25, soft_linear=100.0),
        ),
        max_iterations=300,
    )
    return Case(
        source="modelled on do-mpc, towing kite",
        system=Kite(),
        problem=problem,
        state=(0.6, 0.2, 0.3),
        drawn=("azimuth", "polar"),
    )


CASES = {
    item.__name__: item
    for item in (swing_up, chain, race_car, moving_obstacle, thrust_disc, masses, masses_uneven, kite)
}
"""What makes each case, by its name."""

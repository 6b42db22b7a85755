"""A winged-cone vehicle at Mach 15: longitudinal motion, unstable in pitch, with throttle and elevator.

A concept: nobody has flown it. Plant and models are of published numbers, converted to SI. The plant has the
coefficients of Wang & Stengel (2000, J. Guid. Control Dyn. 23(4)), which change with Mach number and height; the models
have those of Xu, Mirmirani & Ioannou (2004, J. Guid. Control Dyn. 27(5)), the same frozen at Mach 15.

All states, inputs and outputs are deviations from the level flight of the frozen model, ``operating_point``: the rig
works about that point, and 0 is it. Misprints of the performance mock-up's paper that are corrected here: y for the
path angle; gravity that does not fall with height, and no V^2 r in the path's equation (it would trim at 2.79 deg);
no thrust and no engine; c (1 + dc) without its brackets; I + d rho; ce is uncertain too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar, cos, exp, sided, sin

GRAVITY = 3.93604e14
"""mu of the Earth [m^3/s^2]."""
RADIUS = 6.371387e6
"""Radius of the Earth [m]."""
SPEED, HEIGHT = 4590.29, 33_528.0
"""V0 [m/s], Mach 15, and h0 [m]."""
ANGLE, THROTTLE, ELEVATOR = 0.031226192616502568, 0.17618746017211018, -0.006945313080489634
"""Angle of attack [rad], throttle [1] and elevator [rad] of the frozen model in level flight."""
CORNER = 0.02
"""Width over which solvers see the thrust's corner at full throttle rounded [1]."""
THIRD = 3.0**-0.5
"""Standard deviation of a uniform distribution over +-1."""


@dataclass(frozen=True, kw_only=True)
class ConstantAirCone(System):
    """Level flight and about it, as the paper has it: coefficients and air frozen at Mach 15.

    V' = (T cos a - D) / m - mu sin g / r^2,  g' = (L + T sin a) / (m V) - (mu - V^2 r) cos g / (V r^2),  h' = V sin g,
    a' = q - g',  q' = M / I,  b'' = w^2 (bc - b) - 2 z w b',  r = h + R
    L, D, T = rho V^2 S / 2 (CL, CD, CT),  M = rho V^2 S c / 2 [CM + ce (de - a)]

    CL = .6203 a,  CD = .6450 a^2 + .0043378 a + .003772,  CT = .02576 e(b)
    e(b) = b, from full throttle on 1 + .15 / 1.15 (b - 1)
    CM = -.035 a^2 + .036617 a + 5.3261e-6 + c q / (2 V) (-6.796 a^2 + .3015 a - .2289)

    Speed V, path angle g, height h, angle of attack a, pitch rate q, throttle b; commands bc and elevator de.

    What a hybrid may correct: CL, CD, CT at full throttle, CM, as functions of a, de, Mach number and q.
    """

    states = (
        "speed [m/s]", "path_angle [rad]", "height [m]", "angle_of_attack [rad]", "pitch_rate [rad/s]",
        "throttle [1]", "throttle_rate [1/s]",
    )  # fmt: skip
    inputs = ("throttle_command [1]", "elevator [rad]")
    outputs = ("speed", "path_angle", "height", "angle_of_attack", "pitch_rate")
    features = ("angle_of_attack", "elevator", "mach [1]", "pitch_rate")
    closures = ("lift [1]", "drag [1]", "full_thrust [1]", "moment [1]")
    stepper = RungeKutta()
    operating_point = {
        "speed": SPEED,
        "height": HEIGHT,
        "angle_of_attack": ANGLE,
        "throttle": THROTTLE,
        "throttle_command": THROTTLE,
        "elevator": ELEVATOR,
    }

    mass: float = bounded(136_818.0, 132_713.46, 140_922.54, spread=0.03 * THIRD * 136_818.0, unit="kg")
    """m, known within 3 %."""
    inertia: float = bounded(9.4907e6, 9.300886e6, 9.680514e6, spread=0.02 * THIRD * 9.4907e6, unit="kg m^2")
    """I, around the pitch axis, known within 2 %."""
    area: float = bounded(334.73, 324.6881, 344.7719, spread=0.03 * THIRD * 334.73, unit="m^2")
    """S, of the wing, known within 3 %."""
    chord: float = bounded(24.384, 24.335232, 24.432768, spread=0.002 * THIRD * 24.384, unit="m")
    """c, mean aerodynamic, known within .2 %."""
    density: float = bounded(1.0, 0.97, 1.03, spread=0.03 * THIRD, unit="1")
    """1 + d rho: density of the air, relative to the standard, known within 3 %."""
    elevator_moment: float = bounded(0.0292, 0.028324, 0.030076, spread=0.03 * THIRD * 0.0292, unit="1/rad")
    """ce: pitch moment of the elevator, known within 3 %."""
    engine_rate: float = bounded(20.0, 1.0, 100.0, unit="rad/s", fixed=True)
    """w, of the engine, known."""
    engine_damping: float = bounded(0.7, 0.1, 2.0, unit="1", fixed=True)
    """z, of the engine, known."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        v, g, h = SPEED + x[0], x[1], HEIGHT + x[2]
        a, q, b, de = ANGLE + x[3], x[4], THROTTLE + x[5], ELEVATOR + u[1]
        r = h + RADIUS
        pressure = 0.5 * self.air(h) * v * v * self.area
        cl, cd, ct, cm = self.closure(x, u)
        lift, drag, thrust = pressure * cl, pressure * cd, pressure * ct * engine(b)
        moment = pressure * self.chord * (cm + self.elevator_moment * (de - a))
        path_rate = (lift + thrust * sin(a)) / (self.mass * v) - (GRAVITY - v * v * r) * cos(g) / (v * r * r)
        return (
            (thrust * cos(a) - drag) / self.mass - GRAVITY * sin(g) / (r * r),
            path_rate,
            v * sin(g),
            q - path_rate,
            moment / self.inertia,
            x[6],
            self.engine_rate**2 * (u[0] - x[5]) - 2.0 * self.engine_damping * self.engine_rate * x[6],
        )

    def feature(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """Angle of attack, elevator and Mach number as deviations from level flight, and pitch rate."""
        return x[3], u[1], (SPEED + x[0]) / sound(HEIGHT + x[2]) - SPEED / sound(HEIGHT), x[4]

    def closure(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """CL, CD, CT at full throttle, and CM without the elevator's part."""
        v, h, a, q = SPEED + x[0], HEIGHT + x[2], ANGLE + x[3], x[4]
        return (*self.forces(v, h, a, ELEVATOR + u[1]), self.moment(v, h, a, q))

    def air(self, h: Scalar) -> Scalar:
        """Density rho at a height [kg/m^3]."""
        return 0.012537 * self.density

    def forces(self, v: Scalar, h: Scalar, a: Scalar, de: Scalar) -> Sequence[Scalar]:
        """CL, CD and CT at full throttle."""
        return 0.6203 * a, 0.6450 * a * a + 0.0043378 * a + 0.003772, 0.02576

    def moment(self, v: Scalar, h: Scalar, a: Scalar, q: Scalar) -> Scalar:
        """CM without the elevator's part."""
        damping = self.chord * q / (2.0 * v) * (-6.796 * a * a + 0.3015 * a - 0.2289)
        return -0.035 * a * a + 0.036617 * a + 5.3261e-6 + damping


@dataclass(frozen=True, kw_only=True)
class KnownAirCone(ConstantAirCone):
    """The cone in air whose density falls with height, 1.2266 exp(-h / 7315.2) kg/m^3."""

    def air(self, h: Scalar) -> Scalar:
        return 1.22660 * exp(-h / 7315.2) * self.density


@dataclass(frozen=True, kw_only=True)
class QuasiSteadyCone(KnownAirCone):
    """The cone with an engine that follows at once, b = bc, for plans in intervals of a second, ten times its lag."""

    states: ClassVar[Any] = (
        "speed [m/s]", "path_angle [rad]", "height [m]", "angle_of_attack [rad]", "pitch_rate [rad/s]",
    )  # fmt: skip

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return super().law([*x, u[0], 0.0], u)[: len(x)]


@dataclass(frozen=True, kw_only=True)
class WingedCone(KnownAirCone):
    """The vehicle itself: coefficients that change with Mach number and height.

    CL = a (.493 + 1.91 / M) + kl (-.23558 a^2 - .0045181 a - .0291335) de
    CD = .0082 (171 a^2 + 1.15 a + 1) (.0012 M^2 - .054 M + 1)
    CT = .012075 (1 + 17 / M) [1 - kt 164 (a - .0315)^2] e(b)
    CM = 1e-4 (.06 - exp(-M / 3)) (-6565 a^2 + 6875 a + 1) + c q / (2 V) (1.37 - .025 M) (-6.83 a^2 + .303 a - .23)

    M = V / (2.9495e-8 h^2 - 9.16e-4 h + 303.5808). Thrust is gone at a = 6.3 deg: nothing beyond 6 deg means anything.
    """

    elevator_lift: float = bounded(1.0, 0.0, 1.0, unit="1", fixed=True)
    """kl: lift of the elevator, by which the height responds in the wrong direction at first; 0: none."""
    thrust_loss: float = bounded(1.0, 0.0, 1.0, unit="1", fixed=True)
    """kt: loss of thrust at other angles of attack; 0: none."""

    def forces(self, v: Scalar, h: Scalar, a: Scalar, de: Scalar) -> Sequence[Scalar]:
        mach = v / sound(h)
        return (
            a * (0.493 + 1.91 / mach) - self.elevator_lift * (0.23558 * a * a + 0.0045181 * a + 0.0291335) * de,
            0.0082 * (171.0 * a * a + 1.15 * a + 1.0) * (0.0012 * mach * mach - 0.054 * mach + 1.0),
            0.012075 * (1.0 + 17.0 / mach) * (1.0 - self.thrust_loss * 164.0 * (a - 0.0315) ** 2),
        )

    def moment(self, v: Scalar, h: Scalar, a: Scalar, q: Scalar) -> Scalar:
        mach = v / sound(h)
        damping = self.chord * q / (2.0 * v) * (1.37 - 0.025 * mach) * (-6.83 * a * a + 0.303 * a - 0.23)
        return 1e-4 * (0.06 - exp(-mach / 3.0)) * (-6565.0 * a * a + 6875.0 * a + 1.0) + damping


def engine(b: Scalar) -> Scalar:
    """Thrust at a throttle, relative to full throttle."""
    return 1.0 + sided(b - 1.0, 0.15 / 1.15, 1.0, over=CORNER)


def sound(h: Scalar) -> Scalar:
    """Speed of sound at a height [m/s]."""
    return 2.9495e-8 * h * h - 9.16e-4 * h + 303.5808


SYSTEM = WingedCone()
STRUCTURES = {
    "constant_air": ConstantAirCone(),
    "known_air": KnownAirCone(),
    "known_air_quasi_steady": QuasiSteadyCone(),
}

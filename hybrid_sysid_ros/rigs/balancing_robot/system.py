"""A two-wheeled balancing robot: PWM counts of two motors in; speed, yaw and tilt out.

Body and wheels are those of the NXTway-GS (Yamamoto 2008, NXTway-GS Model-Based Design: control of self-balancing
two-wheeled robot built with LEGO Mindstorms NXT), whose body is a uniform box. The motors are those of the rig
wheel_motor. The three equations are Lagrange's, in the form of Kim & Kwon (2015, Dynamic modeling of a two-wheeled
inverted pendulum balancing mobile robot, Int. J. Control Autom. Syst. 13(4)). Yamamoto's have no coupling of yaw and
tilt by centrifugal forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar, cos, dead_zone, sin, soft_sign

GRAVITY = 9.81
"""[m/s^2]."""
BODY = 0.6
"""M, mass of the body [kg]."""
WHEEL = 0.03
"""m, mass of one wheel [kg]."""
RADIUS = 0.04
"""r, of the wheels [m]."""
TRACK = 0.14
"""w, between the wheels, and the width of the body [m]."""
DEPTH, TALL = 0.04, 0.144
"""Of the body [m]."""
ROLL_INERTIA = BODY * (TRACK**2 + TALL**2) / 12.0
"""I1, of the body about its axis that points forward [kg m^2]; it turns with the yaw of a body that leans."""
WHEEL_YAW_INERTIA = 0.25 * WHEEL * RADIUS**2
"""Of a wheel, a disc, about its vertical diameter [kg m^2]."""

BRIDGED = 1.75
"""Widths of the dead zone within which a solver sees a way through it."""
CREEP, CREEP_FOR_SOLVERS = 0.2, 1.0
"""Speeds over which the dry friction of a motor turns round [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class BalancingRobot(System):
    """Speed v of the axle, and rates q of the tilt and p of the yaw.

    With a = M l cos(tilt) - 2 (J - Jw) / r, D = M l^2 + I1 - I3, s = sin(tilt), c = cos(tilt) and T of each motor:

        (M + 2 m + 2 J / r^2) v' + a q' = M l s (q^2 + p^2) + (Tl + Tr) / r
        a v' + (M l^2 + I2 + 2 (J - Jw)) q' = D s c p^2 + M g l s - (Tl + Tr)
        [I3 + D s^2 + 2 Iz + (m + J / r^2) w^2 / 2] p' = -2 D s c q p - M l s v p + (Tr - Tl) w / (2 r)

        T = (J / tau) [K n(u(t - delay)) - f - wc tanh(f / creep)],   f = (v -+ w p / 2) / r - q

    f is a wheel's speed against the body. J is what one motor turns: its wheel Jw and its rotor, which turns against
    the body. A motor by itself is the rig wheel_motor: J f' = T is tau f' = K n(u) - f - wc sgn f.
    """

    states = ("tilt [rad]", "yaw [rad]", "speed [m/s]", "tilt_rate [rad/s]", "yaw_rate [rad/s]")
    inputs = ("left [counts]", "right [counts]")
    outputs = ("speed", "yaw", "tilt", "tilt_rate", "yaw_rate")
    delays = {"left": "pwm_delay", "right": "pwm_delay"}
    stepper = RungeKutta()

    height: float = bounded(0.072, 0.03, 0.15, start=0.08, unit="m")
    """l, of the centre of mass above the axle."""
    tilt_inertia: float = bounded(1.0368e-3, 1e-4, 1e-2, start=1.2e-3, unit="kg m^2")
    """I2, of the body about its centre, M l^2 / 3."""
    yaw_inertia: float = bounded(1.06e-3, 1e-4, 1e-2, start=1.2e-3, unit="kg m^2")
    """I3, of the body about its long axis, M (w^2 + depth^2) / 12."""
    drive_inertia: float = bounded(1.996e-3, 2e-4, 2e-2, start=1.8e-3, unit="kg m^2")
    """J, of a wheel with its motor: tau times the motor's Kt Kb / R = .0222 N m s/rad of the NXTway-GS."""
    gain: float = bounded(0.1466, 0.01, 1.0, start=0.13, unit="rad/s/counts")
    """K, 1.4 rpm per count."""
    time_constant: float = bounded(0.09, 0.01, 1.0, start=0.1, unit="s")
    """tau, of a motor with its wheel off the ground."""
    dead_zone: float = bounded(30.0, 0.0, 100.0, start=25.0, unit="counts")
    """U0 of the bridge, which does not drive below it."""
    rounding: float = bounded(5.0, 1.0, 30.0, start=5.0, spread=3.0, unit="counts")
    """Width of the dead zone's rounded corners."""
    coulomb: float = bounded(0.84, 0.0, 10.0, start=0.6, unit="rad/s")
    """wc, 8 rpm: dry friction of gear and bearings, as a loss of speed."""
    pwm_delay: float = bounded(0.015, 0.0, 0.05, start=0.01, unit="s")
    """Delay from command to drive."""

    def torque(self, turning: Scalar, counts: Scalar) -> Scalar:
        """Of one motor on its wheel [N m]; turning: speed of the wheel against the body [rad/s]."""
        driven = self.gain * dead_zone(counts, self.dead_zone, self.rounding, over=BRIDGED)
        dry = self.coulomb * soft_sign(turning, CREEP, over=CREEP_FOR_SOLVERS)
        return self.drive_inertia / self.time_constant * (driven - turning - dry)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        tilt, _, speed, tilt_rate, yaw_rate = x
        leaning, upright = sin(tilt), cos(tilt)
        apart = 0.5 * TRACK * yaw_rate
        left = self.torque((speed - apart) / RADIUS - tilt_rate, u[0])
        right = self.torque((speed + apart) / RADIUS - tilt_rate, u[1])

        rotors = 2.0 * (self.drive_inertia - 0.5 * WHEEL * RADIUS**2)
        moment = BODY * self.height
        spread = moment * self.height + ROLL_INERTIA - self.yaw_inertia
        mass = BODY + 2.0 * WHEEL + 2.0 * self.drive_inertia / RADIUS**2
        coupling = moment * upright - rotors / RADIUS
        inertia = moment * self.height + self.tilt_inertia + rotors
        force = moment * leaning * (tilt_rate**2 + yaw_rate**2) + (left + right) / RADIUS
        lever = leaning * (spread * upright * yaw_rate**2 + moment * GRAVITY) - left - right
        determinant = mass * inertia - coupling * coupling

        turned = self.yaw_inertia + spread * leaning**2 + 2.0 * WHEEL_YAW_INERTIA
        turned += 0.5 * TRACK**2 * (WHEEL + self.drive_inertia / RADIUS**2)
        turning = 0.5 * TRACK / RADIUS * (right - left)
        turning -= leaning * yaw_rate * (2.0 * spread * upright * tilt_rate + moment * speed)
        return (
            tilt_rate,
            yaw_rate,
            (inertia * force - coupling * lever) / determinant,
            (mass * lever - coupling * force) / determinant,
            turning / turned,
        )

"""Small systems: a block on a table, a motor, and a joint behind a spring."""

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Slider(System):
    """A block on a table: v' = u - F sgn v, the only friction whose motion is school physics."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("push [m/s^2]",)
    contacts = (Dry(on="velocity", level="friction"),)
    delays = {"push": "input_delay"}

    friction: float = bounded(2.0, 0.0, 10.0, unit="m/s^2")
    """Coulomb friction."""
    input_delay: float = bounded(0.0, 0.0, 1.0, unit="s")
    """Delay of the push."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0]


@dataclass(frozen=True, kw_only=True)
class Motor(System):
    """Three states: angle, speed and current of a motor under a voltage; i' = (u - R i - K v) / L, v' = K i - b v."""

    states = ("angle [rad]", "speed [rad/s]", "current [A]")
    inputs = ("voltage [V]",)

    resistance: float = bounded(2.0, 0.1, 10.0, start=1.0, unit="Ohm")
    """Of the winding."""
    inductance: float = bounded(0.1, 0.01, 1.0, start=0.2, unit="H")
    """Of the winding."""
    torque: float = bounded(1.5, 0.1, 10.0, start=1.0, unit="rad/(s^2 A)")
    """Per current and inertia."""
    drag: float = bounded(0.8, 0.0, 10.0, fixed=True, unit="1/s")
    """Viscous friction."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        _, speed, current = x
        change = (u[0] - self.resistance * current - self.torque * speed) / self.inductance
        return speed, self.torque * current - self.drag * speed, change


@dataclass(frozen=True, kw_only=True)
class FlexibleJoint(System):
    """Two joints and a spring: motor angle d, link angle q and their speeds; the link is measured.

    J d'' = u - k (d - q) - b d' - F sgn d',  I q'' = k (d - q) - c q'.
    """

    states = ("motor [rad]", "link [rad]", "motor_speed [rad/s]", "link_speed [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("link",)
    contacts = (Dry(on="motor_speed", level="friction"),)

    motor_inertia: float = bounded(0.012, 1e-3, 1.0, unit="kg m^2")
    """J."""
    link_inertia: float = bounded(0.05, 1e-3, 1.0, unit="kg m^2")
    """I."""
    spring: float = bounded(12.0, 0.1, 100.0, unit="N m/rad")
    """k."""
    motor_drag: float = bounded(0.05, 0.0, 1.0, unit="N m s/rad")
    """b."""
    link_drag: float = bounded(0.02, 0.0, 1.0, unit="N m s/rad")
    """c."""
    coulomb: float = bounded(0.25, 0.0, 5.0, unit="N m")
    """F."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        motor, link, motor_speed, link_speed = x
        spring = self.spring * (motor - link)
        motor_rate = (u[0] - spring - self.motor_drag * motor_speed) / self.motor_inertia
        return motor_speed, link_speed, motor_rate, (spring - self.link_drag * link_speed) / self.link_inertia

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Level of the dry friction on the motor [rad/s^2]."""
        return self.coulomb / self.motor_inertia

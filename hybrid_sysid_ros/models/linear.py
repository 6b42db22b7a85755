"""The lecture's linear model of a one-joint rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core import Law, Motion, Operations, Variable, parameter


@dataclass(frozen=True, kw_only=True)
class Linear(Motion):
    """v' = gain (u - centre) - damping v - stiffness q, which is (tau0 u - R0 v - K0 (q + d0)) / J0 without the
    inertia that the data can't tell from the gain.
    """

    states: ClassVar[tuple[Variable, ...]] = (
        Variable(name="position", unit="rad"),
        Variable(name="velocity", unit="rad/s"),
    )
    inputs = (Variable(name="drive", unit="V"),)
    kinematics: ClassVar[Mapping[int, int]] = {0: 1}
    friction_state = 1

    gain: float = parameter(4.0, 0.01, 400.0, unit="rad/(s^2 V)", description="drive gain")
    centre: float = parameter(0.0, -5.0, 5.0, unit="V", description="input that balances the joint at q = 0")
    stiffness: float = parameter(10.0, 0.0, 500.0, unit="1/s^2", description="spring")
    damping: float = parameter(20.0, 0.0, 150.0, unit="1/s", description="viscous friction")
    input_delay: float = parameter(0.004, 0.0, 0.03, unit="s", description="delay of the drive")

    def law(self, operations: Operations) -> Law:
        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            return (x[1], p.gain * (u[0] - p.centre) - p.stiffness * x[0]), (0.0, 0.0, p.damping)

        return law

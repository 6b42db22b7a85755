"""One step of time, for every form of an equation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hybrid_sysid_ros.equations.equation import Equation
from hybrid_sysid_ros.equations.operations import Operations

Step = Callable[..., None]

TINY = 1e-12
"""Keeps 0 / 0 out of the step of a frictionless instant."""


def step_source(equation: Equation, operations: Operations, law: Callable[..., Any]) -> Step:
    """Semi-implicit Euler with implicit dry friction, as a plain function step(x, u, p, w, h, following).

        z = v + h f_v(x, u)                                      without friction
        v+ = z - saturate(z c / (vc + c), c),  c = h F           v' = f_v - F sat(v/vc), solved implicitly
        q+ = q + h v+                                            positions follow the new velocity

    With vc = 0 and |z| <= h F the velocity is exactly zero: the rig sticks. The scheme is Moreau's time stepping
    for one contact (Moreau 1988; Acary & Brogliato 2008, section 1.4.3.4) with a regularised sign.
    ``following`` (states,) receives the new state; x is not changed.
    """
    maximum, saturate = operations.maximum, operations.saturate
    count = len(equation.states)
    stick = -1 if equation.friction_state is None else equation.friction_state
    positions = tuple(equation.kinematics.keys()) or (-1,)
    velocities = tuple(equation.kinematics.values()) or (-1,)

    def step(x: Any, u: Any, p: Any, w: Any, h: Any, following: Any) -> None:
        rates, friction = law(x, u, p, w)
        for i in range(count):
            following[i] = x[i] + h * rates[i]
        if stick >= 0:
            capacity = h * friction[0]
            z = following[stick]
            # The ratio first: with vc = 0 it is 1 to the last bit, and the velocity 0.
            following[stick] = z - saturate(z * (capacity / maximum(friction[1] + capacity, TINY)), capacity)
        for i in range(len(positions)):
            if positions[i] >= 0:
                following[positions[i]] = x[positions[i]] + h * following[velocities[i]]

    return step

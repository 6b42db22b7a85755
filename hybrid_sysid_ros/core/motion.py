"""Equations of motion, in continuous time, and their step."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.core.equation import Equation, Step
from hybrid_sysid_ros.core.operations import Operations

Law = Callable[[Any, Any, Any, Any], tuple[Any, Any]]
"""law(x, u, p, w) -> (rates, friction): see :meth:`Motion.law`."""

TINY = 1e-12
"""Keeps 0 / 0 out of the step of a frictionless instant."""


@dataclass(frozen=True, kw_only=True)
class Motion(Equation):
    """x' = f(x, u(t - delay)) - friction on one velocity v.

    Friction is what a right-hand side can't hold: it is set-valued where it is dry and stiff where it has a hidden
    state, so the law states it beside the smooth rates and the step solves it implicitly:

        dry        v' = f_v - F sat(v / vc) - D v                       friction = (F, vc, D)
        bristles   v' = f_v - s0 z - s1 z' - D v,  z' = v - |v| z s0 / F     friction = (F, s0, s1, D)

    F: level, vc: creep speed (0: it sticks exactly), D: viscous rate; z: deflection of the bristles, s0, s1: their
    stiffness and damping, all per unit inertia. Bristles with a constant F are Dahl's friction (1968), with F(v) the
    LuGre friction of Canudas de Wit et al. (1995), IEEE TAC 40(3), eqs. (1)-(3).
    """

    friction_state: ClassVar[int | None] = None
    """The velocity that carries friction."""
    bristle_state: ClassVar[int | None] = None
    """The deflection of the bristles; None: friction is dry."""

    @abstractmethod
    def law(self, operations: Operations) -> Law:
        """The law in the form that ``operations`` make.

        Returns law(x, u, p, w): x (states,), u (inputs,), p the named parameters, w (weights,) of a network, giving
        the tuple of rates x' (states,) without friction, and the friction as the class describes it.
        """

    def advance(self, operations: Operations) -> Step:
        """Semi-implicit Euler with friction solved implicitly; x is not changed.

            z = v + h f_v(x, u) - h D v / 2                          without dry friction
            v+ = (z - saturate(z c / (vc (1 + h D / 2) + c), c)) / (1 + h D / 2),   c = h F
            q+ = q + h v+                                            positions follow the new velocity

        Viscous friction is trapezoidal: second order, where Euler's damping depends on the step. With vc = 0 and
        |z| <= h F the velocity is exactly zero: the rig sticks. The scheme is Moreau's time stepping for one contact
        (Moreau 1988; Acary & Brogliato 2008, section 1.4.3.4) with a regularised sign; for bristles see
        :func:`_with_bristles`.
        """
        law = operations.function(self.law(operations))
        count = len(self.states)
        carrier = -1 if self.friction_state is None else self.friction_state
        bristle = -1 if self.bristle_state is None else self.bristle_state
        positions = tuple(self.kinematics.keys()) or (-1,)
        velocities = tuple(self.kinematics.values()) or (-1,)
        solve = operations.function(_dry(operations) if bristle < 0 else _with_bristles(operations))

        def step(x: Any, u: Any, p: Any, w: Any, h: Any, following: Any) -> None:
            rates, friction = law(x, u, p, w)
            for i in range(count):
                following[i] = x[i] + h * rates[i]
            if carrier >= 0:
                if bristle >= 0:
                    v, z = solve(x[carrier], following[carrier], x[bristle], friction, h)
                    following[carrier] = v
                    following[bristle] = z
                else:
                    following[carrier] = solve(x[carrier], following[carrier], friction, h)
            for i in range(len(positions)):
                if positions[i] >= 0:
                    following[positions[i]] = x[positions[i]] + h * following[velocities[i]]

        return step


def _dry(operations: Operations) -> Callable[..., Any]:
    maximum, saturate = operations.maximum, operations.saturate

    def solve(v: Any, pushed: Any, friction: Any, h: Any) -> Any:
        level, creep, viscous = friction
        capacity = h * level
        half = 0.5 * h * viscous
        z = pushed - half * v
        # The ratio first: with vc = 0 it is 1 to the last bit, and the velocity 0.
        return (z - saturate(z * (capacity / maximum(creep * (1.0 + half) + capacity, TINY)), capacity)) / (1.0 + half)

    return solve


def _with_bristles(operations: Operations) -> Callable[..., Any]:
    """Backward Euler of bristles and velocity together, which a quadratic solves exactly at any stiffness.

    z+ = (z + h v+) / (1 + c |v+|),  c = h s0 / F            never leaves +-max(|z|, F / s0)
    (1 + h D / 2) v+ + h S z+ = b,   S = s0 + s1 / h,   b = v + h f_v - h D v / 2 + s1 z
    with r = |v+|, a = 1 + h D / 2, s = sgn(v+) = sgn(b - h S z):
    a c r^2 + (a - s b c + h^2 S) r - |b - h S z| = 0,       of which one root is positive
    """
    absolute, maximum, select, sqrt = operations.absolute, operations.maximum, operations.select, operations.sqrt

    def solve(v: Any, pushed: Any, z: Any, friction: Any, h: Any) -> tuple[Any, Any]:
        level, stiffness, damping, viscous = friction
        half = 0.5 * h * viscous
        a = 1.0 + half
        c = h * stiffness / maximum(level, TINY)
        b = pushed - half * v + damping * z
        total = h * stiffness + damping
        push = b - total * z
        sign = select(push > 0.0, 1.0, -1.0)
        linear = a - sign * b * c + h * total
        amount = absolute(push)
        # The form without cancellation where the linear part is positive, the usual one where it is not.
        root = sqrt(linear * linear + 4.0 * a * c * amount)
        r = select(
            linear > 0.0, 2.0 * amount / maximum(linear + root, TINY), (root - linear) / maximum(2.0 * a * c, TINY)
        )
        return sign * r, (z + h * sign * r) / (1.0 + c * r)

    return solve

"""Equilibria: where a system stays as it is, and the modes in which it moves about there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core.symbolic import linearised, symbolic_rates, viscous
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NEWTON_STEPS, HALVINGS = 50, 8
STEADY = 1e-9
"""Largest rate that may be left, as part of what a change of one state or input by one makes of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Eigenmode:
    """One way in which a linear system moves: a real pole, or a pair."""

    pole: complex
    """The one above the real axis of a pair [1/s]."""
    shares: Array
    """Of each declared state in it, (states,), of sum 1: participation factors."""

    @property
    def oscillates(self) -> bool:
        return self.pole.imag > 0.0

    @property
    def damping(self) -> float:
        """Ratio: 1 does not swing, 0 swings for ever, below 0 grows."""
        return -self.pole.real / abs(self.pole) if self.pole else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """A point where nothing changes, and the linear system about it."""

    states: Array
    """(states,), those of contacts zero."""
    inputs: Array
    """(inputs,)."""
    transition: Array
    """A (declared states, declared states) of x' = A x + B u, viscous friction included, dry one left out; or of
    x(k + 1) = A x + B u where the system is a map from sample to sample.
    """
    gain: Array
    """B (declared states, inputs)."""
    period: float | None
    """Of such a map [s]."""

    @property
    def modes(self) -> list[Eigenmode]:
        """By their poles, fastest first."""
        return modes_of(self.transition, period=self.period)


def equilibrium(system: System, at: Mapping[str, float] | None = None) -> Equilibrium:
    """The equilibrium of a system at given values of states and inputs, by name, and of all others nearest to zero.

    By Newton's method from zero with steps of least norm (in the units of the system), on the rates with the viscous
    friction of contacts and without their dry one.

    Raises:
        UserError: an unknown name, or no equilibrium found.
    """
    n, m, held = len(system.declared_states), len(system.inputs), dict(at or {})
    names = [item.name for item in (*system.declared_states, *system.inputs)]
    for name in held:
        if name not in names:
            raise UserError(f"equilibrium: {name!r} is no state or input; known are {', '.join(names)}")
    free = [k for k, name in enumerate(names) if name not in held]
    rates, hidden = symbolic_rates(system), np.zeros(len(system.states) - n)
    staying = np.eye(n, n + m) if system.sampling_time else np.zeros((n, n + m))

    def moving(point: Array) -> tuple[Array, Array]:
        """What still moves at a point, (states,), and its derivatives by states and inputs."""
        states = np.concatenate([point[:n], hidden])
        found, jacobian = (np.array(part) for part in rates(states, point[n:]))
        held_back = np.eye(n, n + m) * viscous(system, states, point[n:])[:, None] + staying
        by_all = np.delete(jacobian, np.s_[n : n + len(hidden)], axis=1)
        return found.ravel() - held_back @ point, by_all - held_back

    point = np.array([held.get(name, 0.0) for name in names])
    left, jacobian = moving(point)
    for _ in range(NEWTON_STEPS):
        scale = np.maximum(np.max(np.abs(jacobian), axis=1, initial=0.0), 1e-12)
        if not np.isfinite(left / scale).all():
            break
        change = np.zeros(n + m)
        change[free] = np.linalg.lstsq(jacobian[:, free] / scale[:, None], -left / scale, rcond=1e-12)[0]
        least = np.sum((left / scale) ** 2)
        tried = (point + 0.5**halving * change for halving in range(HALVINGS))
        better = next((at for at in tried if np.sum((moving(at)[0] / scale) ** 2) < least), None)
        if better is None:
            break
        point = better
        left, jacobian = moving(point)
    share = np.nan_to_num(np.abs(left / scale), nan=np.inf)
    if np.max(share) > STEADY:
        worst = int(np.argmax(share))
        conditions = ", ".join(f"{name} {value:g}" for name, value in held.items())
        raise UserError(
            f"{type(system).__name__} has no equilibrium {f'at {conditions}' if conditions else 'near zero'}, or none "
            f"was found: {names[worst]} still changes by {left[worst]:.3g} {system.declared_states[worst].unit} a "
            f"{'sample' if system.sampling_time else 'second'}; "
            "hold other values, or fewer"
        )
    states = np.concatenate([point[:n], hidden])
    if system.sampling_time:
        full = moving(point)[1] + staying
        transition, gain = full[:, :n], full[:, n:]
    else:
        transition, gain = linearised(system, states, point[n:])
    return Equilibrium(states=states, inputs=point[n:], transition=transition, gain=gain, period=system.sampling_time)


def modes_of(transition: Array, *, period: float | None = None) -> list[Eigenmode]:
    """The modes of x' = A x, or with a period [s] of x(k + 1) = A x, fastest first.

    A state's share in a mode is the product of its entries in the right and the left eigenvector, which no choice of
    units changes (Perez-Arriaga, Verghese & Schweppe 1982, IEEE Trans. Power App. Syst. 101(9)).
    """
    values, right = np.linalg.eig(transition)
    left = np.linalg.pinv(right)
    if period is not None:
        with np.errstate(divide="ignore"):
            values = np.log(values.astype(complex)) / period
    found = []
    for k, pole in enumerate(values):
        if pole.imag < 0.0:
            continue
        shares = np.abs(right[:, k] * left[k])
        found.append(Eigenmode(pole=complex(pole), shares=shares / max(np.sum(shares), 1e-300)))
    return sorted(found, key=lambda mode: -abs(mode.pole))

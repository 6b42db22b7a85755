"""What the section mpc declares about a steady motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.operating_point.cheapest_rest import cheapest_rest
from hybrid_sysid_ros.extensions.operating_point.terminal_cost import STILL, riccati_terms
from hybrid_sysid_ros.extensions.shared.steady_motion import STEADY, SteadyMotion, jacobian_at
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers

OPERATING = "operating_point"
"""Outputs at whose steady motion the inputs cost nothing [SI]."""
RICCATI = "riccati_at"
"""Outputs about which the horizon ends with Riccati's cost [SI]."""


def about(system: System, problem: ControlProblem, outputs: Any, model: Model | None = None) -> ControlProblem:
    """The problem of a system, sized, whose inputs cost nothing in the steady motion at outputs (p,). Raises UserError
    where the rig does not stay there, or only beyond a bound.
    """
    at = _point(system, outputs, OPERATING)
    problem = problem.sized(system)
    rest = cheapest_rest(system, problem, at)
    tracked = np.array(problem.output_weights) > 0.0
    found, _, _ = jacobian_at(system, problem, rest.state, rest.inputs, output=True)
    if not np.allclose(found[tracked], at[tracked], rtol=STILL, atol=STILL):
        raise UserError(f"mpc: {OPERATING}: no inputs hold the outputs at {at.tolist()}; give others")
    _check_within(system, problem, rest, f"mpc: {OPERATING}: to stay at {at.tolist()}")
    return replace(problem, input_rest=tuple(rest.inputs.tolist())).sized(system)


def ended(system: System, problem: ControlProblem, outputs: Any, model: Model | None = None) -> ControlProblem:
    """The problem of a system, sized, whose horizon ends with Riccati's cost about rest at outputs (p,). Raises
    UserError where the rig does not rest there, or only beyond a bound.
    """
    at = _point(system, outputs, RICCATI)
    problem = problem.sized(system)
    _check_within(system, problem, cheapest_rest(system, problem, at), f"mpc: {RICCATI}: to stay at {at.tolist()}")
    return replace(problem, terms=(*problem.terms, *riccati_terms(system, problem, at))).sized(system)


def _point(system: System, given: Any, key: str) -> Array:
    """Outputs (p,) of a point: here one number does not stand for all. Raises UserError for another count."""
    found = numbers(given, f"mpc: {key}", count=len(given) if isinstance(given, list | tuple) else 1)
    if len(found) != len(system.outputs):
        raise UserError(f"mpc: {key} has {len(found)} numbers: it needs one for each output, {len(system.outputs)}")
    return np.array(found)


def _check_within(system: System, problem: ControlProblem, rest: SteadyMotion, where: str) -> None:
    """Raise UserError, which begins with where, for a steady motion beyond a bound of an input or a state by more than
    rounding, and name the one that is furthest beyond.
    """
    values = np.array([*rest.inputs, *rest.state])
    low, high = np.array([*problem.input_low, *problem.state_low]), np.array([*problem.input_high, *problem.state_high])
    beyond = np.maximum(low - values, values - high) / (1.0 + np.abs(values))
    worst = int(np.argmax(beyond))
    if not beyond[worst] <= STEADY:
        raise UserError(
            f"{where}, {(*system.inputs, *system.states)[worst].name} would be {values[worst]:.4g}, beyond its bounds "
            f"{low[worst]:g} and {high[worst]:g}; give other outputs"
        )

"""The section mpc of a rig's file: what it adds to the problem of the controller's parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.cheapest_rest import cheapest_rest
from hybrid_sysid_ros.control.steady_motion import SteadyMotion, jacobian_at
from hybrid_sysid_ros.control.terminal_cost import STILL, riccati_terms
from hybrid_sysid_ros.control.terms import terms_of
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers, refuse_unknown, section

FIELDS = ("terms", "stage_parameters", "final_output_weights", "intervals", "blocks")
"""Fields of the problem."""
OPERATING = "operating_point"
"""Outputs at whose steady motion the inputs cost nothing [SI]."""
RICCATI = "riccati_at"
"""Outputs about which the horizon ends with Riccati's cost [SI]."""


def about(system: System, problem: ControlProblem, outputs: Any) -> ControlProblem:
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


def _point(system: System, given: Any, key: str) -> Array:
    """Outputs (p,) of a point: here one number does not stand for all. Raises UserError for another count."""
    found = numbers(given, f"mpc: {key}", count=len(given) if isinstance(given, list | tuple) else 1)
    if len(found) != len(system.outputs):
        raise UserError(f"mpc: {key} has {len(found)} numbers: it needs one for each output, {len(system.outputs)}")
    return np.array(found)


def _check_within(system: System, problem: ControlProblem, rest: SteadyMotion, where: str) -> None:
    """Raise UserError, which begins with where, for a steady motion beyond a bound of an input or a state."""
    items = (*system.inputs, *system.states)
    values = [*rest.inputs.tolist(), *rest.state.tolist()]
    lowest, highest = (*problem.input_low, *problem.state_low), (*problem.input_high, *problem.state_high)
    for item, value, low, high in zip(items, values, lowest, highest, strict=True):
        if not low <= value <= high:
            raise UserError(
                f"{where}, {item.name} would be {value:.4g}, beyond its bounds {low:g} and {high:g}; give other outputs"
            )


def extended(
    system: System, problem: ControlProblem, given: Mapping[str, Any], model: Model | None = None
) -> ControlProblem:
    """The problem of a system, sized, with what the section declares: its terms are added to those of the problem, and
    replace those of the same name. model: that of the system, for extensions that use what is known of its
    parameters. Raises UserError for what makes no valid problem.
    """
    further = extensions.targets("problems")
    refuse_unknown(given, (*FIELDS, OPERATING, RICCATI, *further), "mpc")
    fields = {name: given[name] for name in FIELDS if name in given}
    if "terms" in fields:
        fields["terms"] = tuple({term.name: term for term in (*problem.terms, *terms_of(fields["terms"]))}.values())
    if problem.stage_parameters and isinstance(fields.get("stage_parameters"), Mapping):
        fields["stage_parameters"] = {**dict(problem.stage_parameters), **fields["stage_parameters"]}
    problem = replace(problem, **fields).sized(system)
    _check_used(problem)
    if OPERATING in given:
        problem = about(system, problem, given[OPERATING])
    if RICCATI in given:
        at = _point(system, given[RICCATI], RICCATI)
        _check_within(system, problem, cheapest_rest(system, problem, at), f"mpc: {RICCATI}: to stay at {at.tolist()}")
        last = riccati_terms(system, problem, at)
        problem = replace(problem, terms=(*problem.terms, *last)).sized(system)
    for name in (name for name in further if name in given):
        problem = extensions.loaded(further[name])(system, problem, given[name], model)
    return problem


def _check_used(problem: ControlProblem) -> None:
    """Raise UserError for a parameter of the stages that no term has."""
    words = {word for term in problem.terms for word in re.findall(r"[^\W\d]\w*", term.value)}
    if idle := [name for name, _ in problem.stage_parameters if name not in words]:
        raise UserError(
            f"mpc: stage_parameters names {idle[0]!r}, which no term has: use it in a formula, or leave it out"
        )


def declared(rig: Rig, system: System, problem: ControlProblem) -> ControlProblem:
    """The problem of a system, sized, with what the rig's file declares. Raises UserError that names the file."""
    given = section(rig.content, "mpc", str(rig.file))
    try:
        return extended(system, problem, given)
    except UserError as error:
        if not given:
            raise
        raise UserError(f"{rig.file}: {error}") from error

"""The section mpc of a rig's file: what it adds to the problem of the controller's parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.terms import terms_of
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import refuse_unknown, section

FIELDS = ("terms", "stage_parameters", "final_output_weights", "intervals", "blocks")
"""Fields of the problem."""


def extended(
    system: System, problem: ControlProblem, given: Mapping[str, Any], model: Model | None = None
) -> ControlProblem:
    """The problem of a system, sized, with what the section declares: its terms are added to those of the problem, and
    replace those of the same name. model: that of the system, for extensions that use what is known of its
    parameters. Raises UserError for what makes no valid problem.
    """
    further = extensions.targets("problems")
    refuse_unknown(given, (*FIELDS, *further), "mpc")
    fields = {name: given[name] for name in FIELDS if name in given}
    if "terms" in fields:
        fields["terms"] = tuple({term.name: term for term in (*problem.terms, *terms_of(fields["terms"]))}.values())
    if problem.stage_parameters and isinstance(fields.get("stage_parameters"), Mapping):
        fields["stage_parameters"] = {**dict(problem.stage_parameters), **fields["stage_parameters"]}
    problem = replace(problem, **fields).sized(system)
    _check_used(problem)
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

"""The section mpc of a rig's file: what it adds to the problem of the controller's parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.terminal_cost import riccati_terms
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers, refuse_unknown, section

FIELDS = ("terms", "stage_parameters", "final_output_weights", "intervals", "blocks")
"""Fields of the problem."""
RICCATI = "riccati_at"
"""Outputs about which the horizon ends with Riccati's cost [SI]."""


def declared(rig: Rig, system: System, problem: ControlProblem) -> ControlProblem:
    """The problem of a system, sized, with what the rig's file declares. Raises UserError that names the file."""
    given = section(rig.content, "mpc", str(rig.file))
    try:
        refuse_unknown(given, (*FIELDS, RICCATI), "mpc")
        problem = replace(problem, **{name: given[name] for name in FIELDS if name in given}).sized(system)
        if RICCATI in given:
            at = numbers(given[RICCATI], f"mpc: {RICCATI}", count=len(system.outputs))
            last = riccati_terms(system, problem, np.array(at))
            problem = replace(problem, terms=(*problem.terms, *last)).sized(system)
        return problem
    except UserError as error:
        if not given:
            raise
        raise UserError(f"{rig.file}: {error}") from error

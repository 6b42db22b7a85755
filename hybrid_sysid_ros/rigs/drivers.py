"""Drivers: loops, feedback and signals that drive a rig's inputs in experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.rigs.feedback import Feedback, table
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, numbers, refuse_unknown, section


@dataclass(frozen=True, kw_only=True)
class ExperimentLoop:
    """A controller that drives an input in experiments: u = gain (e + integral * int e dt), e = reference - output,
    where the output is behind its sensor's low-pass if there is one.
    """

    output: int
    gain: float
    """[unit of the input per shown unit of the output]"""
    integral: float = 0.0
    """Rate of the integral part [1/s]."""


@dataclass(frozen=True, kw_only=True)
class Experiments:
    """How a rig is driven through its experiments."""

    loops: Mapping[int, ExperimentLoop] = field(default_factory=dict)
    """Controllers by input; an input without one is excited directly."""
    feedback: Feedback | None = None
    """Instead of loops, one law of all inputs that follows commands; excitations are added to its inputs."""
    stabiliser: NDArray[np.float64] | None = None
    """K (inputs, outputs) of u = v - K y, in SI, which stabilises an unstable rig in identification and validation."""
    closed_windows: float = 0.0
    """Length [s] of the last windows of an identification, in which the stabiliser closes the loop; 0: none."""
    excitations: Mapping[str, Mapping[int, Excitation]] = field(default_factory=dict)
    """By name, the signals of the inputs or of their loops' references by number; numbers beyond the inputs belong to
    the commands of the outputs that a feedback follows.
    """


def experiments_of(content: Mapping[str, Any], system: System, where: str) -> Experiments:
    """Experiments from a section of rig.yaml. Raises UserError for wrong values."""
    refuse_unknown(content, ("loops", "feedback", "stabiliser", "closed_windows", "excitations"), where)
    if "loops" in content and "feedback" in content:
        raise UserError(f"{where}: loops and feedback both drive the inputs: leave one out")
    loops = {}
    for name, value in section(content, "loops", where).items():
        here = f"{where}: loops.{name}"
        given = dict(value) if isinstance(value, dict) else {}
        output = index_of(given.get("output", system.outputs[0].name), system.outputs, here, "output")
        loops[index_of(name, system.inputs, here, "input")] = built(ExperimentLoop, {**given, "output": output}, here)
    feedback, driven = None, tuple(system.inputs)
    if "feedback" in content:
        feedback = Feedback.of(section(content, "feedback", where), system, f"{where}: feedback")
        driven += tuple(system.outputs[index] for index in feedback.followed)
    excitations: dict[str, dict[int, Excitation]] = {}
    for name, value in section(content, "excitations", where).items():
        here = f"{where}: excitations.{name}"
        if isinstance(value, dict) and "kind" not in value:
            chosen = {index_of(key, driven, here, "input"): item for key, item in value.items()}
        else:
            chosen = dict.fromkeys(range(len(system.inputs)), value)
        excitations[name] = {index: Excitation.of(item, here) for index, item in chosen.items()}
    held = "stabiliser" in content
    return Experiments(
        loops=loops,
        feedback=feedback,
        stabiliser=table(content, "stabiliser", (system.inputs, system.outputs), where) if held else None,
        closed_windows=numbers(content.get("closed_windows", 0.0), f"{where}: closed_windows", count=1)[0],
        excitations=excitations,
    )


def index_of(name: object, variables: tuple[Variable, ...], where: str, what: str) -> int:
    """Index of a variable among others. Raises UserError for an unknown name."""
    names = [item.name for item in variables]
    if name not in names:
        raise UserError(f"{where}: {name!r} is no {what}; known are {', '.join(names)}")
    return names.index(str(name))

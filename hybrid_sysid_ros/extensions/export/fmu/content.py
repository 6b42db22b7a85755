"""What is in an FMU: of a simulation, or of a loop's controller."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.fmu.description import TIME, FmuVariable, structured
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop
from hybrid_sysid_ros.rigs.rig import Rig

FMU_TEMPLATES = Path(__file__).parent / "c"
STATUSES = (
    ("waiting", "There is no estimate yet: the command at rest"),
    ("solved", "The optimum, to tolerance"),
    ("iterated", "One real-time iteration towards the optimum"),
    ("not_converged", "The last iterate, within the bounds"),
    ("failed", "No solution: the rest of the last plan, or the last command"),
    ("policy", "The policy's plan, which has passed the check"),
    ("held", "Neither a policy nor a plan: the last command"),
    ("rested", "The guard rests the inputs"),
)
"""In the order of a unit's enumeration."""
_TYPE = re.compile(r"typedef\s+([\w\s]+?\*?)\s+(fmi3\w+?)TYPE\s*\(([^;]*)\);")


@dataclass(frozen=True, kw_only=True)
class FmuContent:
    """What an FMU is made of."""

    identifier: str
    unit: str
    """What names of the unit within begin with."""
    title: str
    period: float
    variables: Sequence[FmuVariable]
    members: str
    """Of the C structure of values."""
    template: str
    """File of the functions that differ."""
    files: Mapping[str, str]
    """Texts of the unit's files."""
    compiled: Sequence[str]
    """Those that are compiled."""
    statuses: Sequence[tuple[str, str]] = ()

    def wrapper(self, headers: Mapping[str, str], token: str) -> str:
        """The text of the FMU's own C file."""
        main, variables, functions = (
            (FMU_TEMPLATES / name).read_text(encoding="utf-8") for name in ("fmu.c", "variables.c", self.template)
        )
        values = {
            "title": self.title,
            "unit": self.unit,
            "UNIT": self.unit.upper(),
            "token": token,
            "period": repr(self.period),
            "count": len(self.variables),
            "members": self.members,
            "table": ",\n".join(item.row(reference) for reference, item in enumerate(self.variables)),
        }
        own = {"functions": Text(functions).substitute(values), "variables": variables}
        return Text(main).substitute({**values, **own, "stubs": stubs(headers, main + variables)})


def stubs(headers: Mapping[str, str], own: str) -> str:
    """Functions of FMI that an FMU refuses, as all are that ``own`` does not define."""
    found = []
    for kind, name, given in _TYPE.findall(re.sub(r"/\*.*?\*/", "", headers["fmi3FunctionTypes.h"], flags=re.DOTALL)):
        if re.search(rf"\b{name}\(", own):
            continue
        arguments = [" ".join(part.split()) for part in given.split(",")]
        names = [re.findall(r"\w+", part)[-1] for part in arguments]
        unused = ", ".join(f"(void){item}" for item in names)
        if kind.strip() == "fmi3Instance":
            body = f"{unused};\n    return NULL;"
        else:
            rest = f"{', '.join(f'(void){item}' for item in names[1:])};\n    " if names[1:] else ""
            body = f'{rest}return refused({names[0]}, "{name} is not in this FMU.");'
        found.append(f"{kind.strip()} {name}({', '.join(arguments)})\n{{\n    {body}\n}}\n")
    return "\n".join(found)


def of_simulation(simulation: Simulation, *, title: str) -> FmuContent:
    """The content of a model's or a plant's FMU."""
    system, name, actuators = simulation.system, simulation.name, simulation.rig.actuators
    tunable: dict[str, Any] = {"causality": "parameter", "variability": "tunable", "checked": True}
    variables = [
        TIME,
        *_each(
            system.inputs, "unit.inputs", causality="input", description="Held over a step",
            start=[item.rest for item in actuators], low=[item.low for item in actuators],
            high=[item.high for item in actuators],
        ),
    ]  # fmt: skip
    variables += _outputs(system.outputs, "unit.outputs", variables)
    text = "State; it may be set before the first step"
    variables += _each(
        system.states, "unit.state", "state.", causality="local", start=0.0, checked=True, description=text
    )
    variables += [
        FmuVariable(
            name=structured("parameter", parameter.name), place=f"unit.parameters[{i}]", unit=parameter.unit,
            start=float(value), low=parameter.low, high=parameter.high, description=parameter.description, **tunable,
        )
        for i, (parameter, value) in enumerate(zip(system.parameters, system.values, strict=True))
        if not parameter.learned and parameter.name not in simulation.constant_parameters
    ]  # fmt: skip
    text = "What acts beside the input, such as a push"
    variables += _each(system.inputs, "unit.bias", "bias.", start=simulation.bias, description=text, **tunable)
    files = simulation.texts(about=title)
    return FmuContent(
        identifier=name, unit=name, title=title, period=simulation.rig.step, variables=variables,
        members=f"    {name}_memory unit;", template="simulation.c", files=files,
        compiled=[file for file in files if file.endswith(".c")],
    )  # fmt: skip


def of_loop(rig: Rig, python: PythonLoop, folder: Path, *, name: str, title: str) -> FmuContent:
    """The content of a controller's FMU. folder: of the exported loop. name: of its unit."""
    system, horizon, (low, high) = python.estimator.system, python.mpc.horizon, python.limits
    m, p, given = len(system.inputs), len(system.outputs), {"causality": "input", "start": 0.0}
    reading = "Reading at the beginning of a step; not a number where it is missing"
    previewed = f"References every {python.mpc.period:g} s of the horizon, if preview_given"
    applied = "Mean of what acted since the step before, if applied_given"
    variables = [
        TIME,
        *_each(system.outputs, "outputs", "measured_", description=reading, **given),
        *_each(system.outputs, "reference", "reference_", description="Reference, held over the horizon", **given),
        *_each(system.outputs, "preview", "preview_", size=horizon, description=previewed, **given),
        *_each(system.inputs, "applied", "applied_", description=applied, **given),
        *(
            FmuVariable(
                name=f"{flag}_given", causality="parameter", variability="fixed", kind="Boolean",
                place=f"{flag}_given", start=0.0, description=f"Whether to take {text}",
            )
            for flag, text in (
                ("preview", "preview_* in place of reference_*"), ("applied", "applied_* in place of commands")
            )
        ),
        *_each(
            system.inputs, "command.inputs", causality="output", low=low.tolist(), high=high.tolist(),
            description="Command for this step",
        ),
        FmuVariable(
            name="status", causality="output", kind="Enumeration", place="command.status",
            description="How the command was found",
        ),
    ]  # fmt: skip
    variables += _outputs(python.mpc.system.states, "command.state", variables, "estimate.", "Estimate at the reading")
    units = [Variable(name=item.name, unit=item.unit) for item in system.inputs]
    variables += _outputs(units, "command.disturbance", variables, "disturbance.", "Estimated offset of the input")
    members = [
        f"double outputs[{p}];", f"double reference[{p}];", f"double preview[{p}][{horizon}];", f"double applied[{m}];",
        "int preview_given, applied_given;", f"{name}_command command;", f"{name}_memory unit;",
    ]  # fmt: skip
    return FmuContent(
        identifier=f"{name}_controller", unit=name, title=title, period=python.estimator.period, variables=variables,
        members="\n".join(f"    {line}" for line in members), template="loop.c", files=files_of(folder, name),
        compiled=[f"{name}.c", f"{name}_solver.c"], statuses=STATUSES,
    )  # fmt: skip


def files_of(folder: Path, name: str) -> dict[str, str]:
    """The texts of an exported loop's files, and NAME_solver.c: all of DAQP, which gets its memory from the loop's."""
    daqp, own = sorted((folder / "daqp").glob("*.[ch]")), (folder / f"{name}{ending}" for ending in (".c", ".h"))
    files = {path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8") for path in (*daqp, *own)}
    renamed = ("malloc", "allocate"), ("calloc", "allocate_zeros"), ("free", "release")
    lines = ["/* DAQP, with the loop's memory in place of malloc's. Generated; do not edit. */"]
    lines += [f"#include <{header}.h>" for header in ("math", "stddef", "stdio", "stdlib", "string")]
    lines += ["", f"void *{name}_allocate(size_t size);", f"void *{name}_allocate_zeros(size_t count, size_t size);"]
    lines += [f"void {name}_release(void *memory);", ""]
    lines += [f"#define {old} {name}_{new}" for old, new in renamed]
    lines += ["", *(f'#include "daqp/{path.name}"' for path in daqp if path.suffix == ".c"), ""]
    return files | {f"{name}_solver.c": "\n".join(lines)}


def _each(items: Sequence[Variable], place: str, prefix: str = "", **given: Any) -> list[FmuVariable]:
    """A variable for each item. prefix: of the names; up to a point it is a structure. given: further fields; a list
    has a value for each.
    """
    *groups, begin = prefix.split(".")
    return [
        FmuVariable(
            name=structured(*groups, begin + item.name), place=f"{place}[{k}]", unit=item.unit,
            **{name: value[k] if isinstance(value, Sequence) and not isinstance(value, str) else value
               for name, value in given.items()},
        )
        for k, item in enumerate(items)
    ]  # fmt: skip


def _outputs(
    items: Sequence[Variable], place: str, known: Sequence[FmuVariable], prefix: str = "", text: str = "Reading"
) -> list[FmuVariable]:
    """Output variables. known: those before, whose names are taken."""
    taken = {item.name for item in known}
    found = _each(items, place, prefix, causality="output", description=text)
    return [replace(item, name=f"output.{item.name}") if item.name in taken else item for item in found]

"""What is in an FMU: of a simulation, or of a loop's controller."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

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
        functions = Text((FMU_TEMPLATES / self.template).read_text(encoding="utf-8"))
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
        main = (FMU_TEMPLATES / "fmu.c").read_text(encoding="utf-8")
        own = functions.substitute(values)
        return Text(main).substitute({**values, "functions": own, "stubs": stubs(headers, main)})


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
    system, name = simulation.system, simulation.name
    variables = [TIME]
    for j, (item, actuator) in enumerate(zip(system.inputs, simulation.rig.actuators, strict=True)):
        variables.append(
            FmuVariable(
                name=structured(item.name), causality="input", place=f"unit.inputs[{j}]", unit=item.unit,
                start=actuator.rest, low=actuator.low, high=actuator.high, description="Held over a step",
            )
        )  # fmt: skip
    variables += _outputs(system.outputs, "unit.outputs", variables)
    for i, item in enumerate(system.states):
        variables.append(
            FmuVariable(
                name=structured("state", item.name), causality="local", place=f"unit.state[{i}]", unit=item.unit,
                start=0.0, checked=True, description="State; it may be set before the first step",
            )
        )  # fmt: skip
    for i, (parameter, value) in enumerate(zip(system.parameters, system.values, strict=True)):
        if not parameter.learned and parameter.name not in simulation.constant_parameters:
            variables.append(
                FmuVariable(
                    name=structured("parameter", parameter.name), causality="parameter", variability="tunable",
                    place=f"unit.parameters[{i}]", unit=parameter.unit, start=float(value), low=parameter.low,
                    high=parameter.high, checked=True, description=parameter.description,
                )
            )  # fmt: skip
    for j, item in enumerate(system.inputs):
        variables.append(
            FmuVariable(
                name=structured("bias", item.name), causality="parameter", variability="tunable",
                place=f"unit.bias[{j}]", unit=item.unit, start=simulation.bias[j], checked=True,
                description="What acts beside the input, such as a push",
            )
        )  # fmt: skip
    files = simulation.texts(about=title)
    return FmuContent(
        identifier=name, unit=name, title=title, period=simulation.rig.step, variables=variables,
        members=f"    {name}_memory unit;", template="simulation.c", files=files,
        compiled=[file for file in files if file.endswith(".c")],
    )  # fmt: skip


def of_loop(rig: Rig, python: PythonLoop, folder: Path, *, name: str, title: str) -> FmuContent:
    """The content of a controller's FMU. folder: of the exported loop. name: of its unit."""
    system, horizon = python.estimator.system, python.mpc.horizon
    variables = [TIME]
    for j, item in enumerate(system.outputs):
        variables.append(
            FmuVariable(
                name=structured(f"measured_{item.name}"), causality="input", place=f"outputs[{j}]", unit=item.unit,
                start=0.0, description="Reading at the beginning of a step; not a number where it is missing",
            )
        )  # fmt: skip
    for j, item in enumerate(system.outputs):
        variables.append(
            FmuVariable(
                name=structured(f"reference_{item.name}"), causality="input", place=f"reference[{j}]", unit=item.unit,
                start=0.0, description="Reference, held over the horizon",
            )
        )  # fmt: skip
    for j, item in enumerate(system.outputs):
        variables.append(
            FmuVariable(
                name=structured(f"preview_{item.name}"), causality="input", place=f"preview[{j}]", unit=item.unit,
                start=0.0, size=horizon,
                description=f"References every {python.mpc.period:g} s of the horizon, if preview_given",
            )
        )  # fmt: skip
    for j, item in enumerate(system.inputs):
        variables.append(
            FmuVariable(
                name=structured(f"applied_{item.name}"), causality="input", place=f"applied[{j}]", unit=item.unit,
                start=0.0, description="Mean of what acted since the step before, if applied_given",
            )
        )  # fmt: skip
    for flag, text in (("preview", "preview_* in place of reference_*"), ("applied", "applied_* in place of commands")):
        variables.append(
            FmuVariable(
                name=f"{flag}_given", causality="parameter", variability="fixed", kind="Boolean",
                place=f"{flag}_given", start=0.0, description=f"Whether to take {text}",
            )
        )  # fmt: skip
    low, high = python.limits
    for j, item in enumerate(system.inputs):
        variables.append(
            FmuVariable(
                name=structured(item.name), causality="output", place=f"command.inputs[{j}]", unit=item.unit,
                low=float(low[j]), high=float(high[j]), description="Command for this step",
            )
        )  # fmt: skip
    variables.append(
        FmuVariable(
            name="status", causality="output", kind="Enumeration", place="command.status",
            description="How the command was found",
        )
    )  # fmt: skip
    variables += _outputs(python.mpc.system.states, "command.state", variables, "estimate", "Estimate at the reading")
    units = [Variable(name=item.name, unit=item.unit) for item in system.inputs]
    variables += _outputs(units, "command.disturbance", variables, "disturbance", "Estimated offset of the input")
    m, p = len(system.inputs), len(system.outputs)
    members = [
        f"double outputs[{p}];", f"double reference[{p}];", f"double preview[{p}][{horizon}];", f"double applied[{m}];",
        "int preview_given, applied_given;", f"{name}_command command;", f"{name}_memory unit;",
    ]  # fmt: skip
    files = {path.name: path.read_text(encoding="utf-8") for path in sorted((folder / "daqp").glob("*.[ch]"))}
    files |= {f"{name}{ending}": (folder / f"{name}{ending}").read_text(encoding="utf-8") for ending in (".c", ".h")}
    files |= {f"{name}_solver.c": solver(name, [file for file in files if (folder / "daqp" / file).is_file()])}
    return FmuContent(
        identifier=f"{name}_controller", unit=name, title=title, period=python.estimator.period, variables=variables,
        members="\n".join(f"    {line}" for line in members), template="loop.c", files=files,
        compiled=[f"{name}.c", f"{name}_solver.c"], statuses=STATUSES,
    )  # fmt: skip


def solver(name: str, files: Sequence[str]) -> str:
    """One C file of all DAQP's, which gets its memory from the loop's."""
    renamed = ("malloc", "allocate"), ("calloc", "allocate_zeros"), ("free", "release")
    lines = ["/* DAQP, with the loop's memory in place of malloc's. Generated; do not edit. */"]
    lines += [
        "#include <math.h>",
        "#include <stddef.h>",
        "#include <stdio.h>",
        "#include <stdlib.h>",
        "#include <string.h>",
    ]
    lines += ["", f"void *{name}_allocate(size_t size);", f"void *{name}_allocate_zeros(size_t count, size_t size);"]
    lines += [f"void {name}_release(void *memory);", ""]
    lines += [f"#define {old} {name}_{new}" for old, new in renamed]
    return "\n".join([*lines, "", *(f'#include "{file}"' for file in files if file.endswith(".c")), ""])


def _outputs(
    items: Sequence[Variable], place: str, known: Sequence[FmuVariable], group: str = "", text: str = "Reading"
) -> list[FmuVariable]:
    """Output variables. known: those before, whose names are taken."""
    taken = {item.name for item in known}
    found = []
    for j, item in enumerate(items):
        name = structured(group, item.name) if group else structured(item.name)
        name = structured("output", item.name) if name in taken else name
        found.append(
            FmuVariable(name=name, causality="output", place=f"{place}[{j}]", unit=item.unit, description=text)
        )
    return found

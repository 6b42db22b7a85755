"""The folder of a colcon package with a chainable controller around a loop's C unit."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.extensions.export.c_source import Text, number
from hybrid_sysid_ros.extensions.export.unit.folder import UnitExport, export_loop, unit_name
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.files import check_folder, written_folder

PACKAGE = Path(__file__).parent / "package"
MARKER = "plugin.xml"


def export_ros2_control(
    rig: Rig, model: Model, out: Path | str, *,
    settings: Mapping[str, Any], seal: str, overwrite: bool = False, **more: Any,
) -> UnitExport:  # fmt: skip
    """Write the package. The arguments are those of :func:`~..unit.folder.export_loop`, which checks the unit within.

    Raises UserError where the place can't be written, without a C compiler, and for what can't be printed.
    """
    check_folder(out, marker=MARKER, replace=overwrite)
    name = unit_name(rig.name)
    python = loop_in_python(rig, model, settings, more.get("network"))
    with written_folder(out, marker=MARKER) as partial:
        done = export_loop(rig, model, partial / "unit", settings=settings, seal=seal, **more)
        _test_of_unit_stays_out(partial / "unit")
        values = _values(rig, name, seal, period=python.estimator.period, horizon=python.mpc.horizon)
        for file, target in (
            ("controller.hpp", f"include/{name}_controller/controller.hpp"),
            ("controller.cpp", "src/controller.cpp"),
            ("parameters.yaml", f"src/{name}_controller_parameters.yaml"),
            ("plugin.xml", MARKER),
            ("manifest.xml", "package.xml"),
            ("CMakeLists.txt", "CMakeLists.txt"),
            ("README.txt", "README.md"),
        ):
            path = partial / target
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(Text((PACKAGE / file).read_text(encoding="utf-8")).substitute(values), encoding="utf-8")
        shutil.copyfile(partial / "unit" / "daqp" / "LICENSE", partial / "LICENSE.daqp")
    return done


def _test_of_unit_stays_out(unit: Path) -> None:
    """Let the unit's test be built where it is the project, and not as a part of another one."""
    path = unit / "CMakeLists.txt"
    text = path.read_text(encoding="utf-8")
    head, found, tail = text.partition("enable_testing()")
    if found:
        path.write_text(f"{head}if(CMAKE_PROJECT_NAME STREQUAL PROJECT_NAME)\n{found}{tail}endif()\n", encoding="utf-8")


def _values(rig: Rig, name: str, seal: str, *, period: float, horizon: int) -> dict[str, Any]:
    system = rig.system
    outputs, inputs = ([item.name for item in group] for group in (system.outputs, system.inputs))
    states, commands = ([_interface(rig, item) for item in group] for group in (outputs, inputs))
    return {
        "name": name,
        "NAME": name.upper(),
        "title": f"The loop of {rig.name}, {seal}",
        "period": number(period),
        "rate": f"{1.0 / period:g}",
        "rest": ", ".join(number(actuator.rest) for actuator in rig.actuators),
        "outputs": ", ".join(f'"{item}"' for item in outputs),
        "outputs_text": ", ".join(map(str, system.outputs)),
        "inputs_text": ", ".join(map(str, system.inputs)),
        "states": ", ".join(f'"{item}"' for item in states),
        "commands": ", ".join(f'"{item}"' for item in commands),
        "references": ", ".join(f"{name}_controller/{item}" for item in outputs),
        "p": len(outputs),
        "m": len(inputs),
        "preview": horizon * len(outputs),
    }


def _interface(rig: Rig, variable: str) -> str:
    """The interface of an output or input, JOINT/FIELD."""
    for name, joint in rig.joints.joints.items():
        if field := joint.field_of(variable):
            return f"{name}/{field}"
    return f"{variable}/value"

"""An FMU file: written only if FMPy finds nothing wrong with it, and it answers as Python does."""

from __future__ import annotations

import html
import platform
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.fmu.content import FmuContent, of_loop, of_simulation
from hybrid_sysid_ros.extensions.export.fmu.description import build_description, model_description
from hybrid_sysid_ros.extensions.export.fmu.fmpy_check import RunningFmu, headers, validate
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.extensions.export.unit.built import WARNINGS
from hybrid_sysid_ros.extensions.export.unit.folder import RECORDED, export_loop, unit_name
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.extensions.export.unit.replay import recorded
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, written_file

TOLERANCE, CONVERGED = 1e-9, 1e-6
"""Largest difference from Python, in the variables' units, relative above 1. The second holds where answers are defined
to a residual: with a policy.
"""
STEPS, HELD, SECONDS = 2000, 50, 2.0
"""Steps that are compared, steps over which an input is held, and the most seconds of a run: in longer ones an unstable
rig makes much of the last bit.
"""
SHOWN = 10.0
"""Default length of a simulation [s]."""
FLAGS = ("-std=c99", "-O2", "-fPIC", "-fvisibility=hidden")


@dataclass(frozen=True, kw_only=True)
class FmuExport:
    """What was written. difference: the largest one from Python over so many periods; None without a compiler."""

    identifier: str
    period: float
    variables: int
    by: str
    periods: int
    difference: float | None


def export_simulation(
    rig: Rig, out: Path | str, *, model: Model | None, seal: str = "", overwrite: bool = False
) -> FmuExport:
    """Write the FMU of a model, or without one that of the rig's simulated plant.

    Raises UserError where the place can't be written, without FMPy, for a law that has no trace, and where the FMU
    answers otherwise than Python.
    """
    check_file(out, suffix=".fmu", replace=overwrite)
    part = "plant" if model is None else "model"
    name = f"{unit_name(rig.name)}_{part}"
    made = Simulation(name=name, rig=rig, bias=rig.bias) if model is None else Simulation.of_model(name, rig, model)
    title = f"The simulated plant of {rig.name}" if model is None else f"{model.structure} of {rig.name}, {seal}"
    content = of_simulation(made, title=title)
    with written_file(Path(out)) as partial:
        by = _write(content, partial, more={})
        return _export(content, by, None if not by else _compared_simulation(made, partial), STEPS)


def export_controller(
    rig: Rig, model: Model, out: Path | str, *,
    settings: Mapping[str, Any], seal: str, source: Path | None = None, overwrite: bool = False, **more: Any,
) -> FmuExport:  # fmt: skip
    """Write the FMU of a whole controller: estimator, MPC and, by the settings, a policy with its check.

    The arguments are those of :func:`~..unit.folder.export_loop`, which checks the unit within first.
    """
    check_file(out, suffix=".fmu", replace=overwrite)
    headers()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch) / "loop"
        done = export_loop(rig, model, folder, settings=settings, seal=seal, source=source, **more)
        python = loop_in_python(rig, model, settings, more.get("network"))
        title = f"The controller of {rig.name}, {seal}"
        content = of_loop(rig, python, folder, name=done.name, title=title)
        licences = {"documentation/licenses/DAQP.txt": (folder / "daqp" / "LICENSE").read_text(encoding="utf-8")}
        with written_file(Path(out)) as partial:
            by = _write(content, partial, more=licences)
            questions, answers = recorded(rig, python, RECORDED)
            with RunningFmu(partial) as fmu:
                tolerance = TOLERANCE if python.supervisor is None else CONVERGED
                difference = _compared_loop(fmu, content, questions, answers, tolerance)
            return _export(content, by, difference, RECORDED)


def export_fmu(
    rig: Rig, model: Model, out: Path | str, *,
    seal: str, network: Policy | None = None, overwrite: bool = False, **more: Any,
) -> FmuExport:  # fmt: skip
    """The FMU of a model, or with a network that of its supervised controller."""
    if network is None:
        return export_simulation(rig, out, model=model, seal=seal, overwrite=overwrite)
    return export_controller(rig, model, out, seal=seal, network=network, overwrite=overwrite, **more)


def _export(content: FmuContent, by: str, difference: float | None, periods: int) -> FmuExport:
    return FmuExport(
        identifier=content.identifier, period=content.period, variables=len(content.variables), by=by,
        periods=periods if by else 0, difference=difference,
    )  # fmt: skip


# ---------------------------------------------------------------------- the file


def _write(content: FmuContent, target: Path, *, more: Mapping[str, str]) -> str:
    """Write the archive; return the compiler with its flags, "" without one. Raises UserError for what FMPy finds."""
    declared = headers()
    token = f"{{{uuid.uuid5(uuid.NAMESPACE_URL, repr((content.title, content.members, content.files)))}}}"
    wrapper = f"{content.identifier}_fmu.c"
    sources = {**declared, **content.files, wrapper: content.wrapper(declared, token)}
    compiled = [*content.compiled, wrapper]
    description = model_description(
        content.variables, name=content.identifier, identifier=content.identifier, about=content.title, token=token,
        tool=f"hybrid_sysid_ros {version('hybrid_sysid_ros')}", period=content.period, duration=SHOWN,
        statuses=content.statuses,
    )  # fmt: skip
    files = {
        "modelDescription.xml": description,
        "sources/buildDescription.xml": build_description(content.identifier, compiled),
        "documentation/index.html": _page(content),
        **{f"sources/{name}": text for name, text in sources.items()},
        **more,
    }
    with TemporaryDirectory() as scratch:
        root = Path(scratch)
        for name, text in files.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text, encoding="utf-8")
        by = _build(root, content.identifier, compiled)
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(item for item in root.rglob("*") if item.is_file()):
                archive.write(path, path.relative_to(root).as_posix())
    validate(target)
    return by


def _build(root: Path, identifier: str, compiled: list[str]) -> str:
    """Add a shared library where a compiler for Linux is there."""
    found = compiler.found()
    if found is None or platform.system() != "Linux":
        return ""
    folder = root / "binaries" / f"{platform.machine()}-linux"
    folder.mkdir(parents=True)
    objects = []
    for name in compiled:
        own = name == f"{identifier}_fmu.c"
        objects.append(root.parent / f"{root.name}_{name}.o")
        warnings = (*WARNINGS, "-Werror") if own else ("-w",)
        compiler.compile_source(
            [found, *FLAGS, *warnings, "-c", str(root / "sources" / name), "-o", str(objects[-1])], name
        )
    compiler.compile_source(
        [found, "-shared", *map(str, objects), "-o", str(folder / f"{identifier}.so"), "-lm"], identifier
    )
    for path in objects:
        path.unlink()
    return f"{found} {' '.join(FLAGS)}"


def _page(content: FmuContent) -> str:
    """documentation/index.html: title and variables."""
    rows = "\n".join(
        f"<tr><td>{html.escape(item.name)}</td><td>{item.causality}</td><td>{html.escape(item.unit)}</td>"
        f"<td>{html.escape(item.description)}</td></tr>"
        for item in content.variables
    )
    return (
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{html.escape(content.identifier)}</title>\n'
        f"<h1>{html.escape(content.title)}</h1>\n<p>It steps every {content.period:g} s, or by a multiple of it.</p>\n"
        f"<table>\n{rows}\n</table>\n</html>\n"
    )


# ---------------------------------------------------------------------- comparisons


def _compared_simulation(made: Simulation, path: Path) -> float:
    """The largest difference of states and outputs from Python's under random inputs, which leave their bounds."""
    random, period, (low, high) = np.random.default_rng(0), made.rig.step, made.rig.limits
    steps = steps_of(period)
    with RunningFmu(path) as fmu:
        names = [item.name for item in fmu.description.modelVariables]
        given = names[1 : 1 + len(low)]
        shown = names[1 + len(low) : 1 + len(low) + len(made.system.outputs)]
        shown += [name for name in names if name.startswith("state.")]
        largest = 0.0
        for _ in range(STEPS // steps):
            levels = random.uniform(-0.6, 0.6, (steps // HELD + 1, len(low)))
            inputs = np.repeat(0.5 * (low + high) + (high - low) * levels, HELD, axis=0)[:steps]
            states, outputs = made.run(inputs)
            fmu.fmu.reset()
            fmu.set(given, inputs[0])
            fmu.start()
            found = [fmu.get(shown)]
            for k, row in enumerate(inputs):
                fmu.set(given, row)
                fmu.fmu.doStep(k * period, period)
                found.append(fmu.get(shown))
            expected = np.column_stack([outputs, states])
            largest = max(largest, _checked(expected, np.array(found), "states or outputs", TOLERANCE))
    return largest


def steps_of(period: float) -> int:
    """Steps of a run of a comparison, SECONDS and at least one level of the inputs; period: of a step [s]."""
    return min(STEPS, max(HELD, round(SECONDS / period)))


def _compared_loop(fmu: RunningFmu, content: FmuContent, questions: Any, answers: Any, tolerance: float) -> float:
    """The largest difference of the commands from Python's."""
    readings, applied, previews, commands = (
        [item.name for item in content.variables if item.place.startswith(f"{place}[")]
        for place in ("outputs", "applied", "preview", "command.inputs")
    )
    fmu.fmu.setBoolean([fmu.references["preview_given"], fmu.references["applied_given"]], [True, True])
    fmu.start(questions[0].time)
    found = []
    for k, question in enumerate(questions):
        fmu.set(readings, question.outputs)
        fmu.set(applied, question.applied)
        fmu.set(previews, question.preview.T)
        fmu.fmu.doStep(questions[0].time + k * content.period, content.period)
        found.append(fmu.get(commands))
    return _checked(np.array([item.inputs for item in answers]), np.array(found), "commands", tolerance)


def _checked(expected: Any, found: Any, what: str, tolerance: float) -> float:
    """The largest difference. Raises UserError where it is above the tolerance."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)
    apart = np.where((found == expected) | (np.isnan(found) & np.isnan(expected)), 0.0, apart)
    largest = float(np.max(np.where(np.isnan(apart), np.inf, apart), initial=0.0))
    if not largest <= tolerance:
        raise UserError(
            f"export: the FMU's {what} differ by {largest:.3g} from Python's, more than {tolerance:g}; nothing is "
            "written: report this"
        )
    return largest

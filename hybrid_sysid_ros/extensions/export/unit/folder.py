"""The folder of an exported loop: written only if the unit answers as the loop in Python does."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.estimation import METHODS, ExtendedKalmanFilter
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text, number
from hybrid_sysid_ros.extensions.export.unit import unit
from hybrid_sysid_ros.extensions.export.unit.built import FLAGS, WARNINGS, BuiltUnit, build
from hybrid_sysid_ros.extensions.export.unit.daqp_source import copy_to, daqp
from hybrid_sysid_ros.extensions.export.unit.loop_kernels import PrintedLoop
from hybrid_sysid_ros.extensions.export.unit.replay import (
    PeriodAnswer,
    PeriodQuestion,
    PythonLoop,
    answers_of,
    largest_difference,
    odd,
    recorded,
)
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import (
    controller_model,
    defaults,
    estimator_model,
    estimator_tuning,
    mpc_problem,
    wrap_for_rig,
)
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder, sha256, written_folder

MANIFEST = "export.json"
FORMAT = 1
TOLERANCE = 1e-9
"""Largest difference of a unit's answers from Python's, in the inputs' and states' units, relative above 1."""
RECORDED, ODD, SHOWN = 1000, 2000, 100
"""Periods of the recorded loop, of questions that no loop is asked, and of the test that goes with the unit."""


@dataclass(frozen=True, kw_only=True)
class UnitExport:
    """What was written. differences: the largest ones of each replay, by part. bytes: of the unit's memory."""

    name: str
    by: str
    differences: Mapping[str, Mapping[str, float]]
    bytes: int
    periods: Mapping[str, int]


def loop_in_python(rig: Rig, model: Model, settings: Mapping[str, Any]) -> PythonLoop:
    """Estimator and controller of a rig from the parameters of the nodes, the estimator's with the prefix estimator.

    Raises UserError for a method, a solver or a model that can't be printed.
    """
    values, given = defaults(rig, "estimator"), defaults(rig, "controller") | dict(settings)
    if METHODS[values["method"]] is not ExtendedKalmanFilter:
        raise UserError(f"export: the estimator's method {values['method']} can't be printed as C; set method to ekf")
    if given["solver"] != "exact":
        raise UserError(f"export: the solver {given['solver']} can't be printed as C; set solver to exact")
    model = estimator_model(rig, model)
    system = controller_model(rig, model.system)
    tuning = estimator_tuning(values, rig, model.system)
    mpc = ExactMpc(system, mpc_problem(given, rig, system), real_time=given["real_time"])
    return PythonLoop(
        estimator=ExtendedKalmanFilter(model.system, tuning, period=1.0 / values["rate"], latency=given["latency"]),
        controller=wrap_for_rig(rig, system, mpc),
        mpc=mpc,
        command=np.array([actuator.rest for actuator in rig.actuators]),
    )


def export_loop(
    rig: Rig,
    model: Model,
    out: Path | str,
    *,
    settings: Mapping[str, Any],
    seal: str,
    source: Path | None = None,
    periods: int = RECORDED,
    more: int = ODD,
    overwrite: bool = False,
) -> UnitExport:
    """Write a loop as a C unit. settings: parameters of the node controller. source: folder of DAQP's C, else the
    package index is asked. periods, more: of the two replays.

    Raises UserError for what can't be printed, without a C compiler, and where the unit answers otherwise than Python.
    """
    check_folder(out, marker=MANIFEST, replace=overwrite)
    by = compiler.found()
    if by is None:
        names = ", ".join(compiler.COMPILERS)
        raise UserError(
            f"export: there is no C compiler ({names}), so that the unit can't be checked; install one (apt install "
            "gcc). policy export and model export work without one"
        )
    name = unit_name(rig.name)
    python = loop_in_python(rig, model, settings)
    loop = unit.loop_of(rig, python.estimator, python.mpc)
    printer = unit.translated(loop, python.estimator._arrays, name, single=False)
    solver = daqp(source)
    about = {
        "made_by": f"hybrid_sysid_ros {version('hybrid_sysid_ros')}",
        "rig": rig.name,
        "model": f"{model.structure}, {seal}",
        "estimator": f"extended Kalman filter, every {python.estimator.period:g} s",
        "controller": f"exact MPC{', one real-time iteration a period' if python.mpc.real_time else ''}; "
        f"{python.mpc.horizon} intervals of {python.mpc.period:g} s",
        "solver": f"DAQP {version('daqp')} (MIT)",
    }
    with written_folder(out, marker=MANIFEST) as partial:
        copy_to(solver, partial / "daqp")
        title = f"The loop of {rig.name}: its estimator and its exact MPC"
        texts = unit.texts(printer, loop, title=title, about=about, soft=python.mpc.shooting.memory[-1])
        for file, text in texts.items():
            (partial / file).write_text(text, encoding="utf-8")
        questions, answers = recorded(rig, python, periods)
        with TemporaryDirectory(dir=partial.parent) as scratch:
            made = BuiltUnit(build(by, partial, name, Path(scratch)), name, **_sizes(loop))
            differences = _compared(python, made, questions, answers, more)
        done = UnitExport(
            name=name,
            by=f"{by} {' '.join((*FLAGS, *WARNINGS))}",
            differences=differences,
            bytes=made.bytes,
            periods={"recorded": periods, "odd": more},
        )
        _write_rest(partial, done, loop, python, title=title, about=about, questions=questions, answers=answers)
        content = {
            "format": FORMAT,
            **about,
            "name": name,
            "seal": seal,
            "bytes": made.bytes,
            "checked_by": done.by,
            "largest_differences": {key: dict(value) for key, value in differences.items()},
            "periods": dict(done.periods),
            "files": {
                str(path.relative_to(partial)): sha256(path) for path in sorted(partial.rglob("*")) if path.is_file()
            },
        }
        (partial / MANIFEST).write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return done


def unit_name(rig: str) -> str:
    """What every name of a unit begins with."""
    name = re.sub(r"[^0-9a-z]+", "_", rig.lower()).strip("_")
    return name if name and name[0].isalpha() else f"rig_{name}"


def _sizes(loop: PrintedLoop) -> dict[str, int]:
    horizon, outputs = loop.instance.preview.shape
    n, m = len(loop.instance.state), len(loop.instance.previous)
    return {"states": n, "inputs": m, "outputs": outputs, "horizon": horizon}


def _compared(
    python: PythonLoop,
    made: BuiltUnit,
    questions: Sequence[PeriodQuestion],
    answers: Sequence[PeriodAnswer],
    more: int,
) -> dict[str, dict[str, float]]:
    """Largest differences. Raises UserError where one is above the tolerance."""
    period = python.estimator.period
    found = {"recorded": largest_difference(answers_of(made, questions, period), answers)}
    others = list(odd(questions, more, period=period))
    if others:
        found["odd"] = largest_difference(answers_of(made, others, period), answers_of(python, others, period))
    for kind, parts in found.items():
        worst = max(parts, key=lambda name: parts[name])
        if not parts[worst] <= TOLERANCE:
            raise UserError(
                f"export: the unit's {worst} differs by {parts[worst]:.3g} from Python's in the {kind} loop, more than "
                f"{TOLERANCE:g}; nothing is written: report this"
            )
    return found


def _write_rest(
    folder: Path,
    done: UnitExport,
    loop: PrintedLoop,
    python: PythonLoop,
    *,
    title: str,
    about: Mapping[str, str],
    questions: Sequence[PeriodQuestion],
    answers: Sequence[PeriodAnswer],
) -> None:
    """Write the test with its vectors, CMakeLists.txt and README.md."""
    rows = [_row(question, answer) for question, answer in zip(questions[:SHOWN], answers[:SHOWN], strict=True)]
    values = {
        "name": done.name,
        "NAME": done.name.upper(),
        "title": title,
        "about": "\n".join(f" * {key}: {value}" for key, value in about.items()),
        "about_lines": "\n".join(f"- {key}: {value}" for key, value in about.items()),
        "periods": len(rows),
        "table": ",\n".join(rows),
        "tolerance": number(TOLERANCE),
        "period": number(python.estimator.period),
        "bytes": done.bytes,
        "more": "",
        "definitions": "",
        "checks": "\n".join(
            f"- {done.periods[kind]} {kind} periods: largest difference of the inputs {parts['inputs']:.1e}, of the "
            f"states {parts['state']:.1e}"
            for kind, parts in done.differences.items()
        ),
    }
    for file, target in (
        ("loop_test.c", f"{done.name}_test.c"),
        ("CMakeLists.txt", "CMakeLists.txt"),
        ("README.md", "README.md"),
    ):
        text = Text((unit.UNIT_TEMPLATES / file).read_text(encoding="utf-8")).substitute(values)
        (folder / target).write_text(text, encoding="utf-8")


def _row(question: PeriodQuestion, answer: PeriodAnswer) -> str:
    def listed(values: Any) -> str:
        return "{" + ", ".join(number(value) for value in np.ravel(values)) + "}"

    measurement = f"{{{number(question.time)}, {listed(question.outputs)}, {listed(question.applied)}}}"
    row = f"{{{measurement}, {{{listed(question.preview)}}}, {answer.status}, {listed(answer.inputs)}}}"
    return textwrap.fill(row, 118, initial_indent="    ", subsequent_indent="     ", break_on_hyphens=False)

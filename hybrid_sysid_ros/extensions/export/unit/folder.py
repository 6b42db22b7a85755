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

from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text, number
from hybrid_sysid_ros.extensions.export.unit import stack_use, unit
from hybrid_sysid_ros.extensions.export.unit.built import FLAGS, WARNINGS, BuiltUnit, build
from hybrid_sysid_ros.extensions.export.unit.daqp_source import copy_to, daqp
from hybrid_sysid_ros.extensions.export.unit.printed_loop import PrintedLoop
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop, loop_in_python
from hybrid_sysid_ros.extensions.export.unit.replay import (
    FAULTS,
    SPELL,
    PeriodAnswer,
    PeriodQuestion,
    answers_of,
    difference_from,
    largest_difference,
    odd,
    recorded,
)
from hybrid_sysid_ros.extensions.export.unit.values import literal
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder, sha256, written_folder

MANIFEST = "export.json"
FORMAT = 1
TOLERANCE, LOOSE = 1e-9, 1e-6
"""Largest difference of a unit's answers from Python's, in the inputs' and states' units, relative above 1. The second
holds where a loop is asked what no rig shows, and where the exact MPC iterates to convergence: its answers are defined
to its tolerance of the residual (1e-6), within which the order of a sum decides.
"""
ROUNDING = 1e-6
"""By which a float may be beyond its bound."""
OF_FLOATS, SHARE_OF_FLOATS = 1e-2, 1e-4
"""That of floats, or this share of the widest input's range where it is more, as of counts up to 255. It is no check of
the translation: a threshold may keep one plan and solve another one anew. Each period follows Python's command: where
two inputs can do the same, the rounding of many periods moves one by more.
"""
SAME = "command.status == periods[k].status;"
MOST = 0.95
"""Share of the odd periods whose inputs must agree. A cold start iterates to convergence, and rounding can lead it to
another local solution, from which the periods behind it go on.
"""
TAKEN = frozenset((
    "assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "limits", "locale", "math", "memory",
    "sched", "search", "setjmp", "signal", "stdio", "stdlib", "string", "strings", "tgmath", "threads", "time",
    "types", "uchar", "utils", "wait", "wchar", "wctype", "api", "auxiliary", "avi", "bnb", "constants", "daqp",
    "factorization", "hierarchical", "presolve", "board", "cdr", "console", "controller", "diagnostics",
    "estimator", "fmu", "frames", "joints", "lifecycle", "loop", "main", "node", "operation", "output", "parameter",
    "parameters", "plant", "reference", "simulation", "start", "all", "clean", "help", "install", "package", "test",
    "m", "c",
))  # fmt: skip
"""Headers of C and POSIX, of DAQP, files of the bodies around a unit, targets of CMake, and libraries of C."""
SINGLE = ("-DDAQP_SINGLE_PRECISION",)
RECORDED, ODD, SHOWN = 1000, 2000, 100
"""Periods of the recorded loop, of questions that no loop is asked, and of the test that goes with the unit."""


RecordedLoop = tuple[Sequence[PeriodQuestion], Sequence[PeriodAnswer]]
"""What a loop in Python was asked, and what it answered."""


@dataclass(frozen=True, kw_only=True)
class UnitExport:
    """What was written. differences: the largest ones of each replay, by part, within the tolerances. bytes: of the
    unit's memory.
    """

    name: str
    by: str
    differences: Mapping[str, Mapping[str, float]]
    tolerances: Mapping[str, float]
    bytes: int
    stack: int | None
    """Bytes of the stack at most; None where the compiler is not gcc, which tells it."""
    periods: Mapping[str, int]
    sizes: Mapping[str, int]
    """Numbers of states, inputs, outputs, and the horizon's length."""
    active: int
    """How many constraints can be active in the solver."""


def export_loop(
    rig: Rig,
    model: Model,
    out: Path | str,
    *,
    settings: Mapping[str, Any],
    seal: str,
    network: Policy | None = None,
    policy_seal: str = "",
    source: Path | None = None,
    single: bool = False,
    periods: int = RECORDED,
    more: int = ODD,
    shown: int = SHOWN,
    overwrite: bool = False,
) -> UnitExport:
    """Write a loop as a C unit. settings: parameters of the node controller. network: the policy that drives, if it is
    not in a folder that they name. policy_seal: its seal. source: folder of DAQP's C, else the package index is asked.
    single: with floats in place of doubles. periods, more: of the two replays.
    shown: periods of the test that goes with the unit.

    Raises UserError for what can't be printed, without a C compiler, and where the unit answers otherwise than Python.
    """
    check_folder(out, marker=MANIFEST, replace=overwrite)
    by, name = _compiler(), unit_name(rig.name)
    python = loop_in_python(rig, model, settings, network)
    loop = unit.loop_of(rig, python)
    printer = unit.translated(loop, python.estimator._arrays, name, single=single)
    solver = daqp(source)
    title = f"The loop of {rig.name}: its estimator and its exact MPC"
    about = _about(rig, model, python, seal, policy_seal, single=single)
    with written_folder(out, marker=MANIFEST) as partial:
        copy_to(solver, partial / "daqp")
        texts = unit.texts(printer, loop, title=title, about=about, seal=seal, soft=python.mpc.shooting.memory[-1])
        for file, text in texts.items():
            (partial / file).write_text(text, encoding="utf-8")
        replay = recorded(rig, python, periods)
        done = _checked(by, partial, name, rig, python, loop, replay, more, single=single)
        _write_rest(
            partial,
            done,
            python,
            title=title,
            about=about,
            single=single,
            shown=list(zip(*replay, strict=True))[:shown],
        )
        _write_manifest(partial, done, about, seal)
    return done


def _compiler() -> str:
    """The C compiler. Raises UserError where there is none."""
    found = compiler.found()
    if found is None:
        names = ", ".join(compiler.COMPILERS)
        raise UserError(
            f"export: there is no C compiler ({names}), so that the unit can't be checked; install one (apt install "
            "gcc). policy export, model export, export urdf and the FMU of a model work without one"
        )
    return found


def _about(
    rig: Rig, model: Model, python: PythonLoop, seal: str, policy_seal: str, *, single: bool
) -> dict[str, str]:  # fmt: skip
    """What a unit is made of, for the heads of its files."""
    mpc = python.mpc
    return {
        "made_by": f"hybrid_sysid_ros {version('hybrid_sysid_ros')}",
        "rig": rig.name,
        "model": f"{model.structure}, {seal}",
        "estimator": f"extended Kalman filter, every {python.estimator.period:g} s",
        "numbers": "float" if single else "double",
        "controller": f"exact MPC{', one real-time iteration a period' if mpc.real_time else ''}; "
        f"{mpc.horizon} intervals of {mpc.period:g} s",
        "solver": f"DAQP {version('daqp')} (MIT)",
        **({} if python.supervisor is None else {"policy": policy_seal}),
    }


def _checked(
    by: str, folder: Path, name: str, rig: Rig, python: PythonLoop, loop: PrintedLoop, replay: RecordedLoop,
    more: int, *, single: bool,
) -> UnitExport:  # fmt: skip
    """Compile a unit and compare it with Python. Raises UserError where it answers otherwise."""
    sizes, active = sizes_of(loop), unit.most_active(loop)
    with TemporaryDirectory(dir=folder.parent) as scratch:
        flags = stack_use.FLAGS if compiler.is_gcc(by) else ()
        library = build(by, folder, name, Path(scratch), flags=(*flags, *(SINGLE if single else ())))
        made = BuiltUnit(library, name, **sizes, single=single)
        calls = [f"{name}_{call}" for call in ("step", "observe", "judge", "decide_from", "prepare", "reset")]
        stack = stack_use.most_bytes(Path(scratch), calls, constraints=active) if flags else None
        differences = _compared(rig, python, made, *replay, more, single=single)
    return UnitExport(
        name=name,
        by=f"{by} {' '.join((*FLAGS, *WARNINGS))}",
        differences=differences,
        tolerances={kind: tolerance_of(python, kind, single=single) for kind in differences},
        bytes=made.bytes,
        stack=stack,
        periods={"recorded": len(replay[0]), "faulty": SPELL * len(FAULTS), "odd": more},
        sizes=sizes,
        active=active,
    )


def tolerance_of(python: PythonLoop, kind: str, *, single: bool = False) -> float:
    """The tolerance of a replay."""
    if single:
        low, high = python.limits
        return max(OF_FLOATS, SHARE_OF_FLOATS * float(np.max(high - low)))
    return LOOSE if kind != "recorded" or python.iterates else TOLERANCE


def unit_name(rig: str) -> str:
    """What every name of a unit begins with, and those of its files are: none that a header or a target has already."""
    name = re.sub(r"[^0-9a-z]+", "_", rig.lower()).strip("_")
    return name if name and name[0].isalpha() and name not in TAKEN else f"rig_{name}"


def sizes_of(loop: PrintedLoop) -> dict[str, int]:
    """Sizes of a unit, as :class:`.built.BuiltUnit` takes them."""
    horizon, outputs = loop.instance.preview.shape
    n, m = len(loop.instance.state), len(loop.instance.previous)
    return {"states": n, "inputs": m, "outputs": outputs, "horizon": horizon}


def _compared(
    rig: Rig,
    python: PythonLoop,
    made: BuiltUnit,
    questions: Sequence[PeriodQuestion],
    answers: Sequence[PeriodAnswer],
    more: int,
    *,
    single: bool,
) -> dict[str, dict[str, float]]:
    """Largest differences. Raises UserError where one is above the tolerance, or an input leaves its bounds."""
    period = python.estimator.period
    mine = answers_of(made, questions, period, sent=answers if single else ())
    if single:  # rounding decides which side of a threshold a number is on
        found = {"recorded": largest_difference(mine, answers) | {"status": 0.0}}
    else:
        most = tolerance_of(python, "recorded")
        found = {"recorded": difference_from(python, questions, answers, mine, tolerance=most)}
    others = list(odd(questions, more, period=period))
    if others and not single:
        wrong, expected = recorded(rig, python, SPELL * len(FAULTS), faults=True)
        found["faulty"] = largest_difference(answers_of(made, wrong, period, sent=expected), expected, share=MOST)
    if others:
        expected = [] if single else answers_of(python, others, period)
        odd_answers = answers_of(made, others, period, sent=expected)
        _check_bounds(python, odd_answers)
        if not single:
            found["odd"] = largest_difference(odd_answers, expected, share=MOST)
    for kind, parts in found.items():
        worst = max(parts, key=lambda name: parts[name])
        tolerance = tolerance_of(python, kind, single=single)
        if not parts[worst] <= tolerance:
            less = f", or add --converged, which is held to {LOOSE:g}" if tolerance < parts[worst] <= LOOSE else ""
            raise UserError(
                f"export: the unit is not as Python: {worst} {parts[worst]:.3g} apart in the {kind} loop, where "
                f"{tolerance:g} is allowed; nothing is written: report this{less}"
            )
    return found


def _check_bounds(python: PythonLoop, answers: Sequence[PeriodAnswer]) -> None:
    """Raise UserError for an input that is no number or leaves its bounds."""
    low, high = python.limits
    for answer in answers:
        if not np.all((answer.inputs >= low - ROUNDING) & (answer.inputs <= high + ROUNDING)):
            raise UserError(f"export: the unit answers {answer.inputs}, beyond its bounds; nothing is written")


def _write_rest(
    folder: Path,
    done: UnitExport,
    python: PythonLoop,
    *,
    title: str,
    about: Mapping[str, str],
    single: bool,
    shown: Sequence[tuple[PeriodQuestion, PeriodAnswer]],
) -> None:
    """Write the test with its vectors, CMakeLists.txt and README.md."""
    suffix = "f" if single else ""
    rows = [_row(question, answer, suffix) for question, answer in shown]
    values = {
        "name": done.name,
        "NAME": done.name.upper(),
        "title": title,
        "about": "\n".join(f" * {key}: {value}" for key, value in about.items()),
        "about_lines": "\n".join(f"- {key}: {value}" for key, value in about.items()),
        "periods": len(rows),
        "table": ",\n".join(rows),
        "tolerance": number(done.tolerances["recorded"]),
        "period": literal(python.estimator.period, suffix),
        "bytes": done.bytes,
        "stack": ""
        if done.stack is None
        else f"Its calls take {done.stack} bytes of the stack at most (-O2 on the "
        "machine of the export, without those of the C library's tanh and sin). ",
        "more": "",
        "same": "1; /* which of two thresholds a float passes is rounding */" if single else SAME,
        "definitions": "DAQP_SINGLE_PRECISION" if single else "",
        "options": " -DDAQP_SINGLE_PRECISION" if single else "",
        "checks": "\n".join(
            f"- {done.periods[kind]} {kind} periods: largest difference of the inputs"
            f"{f' in {MOST:.0%} of them' if kind != 'recorded' else ''} {parts['inputs']:.1e}, of the "
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


def _write_manifest(folder: Path, done: UnitExport, about: Mapping[str, str], seal: str) -> None:
    """Write what the unit is, how it was checked, and the digests of all other files."""
    content = {
        "format": FORMAT,
        **about,
        "name": done.name,
        "seal": seal,
        "bytes": done.bytes,
        "stack": done.stack,
        "checked_by": done.by,
        "largest_differences": {key: dict(value) for key, value in done.differences.items()},
        "periods": dict(done.periods),
        "files": {str(path.relative_to(folder)): sha256(path) for path in sorted(folder.rglob("*")) if path.is_file()},
    }
    (folder / MANIFEST).write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _row(question: PeriodQuestion, answer: PeriodAnswer, suffix: str) -> str:
    def listed(values: Any) -> str:
        return "{" + ", ".join(literal(float(value), suffix) for value in np.ravel(values)) + "}"

    measurement = f"{{{number(question.time)}, {listed(question.outputs)}, {listed(question.applied)}}}"
    row = f"{{{measurement}, {{{listed(question.preview)}}}, {answer.status}, {listed(answer.inputs)}}}"
    return textwrap.fill(row, 118, initial_indent="    ", subsequent_indent="     ", break_on_hyphens=False)

"""The native loop: printed, compiled, compared with the loop in Python, and kept in the cache."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

from hybrid_sysid_ros.core.compilation import folder as cached
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.native.rig_parameters import AT_START
from hybrid_sysid_ros.extensions.native.ros_libraries import RosLibraries, ros_libraries
from hybrid_sysid_ros.models import load, storage
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.controllers import policy_folder
from hybrid_sysid_ros.runtime.parameters import shipped
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_folder
from hybrid_sysid_ros.support.progress import Report

NAME = "native_loop"
MANIFEST = "native.json"
TEMPLATES = Path(__file__).with_name("c")
PACKAGE = Path(__file__).parents[2]
SOURCES = ("core", "control", "estimation", "models", "structures", "rigs", "runtime", "nodes", "extensions")
"""Folders whose Python decides what is printed."""
FLAGS = ("-std=gnu11", "-O2", "-Wall", "-Wextra", "-fvisibility=hidden")
"""Hidden, since libraries of the middleware would call a function of ours that has the name of one of the system's."""
FURTHER_FLAGS = "CFLAGS"
"""Environment variable of further flags, as make has it."""
TIME_LIMIT = 300.0
"""Of compiling [s]."""
CHECKED = 1000
"""Periods with the simulated rig in which the compiled loop must answer as the one in Python."""


def native_loop(rig: Rig, values: Mapping[str, Mapping[str, Any]], *, tell: Report = print) -> Path:
    """The executable of a rig's loop for all parameters of estimator and controller, built if it is not in the cache.

    Raises UserError without a C compiler or ROS's headers, for what can't be printed as C, and where the compiled loop
    answers otherwise than the one in Python.
    """
    by, libraries = check_tools()
    estimator, controller = values["estimator"], values["controller"]
    if estimator["model"] != controller["model"] or estimator["latency"] != controller["latency"]:
        raise UserError("--native: estimator and controller have different models or latencies: give both the same")
    model_folder = Path(estimator["model"] or shipped(rig.name, "model"))
    policy = policy_folder(rig, controller)
    seals = {
        "model": storage.digest(model_folder, kind="model"),
        "policy": "" if policy is None else storage.digest(policy, kind="policy"),
    }
    key = _key(rig, values, seals, by, libraries)
    place = cached(NAME, key) / rig.name
    if not (place / MANIFEST).is_file():
        tell(f"building the native loop of {rig.name}, once for this model and these parameters")
        began = perf_counter()
        with written_folder(place, marker=MANIFEST) as partial:
            manifest = _make(rig, values, partial, by, libraries, model_folder, seals)
            manifest["seconds"] = round(perf_counter() - began, 2)
            (partial / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
        worst = f"{manifest['largest_difference']:.1e} in {CHECKED} periods"
        tell(f"built in {manifest['seconds']:.1f} s; as in Python to {worst}")
    return place / NAME


def check_tools() -> tuple[str, RosLibraries]:
    """The C compiler and the libraries of ROS. Raises UserError where there are none."""
    by = compiler.found()
    if by is None:
        raise UserError(
            f"--native: there is no C compiler ({', '.join(compiler.COMPILERS)}): install one (apt install gcc); "
            "without --native the loop runs in Python"
        )
    return by, ros_libraries()


def shaping(values: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The parameters that are parts of the compiled loop."""
    return {node: {name: value for name, value in own.items() if name not in AT_START} for node, own in values.items()}


def _key(
    rig: Rig, values: Mapping[str, Mapping[str, Any]], seals: Mapping[str, str], by: str, libraries: RosLibraries
) -> str:
    found = sha256()
    said = subprocess.run([by, "--version"], capture_output=True, text=True, check=False).stdout.partition("\n")[0]
    parts: list[Any] = [
        os.environ.get(FURTHER_FLAGS, ""),
        rig.source,
        shaping(values),
        dict(seals),
        said,
        libraries.where,
        version("daqp"),
    ]
    found.update(json.dumps(parts, sort_keys=True, default=str).encode())
    files = [*rig.file.parent.glob("*.*"), *TEMPLATES.iterdir()]
    for name in SOURCES:
        files += (PACKAGE / name).rglob("*.py")
    files += (PACKAGE / "extensions" / "export").rglob("*.[ch]")
    for path in sorted(path for path in files if path.is_file() and "tests" not in path.parts):
        found.update(path.read_bytes())
    return found.hexdigest()[:24]


def _make(
    rig: Rig,
    values: Mapping[str, Mapping[str, Any]],
    place: Path,
    by: str,
    libraries: RosLibraries,
    model_folder: Path,
    seals: Mapping[str, str],
) -> dict[str, Any]:
    """Print and compile a loop into a folder; return what its manifest says."""
    from hybrid_sysid_ros.extensions.export.unit import unit
    from hybrid_sysid_ros.extensions.export.unit.built import BuiltUnit, build
    from hybrid_sysid_ros.extensions.export.unit.daqp_source import copy_to, daqp
    from hybrid_sysid_ros.extensions.export.unit.folder import sizes_of, tolerance_of, unit_name
    from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
    from hybrid_sysid_ros.extensions.export.unit.replay import answers_of, difference_from, recorded
    from hybrid_sysid_ros.extensions.native import rig_text

    name, model = unit_name(rig.name), load(model_folder, rig=rig.source)
    python = loop_in_python(rig, model, values["controller"], estimation=values["estimator"])
    loop = unit.loop_of(rig, python)
    printer = unit.translated(loop, python.estimator._arrays, name, single=False)
    about = {"rig": rig.name, **seals}
    soft = python.mpc.shooting.memory[-1]
    body = f"native, {model.structure} {seals['model'][:12]}"
    files = unit.texts(printer, loop, title=f"The loop of {rig.name}", about=about, seal=seals["model"], soft=soft)
    for file, text in (files | rig_text.texts(rig, python, values, body=body)).items():
        (place / file).write_text(text, encoding="utf-8")
    copy_to(daqp(None), place / "daqp")
    further = tuple(shlex.split(os.environ.get(FURTHER_FLAGS, "")))
    common = [by, *FLAGS, *further, "-I", str(place), "-I", str(TEMPLATES), *libraries.include]
    objects, running = [], []
    for source in (place / "rig.c", *sorted(TEMPLATES.glob("*.c"))):
        objects.append(place / f"node_{source.stem}.o")
        running.append((source, _start([*common, "-c", str(source), "-o", str(objects[-1])])))
    library = build(by, place, name, place, flags=further)
    for source, process in running:
        _finish(process, source.name)
    others = [path for path in place.glob("*.o") if path not in objects]
    _finish(_start([by, *map(str, (*objects, *others)), "-o", str(place / NAME), *libraries.link, "-lm"]), NAME)
    questions, answers = recorded(rig, python, CHECKED)
    found = answers_of(BuiltUnit(library, name, single=False, **sizes_of(loop)), questions, python.estimator.period)
    tolerance = tolerance_of(python, "recorded")
    worst = max(difference_from(python, questions, answers, found, tolerance=tolerance).values())
    if not worst <= tolerance:
        raise UserError(f"--native: the compiled loop differs by {worst:.3g} from Python's, more than {tolerance:g}")
    for path in place.glob("*.o"):
        path.unlink()
    library.unlink()
    return {"name": name, **seals, "largest_difference": worst, "compiler": by, "ros": libraries.where}


def _start(command: list[str]) -> subprocess.Popen[str]:
    try:
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    except OSError as error:
        raise UserError(f"--native: {command[0]} can't be run: {error}") from error


def _finish(process: subprocess.Popen[str], what: str) -> None:
    try:
        _, said = process.communicate(timeout=TIME_LIMIT)
    except subprocess.TimeoutExpired as error:
        process.kill()
        raise UserError(f"--native: compiling {what} takes more than {TIME_LIMIT:g} s") from error
    if process.returncode:
        lines = [line for line in said.splitlines() if "error" in line or "undefined" in line] or ["it says nothing"]
        raise UserError(f"--native: {what} can't be compiled: {lines[0].strip()}")

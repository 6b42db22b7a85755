"""Exported loops asked what no rig would ask, under the sanitizers of the compiler.

    python -m benchmarks.loop_fuzz [CALLS] [RIG...]

Of each rig's shipped model: estimator with the exact MPC in real time, and with the supervised policy. Readings,
applied inputs, references and times are of any size, missing, infinite or no number. Each call must leave the inputs
numbers within their bounds, and the sanitizers of addresses and of undefined behaviour must find nothing.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.compiler import compile_source
from hybrid_sysid_ros.extensions.export.unit.built import renamed
from hybrid_sysid_ros.extensions.export.unit.folder import export_loop
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop, loop_in_python
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError

NAME = "loop_fuzz"
RIGS = ("cam_beam", "flexible_joint", "wheel_motor", "winged_cone", "drill_string", "balancing_robot")
CALLS = 1_000_000
"""Of each loop, over SEEDS."""
SEEDS = (0, 1, 2)
FEW = 100
"""Periods that a unit is compared in before it is asked; an export on its own replays more."""
SANITIZED = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SOURCE = Path(__file__).with_suffix(".c")


def sanitized_objects(unit: Path, name: str, into: Path) -> list[Path]:
    """The objects of a unit and its solver, with the sanitizers. Raises UserError where the compiler refuses a file."""
    made = []
    for path in (unit / f"{name}.c", *sorted((unit / "daqp").glob("*.c"))):
        made.append(into / f"{path.stem}.o")
        flags = [*_common(unit), *(renamed(name) if path.parent.name == "daqp" else ("-std=c99",)), "-w", "-c"]
        compile_source([*flags, str(path), "-o", str(made[-1])], path.name)
    return made


def fuzzed(unit: Path, name: str, loop: PythonLoop, objects: list[Path], *, calls: int, seed: int) -> str:
    """What the program says of its calls. loop: the same in Python, whose inputs have limits.

    Raises UserError with what it said where an input was out of bounds or a sanitizer spoke.
    """
    low, high = (", ".join(map(repr, limit.tolist())) for limit in loop.limits)
    source, program = objects[0].parent / "fuzz.c", objects[0].parent / "fuzz"
    text = Text(SOURCE.read_text(encoding="utf-8"))
    more = {"low": low, "high": high, "period": repr(loop.estimator.period), "about": ""}
    source.write_text(text.substitute(name=name, NAME=name.upper(), **more), encoding="utf-8")
    linked = [*map(str, objects), "-lm", "-o", str(program)]
    compile_source([*_common(unit), "-std=c99", str(source), *linked], source.name)
    ran = subprocess.run([str(program), str(calls), str(seed)], capture_output=True, text=True, check=False)
    if ran.returncode or ran.stderr:
        raise UserError(f"{name}, seed {seed}: {ran.stdout}{ran.stderr}")
    return ran.stdout.strip()


def _common(unit: Path) -> list[str]:
    return [compiler.found() or "cc", *SANITIZED, "-I", str(unit)]


def _loop(rig_name: str, policy: str, calls: int) -> str:
    """What was found of one loop: "" for nothing."""
    rig, model = load(rig_name), load_model(shipped(rig_name, "model"))
    with TemporaryDirectory() as scratch:
        unit = Path(scratch) / "unit"
        try:
            settings = {"real_time": True, "policy": policy}
            done = export_loop(rig, model, unit, settings=settings, seal="", periods=FEW, more=0)
            objects = sanitized_objects(unit, done.name, Path(scratch))
            loop = loop_in_python(rig, model, settings)
            for seed in SEEDS:
                fuzzed(unit, done.name, loop, objects, calls=-(-calls // len(SEEDS)), seed=seed)
        except UserError as error:
            return str(error)
    return ""


def main(arguments: list[str]) -> int:
    """Run, print the table, write the results."""
    calls = int(arguments.pop(0)) if arguments and arguments[0].isdecimal() else CALLS
    machine, found, rigs = result.machine(), dict[str, str](), arguments or RIGS
    shown = Table("loop", "found", title=f"{calls} calls of each loop that no rig would ask, {len(SEEDS)} seeds")
    loops = [(rig_name, policy) for rig_name in rigs for policy in ("exact", "supervised")]
    for rig_name, policy in loops:
        found[f"{rig_name}, {policy}"] = said = _loop(rig_name, policy, calls)
        shown.add_row(f"{rig_name}, {policy}", said or "nothing")
        print(f"{rig_name}, {policy}: {said or 'nothing found'}", flush=True)
        short = 2 * len(RIGS) - sum(not said for said in found.values())  # those that were not asked, too
        content = {"found": found, "calls": calls, "asked_calls": CALLS, "short": short}
        result.write(NAME, content, on=machine)  # after each loop, for all of them take hours
    print_table(shown)
    return 0


if __name__ == "__main__":
    result.run(lambda: main(sys.argv[1:]))

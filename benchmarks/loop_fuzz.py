"""Exported loops asked what no rig would ask, under the sanitizers of the compiler.

    python -m benchmarks.loop_fuzz [CALLS] [RIG...]

Of each rig's shipped model: estimator with the exact MPC in real time, and with the supervised policy. Readings,
applied inputs, references and times are of any size, missing, infinite or no number: in a fifth of the stretches
always, in two fifths now and then, and in the rest never, since a loop that is at rest has little to go wrong. Each
call must leave the inputs numbers within their bounds, the sanitizers of addresses and of undefined behaviour must find
nothing, and a third of the calls must have been answered by the MPC or the policy.

Loops of other rigs keep what was found of them as long as the same unit is printed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks import result
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.compiler import compile_source
from hybrid_sysid_ros.extensions.export.unit.built import renamed
from hybrid_sysid_ros.extensions.export.unit.folder import UnitExport, export_loop
from hybrid_sysid_ros.extensions.export.unit.python_loop import PythonLoop, loop_in_python
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import sha256

NAME = "loop_fuzz"
RIGS = ("cam_beam", "flexible_joint", "wheel_motor", "winged_cone", "drill_string", "balancing_robot")
CALLS = 1_000_000
"""Of each loop, over SEEDS."""
SEEDS = (0, 1, 2)
ANSWERED = 1 / 3
"""Least share of the calls that the MPC or the policy has answered."""
FAR = 1000.0
"""References of outputs without a limit reach so many deviations of their noise."""
FEW = 100
"""Periods that a unit is compared in before it is asked; an export on its own replays more."""
NOT_ASKED = {"calls": 0, "answered": 0, "of_policy": 0, "found": "not asked since the unit changed"}
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


def fuzzed(unit: Path, name: str, loop: PythonLoop, objects: list[Path], *, calls: int, seed: int) -> Counter[str]:
    """How many calls there were, were answered, and by the policy. loop: the same in Python, whose inputs have limits.

    Raises UserError with what the program said where an input was out of bounds or a sanitizer spoke.
    """
    noise = np.array(loop.estimator.tuning.measurement_noise)
    lowest, highest = np.clip(loop.reach, -FAR * noise, FAR * noise)
    low, high = loop.limits
    listed = {"low": low, "high": high, "lowest": lowest, "highest": highest, "noise": noise}
    more = {what: ", ".join(map(repr, values.tolist())) for what, values in listed.items()}
    source, program = objects[0].parent / "fuzz.c", objects[0].parent / "fuzz"
    text = Text(SOURCE.read_text(encoding="utf-8"))
    more |= {"period": repr(loop.estimator.period), "about": ""}
    source.write_text(text.substitute(name=name, NAME=name.upper(), **more), encoding="utf-8")
    linked = [*map(str, objects), "-lm", "-o", str(program)]
    compile_source([*_common(unit), "-std=c99", str(source), *linked], source.name)
    ran = subprocess.run([str(program), str(calls), str(seed)], capture_output=True, text=True, check=False)
    if ran.returncode or ran.stderr:
        raise UserError(f"{name}, seed {seed}: {ran.stdout}{ran.stderr}")
    return Counter(dict(zip(("calls", "answered", "of_policy"), map(int, ran.stdout.split()), strict=True)))


def _common(unit: Path) -> list[str]:
    return [compiler.found() or "cc", *SANITIZED, "-I", str(unit)]


def _printed(rig_name: str, policy: str, unit: Path) -> tuple[UnitExport, PythonLoop]:
    """A loop's unit in a folder, and the same in Python."""
    rig, model = load(rig_name), load_model(shipped(rig_name, "model"))
    settings = {"real_time": True, "policy": policy}
    done = export_loop(rig, model, unit, settings=settings, seal="", periods=FEW, more=0)
    return done, loop_in_python(rig, model, settings)


def _asked(unit: Path, done: UnitExport, loop: PythonLoop, calls: int) -> dict[str, Any]:
    """The row of a unit: what was counted, and what was found ("" for nothing)."""
    counted, found = Counter[str](calls=0, answered=0, of_policy=0), ""
    try:
        objects = sanitized_objects(unit, done.name, unit.parent)
        for seed in SEEDS:
            counted.update(fuzzed(unit, done.name, loop, objects, calls=-(-calls // len(SEEDS)), seed=seed))
    except UserError as error:
        found = str(error)
    if not found and counted["answered"] < ANSWERED * counted["calls"]:
        found = f"{counted['answered']} answered calls say too little"
    return {**counted, "found": found}


def _before() -> dict[str, Any]:
    """Rows of the results that are there."""
    path = result.RESULTS / f"{NAME}.json"
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["results"]["loops"] if path.is_file() else {}
    return found


def main(arguments: list[str]) -> int:
    """Run, print the table, write the results after each loop, for all of them take hours."""
    calls = int(arguments.pop(0)) if arguments and arguments[0].isdecimal() else CALLS
    machine, asked, before, rows = result.machine(), arguments or RIGS, _before(), dict[str, dict[str, Any]]()
    loops = [(rig_name, policy) for rig_name in RIGS for policy in ("exact", "supervised")]
    for rig_name, policy in sorted(loops, key=lambda loop: loop[0] in asked):
        name = f"{rig_name}, {policy}"
        with TemporaryDirectory() as scratch:
            unit = Path(scratch) / "unit"
            done, loop = _printed(rig_name, policy, unit)
            digest = "".join(sha256(unit / f"{done.name}.{ending}")[:8] for ending in "ch")
            if rig_name in asked:
                rows[name] = {"unit": digest, **_asked(unit, done, loop, calls)}
            elif before.get(name, {}).get("unit") == digest:
                rows[name] = before[name]
            else:
                rows[name] = {"unit": digest, **NOT_ASKED}
        row = rows[name]
        print(
            f"{name}: {row['calls']} calls, {row['answered']} answered, {row['of_policy']} by the policy: "
            f"{row['found'] or 'nothing found'}",
            flush=True,
        )
        short = len(loops) - sum(not row["found"] and row["calls"] >= CALLS for row in rows.values())
        content = {"loops": rows, "seeds": len(SEEDS), "asked_calls": CALLS, "short": short}
        result.write(NAME, content, on=machine)
    return 0


if __name__ == "__main__":
    result.run(lambda: main(sys.argv[1:]))

"""The beam's loop in C beside acados' generated solver: instructions of a period, bytes.

    python -m benchmarks.generated

Both are asked the same: the states and references of a recorded loop at its rate. In a period each takes one real-time
iteration, its preparation included; ours estimates the state, too. Valgrind counts the instructions, so that the
machine's load does not matter. Compiled as each says: ours by -O2, acados as in acados_peer. lmpc needs Julia, and
is left out.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import acados_peer, result
from benchmarks.bodies import size_of
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.unit.built import FLAGS, build
from hybrid_sysid_ros.extensions.export.unit.folder import export_loop
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.extensions.export.unit.replay import recorded
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import defaults, mpc_problem, shipped
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NAME, RIG, PERIODS = "generated", "cam_beam", 1000
KNOWN = acados_peer.FLAGS.replace("native", "haswell")
"""Flags of acados' generated code, for a processor whose instructions valgrind knows."""
TOTAL = re.compile(r"^totals: (\d+)", re.MULTILINE)


def instructions(program: list[str], counted: tuple[str, ...], ends: str, place: Path, given: str = "") -> Array:
    """Instructions (periods,) of a program in functions of these names; a period ends with the return of ``ends``."""
    options = [f"--toggle-collect={name}" for name in counted]
    command = [
        "valgrind",
        "--tool=callgrind",
        *options,
        f"--dump-after={ends}",
        f"--callgrind-out-file={place}/counted",
    ]
    done = subprocess.run([*command, *program], input=given, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UserError(f"{program[0]}: does not run under valgrind: {done.stderr.strip().splitlines()[-1]}")
    parts = sorted(place.glob("counted.*"), key=lambda path: int(path.suffix[1:]))
    found = [TOTAL.search(path.read_text(encoding="utf-8")) for path in parts]
    return np.array([float(one[1]) for one in found if one is not None])


def own(by: str, place: Path) -> dict[str, Any]:
    """Of the exported loop. place: an empty folder."""
    rig, model, folder = load(RIG), load_model(shipped(RIG, "model")), place / "unit"
    done = export_loop(rig, model, folder, settings={"real_time": True}, seal="", periods=PERIODS, shown=PERIODS)
    into, test = place / "built", str(place / "test")
    into.mkdir()
    build(by, folder, done.name, into, flags=("-g",))
    objects = sorted(into.glob("*.o"))
    source = folder / f"{done.name}_test.c"
    includes = ["-I", str(folder)]
    subprocess.run([by, *FLAGS, "-g", *includes, *map(str, (source, *objects)), "-o", test, "-lm"], check=True)
    counts = instructions([test], (f"{done.name}_step", f"{done.name}_prepare"), f"{done.name}_prepare", place)
    return _row(counts, code=size_of(objects), libraries=0, memory=done.bytes)


def peer(by: str, place: Path) -> dict[str, Any]:
    """Of acados' solver with the same states and references. Its period is its two phases, each one call."""
    rig, model = load(RIG), load_model(shipped(RIG, "model"))
    problem = mpc_problem(defaults(rig, "controller"), rig)
    solver = acados_peer.AcadosMpc(model.system, problem, real_time=True, flags=KNOWN)
    code = Path(solver.solver.ocp.code_gen_options.code_export_directory)
    name = next(code.glob("acados_solver_*.h")).stem.removeprefix("acados_solver_")
    questions, answers = recorded(rig, loop_in_python(rig, model, {"real_time": True}), PERIODS)
    numbers = [
        [*question.preview[:, 0], *answer.ahead, *question.applied]
        for question, answer in zip(questions, answers, strict=True)
    ]
    values = {"name": name, "states": len(answers[0].ahead) + 1, "horizon": problem.horizon}
    source = place / "generated.c"
    source.write_text(Text(Path(__file__).with_suffix(".c").read_text(encoding="utf-8")).substitute(values))
    home = Path(os.environ["ACADOS_SOURCE_DIR"])
    includes = [f"-I{home / 'include' / part}" for part in ("", "blasfeo/include", "hpipm/include", "acados")]
    libraries = [home / "lib" / f"lib{part}.so" for part in ("acados", "hpipm", "blasfeo", "daqp")]
    generated = next(code.glob("libacados_ocp_solver_*.so"))
    at = [f"-Wl,-rpath,{code}", f"-Wl,-rpath,{home / 'lib'}"]
    linked = [str(generated), *map(str, libraries), *at, "-lm"]
    program = str(place / "generated")
    subprocess.run([by, "-O0", "-g", f"-I{code}", *includes, str(source), "-o", program, *linked], check=True)
    given = f"{PERIODS}\n" + "\n".join(" ".join(map(repr, map(float, row))) for row in numbers)
    plain = subprocess.run([program], input=given, capture_output=True, text=True, check=True)
    found = np.array(plain.stdout.split(), dtype=float)
    apart = np.abs(found - [answer.inputs[0] for answer in answers])
    counts = instructions([program], ("period",), "period", place, given)
    counts = counts[: 2 * PERIODS].reshape(-1, 2).sum(axis=1)
    row = _row(counts, code=size_of([generated]), libraries=size_of(libraries), memory=int(plain.stderr))
    return row | {"apart_p50": float(np.median(apart)), "apart_most": float(apart.max())}


def _row(counts: Array, **sizes: float) -> dict[str, Any]:
    later = counts[1:]  # the first period begins from nothing
    return {
        "first": int(counts[0]), "median": float(np.median(later)), "percentile": float(np.percentile(later, 99)),
        "most": int(later.max()), **sizes,
    }  # fmt: skip


def main() -> int:
    """Run, print the table, write the results."""
    by, machine = compiler.found(), result.machine()
    missing = [tool for tool in ("valgrind", "size") if shutil.which(tool) is None]
    if by is None or missing:
        raise UserError(
            f"generated: {', '.join(missing) or 'a C compiler'} is not installed (apt install valgrind gcc)"
        )
    shown = Table(
        "", "first", "median", "99 %", "most", "own code [kB]", "libraries [kB]", "memory [kB]",
        title="Thousand instructions of a period of the beam's loop",
    )  # fmt: skip
    found = dict[str, Any]()
    for what, measure in (("this loop", own), ("acados", peer))[: 1 + acados_peer.installed()]:
        with TemporaryDirectory() as scratch:
            found[what] = row = measure(by, Path(scratch))
        shown.add_row(
            what, *(f"{row[key] / 1e3:.0f}" for key in ("first", "median", "percentile", "most")),
            *(f"{row[key] / 1e3:.1f}" for key in ("code", "libraries", "memory")),
        )  # fmt: skip
    print_table(shown)
    print(result.write(NAME, found, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)

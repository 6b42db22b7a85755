"""Bodies of the same loop: what the C unit of each rig answers beside Python, how large it is, how long a step takes.

Of each rig's shipped model, estimator and exact MPC in real time, and of the beam with its policy, a loop of PERIODS is
recorded in Python and replayed in C. Differences and sizes don't depend on the machine's load; times do.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.board.folder import BOARDS, export_board, missing_tools
from hybrid_sysid_ros.extensions.export.compiler import compile_source
from hybrid_sysid_ros.extensions.export.unit.built import FLAGS, build
from hybrid_sysid_ros.extensions.export.unit.folder import export_loop
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError

NAME = "bodies"
RIGS = ("cam_beam", "drill_string", "flexible_joint", "wheel_motor", "winged_cone", "balancing_robot")
PERIODS = 1000
ASKED = {"difference": 1e-9, "step_p99": 60e-6, "image": 300_000, "export": 30.0}
"""Largest difference, and for the beam the p99 of a step [s], bytes of its image and the time of its export [s]."""
ASKED_OF_BOARDS: dict[str, dict[str, float]] = {
    "m7": {"difference": 1e-9, "most": 350_000, "flash": 300_000},
    "m4": {"most": 500_000},
}
"""Of the supervised beam: largest difference, instructions of a period behind the first, bytes of flash."""
ASKED_SHARE = 1e-4
"""Largest difference of floats, of all loops, as a share of the input's range."""
BEAM = "cam_beam, supervised"
CLOCK = Path(__file__).with_suffix(".h")


def body(rig_name: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Differences, sizes and times of one loop in C. Raises UserError where it can't be exported."""
    rig, model = load(rig_name), load_model(shipped(rig_name, "model"))
    by = compiler.found()
    assert by is not None
    with TemporaryDirectory() as scratch:
        folder, into = Path(scratch) / "unit", Path(scratch) / "built"
        into.mkdir()
        began = perf_counter()
        done = export_loop(rig, model, folder, settings=settings, seal="", periods=PERIODS, shown=PERIODS)
        took = perf_counter() - began
        build(by, folder, done.name, into)
        median, percentile = step_times(by, folder, done.name, into)
        sections = size_of([*into.glob("*.o")])
    return {
        "difference": max(done.differences["recorded"].values()),
        "odd": max(done.differences["odd"].values()),
        "memory": done.bytes,
        "stack": done.stack,
        "image": sections,
        "export": took,
        "step_p50": median,
        "step_p99": percentile,
    }


def step_times(by: str, folder: Path, name: str, built: Path) -> tuple[float, float]:
    """Median and p99 [s] of a step with the preparation of the next one, behind the first: the unit's own test counts
    them in C, where Python's conversions of arguments take no part.
    """
    program = str(built / "test")
    counted = ["-include", str(CLOCK), f"-D{name.upper()}_COUNT=nanoseconds", "-I", str(folder)]
    sources = [str(folder / f"{name}_test.c"), *map(str, built.glob("*.o"))]
    compile_source([by, *FLAGS, *counted, *sources, "-o", program, "-lm"], f"{name}_test.c")
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    found = re.search(r"median (\d+), 99 % (\d+)", said)
    assert found is not None, said
    return 1e-9 * int(found[1]), 1e-9 * int(found[2])


def on_boards(rig_name: str, settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What the emulator finds of one loop on each board, by its name; "refused" where it can't be exported."""
    rig, model, found = load(rig_name), load_model(shipped(rig_name, "model")), dict[str, dict[str, Any]]()
    narrowest = float(np.min(np.ptp(rig.limits, axis=0)))
    for board in BOARDS:
        with TemporaryDirectory() as scratch:
            try:
                _, run = export_board(rig, model, Path(scratch) / "board", board=board, settings=settings, seal="")
            except UserError as error:
                found[board] = {"refused": str(error)}
                continue
        found[board] = {"refused": "no emulator"}
        if run is not None:
            found[board] = asdict(run) | {"share": run.difference / narrowest}
    return found


def _boards_table(found: dict[str, Any]) -> Table:
    shown = Table(
        "loop", "board", "difference", "of the range", "first", "median", "99 %", "most", "flash [kB]", "memory [kB]",
        title="Loops on boards, in the emulator: thousand instructions of a period",
    )  # fmt: skip
    for name, row in found.items():
        for board, run in row.get("boards", {}).items():
            if "refused" in run:
                shown.add_row(name, board, run["refused"])
                continue
            counts = (f"{run[key] / 1e3:.0f}" for key in ("first", "median", "percentile", "most"))
            sizes = (f"{run[key] / 1e3:.0f}" for key in ("flash", "ram"))
            shown.add_row(name, board, *(f"{run[key]:.1e}" for key in ("difference", "share")), *counts, *sizes)
    return shown


def size_of(objects: list[Path]) -> float:
    """Bytes of code and constants of object files; NaN where size is not installed."""
    if shutil.which("size") is None:
        return math.nan
    lines = subprocess.run(["size", *map(str, objects)], capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in lines.splitlines()[1:]]
    return float(sum(int(row[0]) + int(row[1]) for row in rows))


def main() -> int:
    """Run, print the table, write the results."""
    machine, found = result.machine(), dict[str, Any]()
    cases: dict[str, tuple[str, dict[str, Any]]] = {name: (name, {"real_time": True}) for name in RIGS}
    cases[BEAM] = "cam_beam", {"real_time": True, "policy": "supervised"}
    shown = Table(
        "loop", "difference", "odd", "memory [kB]", "stack [kB]", "image [kB]", "step p50, p99 [us]", "export [s]",
        title=f"Loops in C: {PERIODS} recorded periods beside Python",
    )  # fmt: skip
    for name, (rig, settings) in cases.items():
        try:
            found[name] = row = body(rig, settings)
            row["boards"] = {} if missing_tools() else on_boards(rig, settings)
        except UserError as error:
            found[name] = {"refused": str(error)}
            print(f"{name}: {error}")
            continue
        shown.add_row(
            name,
            *(f"{row[key]:.1e}" for key in ("difference", "odd")),
            *(f"{row[key] / 1e3:.1f}" if row[key] is not None else "-" for key in ("memory", "stack", "image")),
            f"{1e6 * row['step_p50']:.0f}, {1e6 * row['step_p99']:.0f}",
            f"{row['export']:.1f}",
        )
    print_table(shown)
    print_table(_boards_table(found))
    short = [name for name, row in found.items() if not row.get("difference", math.inf) <= ASKED["difference"]]
    beam = found[BEAM]
    short += [key for key in ("step_p99", "image", "export") if not beam.get(key, math.inf) <= ASKED[key]]
    for board, asked in ASKED_OF_BOARDS.items():
        run = beam.get("boards", {}).get(board, {})
        short += [f"{board}_{key}" for key, most in asked.items() if not run.get(key, math.inf) <= most]
    floats = {name: row.get("boards", {}).get("m4", {}) for name, row in found.items()}
    short += [f"{name} m4_share" for name, run in floats.items() if not run.get("share", math.inf) <= ASKED_SHARE]
    asked_of_all = {**ASKED, **ASKED_OF_BOARDS, "m4_share": ASKED_SHARE}
    print(f"short: {', '.join(short) or 'none'}")
    print(result.write(NAME, {"loops": found, "asked": asked_of_all, "short": len(short)}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)

"""The folder of a loop on a microcontroller: its C unit, what starts it, and what its emulator answers."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.unit import stack_use
from hybrid_sysid_ros.extensions.export.unit.folder import MANIFEST as UNIT_MANIFEST
from hybrid_sysid_ros.extensions.export.unit.folder import RECORDED, UnitExport, export_loop
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError, known
from hybrid_sysid_ros.support.files import check_folder, written_folder

TEMPLATES = Path(__file__).parent / "c"
MANIFEST = "board.json"
PROTOCOL = 1
"""Of the frames: a number that both ends must have."""
SEAL = 64
"""Characters of a model's seal at most."""


@dataclass(frozen=True, kw_only=True)
class BoardFamily:
    """A family of microcontrollers, and the machine of QEMU that has its processor."""

    core: str
    machine: str
    flags: str
    single: bool
    """Whether it has floats alone."""


BOARDS = {
    "m7": BoardFamily(core="M7", machine="mps2-an500", flags="-mcpu=cortex-m7 -mfpu=fpv5-d16", single=False),
    "m4": BoardFamily(core="M4F", machine="mps2-an386", flags="-mcpu=cortex-m4 -mfpu=fpv4-sp-d16", single=True),
}
TOOLS = {
    "arm-none-eabi-gcc": "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "make": "apt install make",
    "qemu-system-arm": "apt install qemu-system-arm",
}
"""What builds and runs a folder, and how it comes."""
TETHERED = """exec 3<&0
(read -r gone <&3; kill -KILL 0) >/dev/null 2>&1 &
exec make --silent "$1" </dev/null 3<&-"""
"""A shell's: kill all processes of the session, the emulator too, when the standard input ends."""


@dataclass(frozen=True, kw_only=True)
class BoardRun:
    """What the emulator found. Instructions are of a period: estimate, command and preparation of the next one."""

    difference: float
    """Largest one of the first inputs from Python's, over the recorded periods."""
    wrong: int
    """Periods beyond the tolerance."""
    first: int
    """Of the first period, which begins from nothing."""
    median: int
    """Of the others, as the next two."""
    percentile: int
    """Below it are 99 of 100."""
    most: int
    flash: int
    """Bytes of the image: code and constants."""
    ram: int
    """Bytes, without the stack."""
    stack: int
    """Bytes of the stack at most, without those of the C library."""


def missing_tools() -> dict[str, str]:
    """The tools that are not installed, and how they come."""
    return {name: advice for name, advice in TOOLS.items() if shutil.which(name) is None}


def export_board(
    rig: Rig,
    model: Model,
    out: Path | str,
    *,
    board: str,
    settings: Mapping[str, Any],
    seal: str,
    policy_seal: str = "",
    source: Path | None = None,
    overwrite: bool = False,
) -> tuple[UnitExport, BoardRun | None]:
    """Write a loop for a board, and replay it in the emulator; None where that is not installed. Arguments: as of
    :func:`~hybrid_sysid_ros.extensions.export.unit.folder.export_loop`.

    Raises UserError for an unknown board, for what can't be printed, and where the board answers otherwise than Python.
    """
    if board not in BOARDS:
        raise UserError(f"export: no board {board}: {known(board, BOARDS)}")
    chosen = BOARDS[board]
    check_folder(out, marker=MANIFEST, replace=overwrite)
    with written_folder(out, marker=MANIFEST) as folder:
        folder.mkdir(exist_ok=True)
        done = export_loop(
            rig, model, folder / "unit", settings=settings, seal=seal, policy_seal=policy_seal, source=source,
            single=chosen.single, shown=RECORDED,
        )  # fmt: skip
        write_sources(folder, done, chosen)
        found = None if missing_tools() else run(folder, done)
        if found is not None and found.wrong:
            raise UserError(
                f"export: {found.wrong} of {RECORDED} periods on the {chosen.core} differ from Python's, by "
                f"{found.difference:.3g}; nothing is written: report this"
            )
        shutil.rmtree(folder / "build", ignore_errors=True)
        content = {"board": board, "name": done.name, "emulated": None if found is None else asdict(found)}
        (folder / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return done, found


def write_sources(folder: Path, done: UnitExport, board: BoardFamily) -> None:
    """Write what starts a unit on a board, and its Makefile."""
    about = json.loads((folder / "unit" / UNIT_MANIFEST).read_text(encoding="utf-8"))
    sizes, real = done.sizes, 4 if board.single else 8
    n, m, p = sizes["states"], sizes["inputs"], sizes["outputs"]
    question, request = 8 + real * (p + m), real * (m + p * sizes["horizon"])
    values = {
        "name": done.name,
        "NAME": done.name.upper(),
        "about": "\n".join(f" * {key}: {about[key]}" for key in ("made_by", "rig", "model")),
        "core": board.core,
        "machine": board.machine,
        "target": f"-mthumb {board.flags} -mfloat-abi=hard",
        "definitions": " -DDAQP_SINGLE_PRECISION" if board.single else "",
        "periods": done.periods["recorded"],
        "measurement": question,
        "request": request,
        "longest": 3 + max(question, request, 5 + real * (2 * n + m), 6 + SEAL),
        "version": PROTOCOL,
        "room": 2 * (done.stack or 8192),
    }
    for path in sorted(TEMPLATES.iterdir()):
        text = Text(path.read_text(encoding="utf-8")).substitute(values)
        (folder / path.name).write_text(text, encoding="utf-8")


def run(folder: Path, done: UnitExport) -> BoardRun:
    """Build the folder of a unit and replay its periods in the emulator. Raises UserError where a tool fails."""
    text = make(folder, "run")
    sections = make(folder, "size").splitlines()[-1].split()
    answers = re.search(r"(\d+) of \d+ periods wrong, largest difference (\S+),", text)
    counted = re.search(r"first (\d+), then median (\d+), 99 % (\d+), most (\d+)", text)
    if answers is None or counted is None:
        raise UserError(f"{folder}: the emulator says {text.strip()[-200:]!r}")
    calls = [f"{done.name}_{call}" for call in ("observe", "decide", "prepare", "reset", "forget_plan")]
    first, median, percentile, most = map(int, counted.groups())
    return BoardRun(
        wrong=int(answers[1]), difference=float(answers[2]), first=first, median=median, percentile=percentile,
        most=most,
        stack=stack_use.most_bytes(folder / "build", calls, constraints=done.active),
        flash=int(sections[0]) + int(sections[1]), ram=int(sections[1]) + int(sections[2]),
    )  # fmt: skip


def make(folder: Path, goal: str) -> str:
    """What the Makefile of a folder says of a goal. Raises UserError where it fails."""
    try:
        with tethered_make(folder, goal, stderr=subprocess.PIPE) as process:
            said, complaints = process.communicate(timeout=compiler.TIME_LIMIT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UserError(f"{folder}: make {goal} can't be run: {error}") from error
    if process.returncode and " periods wrong" not in said:
        lines = complaints.splitlines()
        found = [line for line in lines if "error" in line.lower()] or lines[-1:] or ["it says nothing"]
        raise UserError(f"{folder}: make {goal} fails: {found[0].strip()}")
    return said


@contextmanager
def tethered_make(folder: Path, goal: str, *, stderr: int) -> Iterator[subprocess.Popen[str]]:
    """A run of make whose processes end with the context, and with this process, in whichever way that ends."""
    watched, held = os.pipe()
    try:
        with open(watched) as read:
            process = subprocess.Popen(
                ["sh", "-c", TETHERED, "sh", goal], cwd=folder, text=True, start_new_session=True, stdin=read,
                stdout=subprocess.PIPE, stderr=stderr,
            )  # fmt: skip
        with process:
            try:
                yield process
            finally:
                os.close(held)
                held = -1
    finally:
        if held >= 0:
            os.close(held)

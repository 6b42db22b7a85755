"""The C compiler of the machine, if there is one."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-pedantic", "-Wall", "-Wextra")
TIME_LIMIT = 120.0
"""Of compiling and of running, each [s]."""

LARGEST = re.compile(r"largest difference (\S+),")


def found() -> str | None:
    """The first of the usual compilers that is on the path."""
    return next((name for name in COMPILERS if shutil.which(name)), None)


def is_gcc(compiler: str) -> bool:
    """Whether a compiler is gcc, by whatever name."""
    found = _run([compiler, "-dM", "-E", "-x", "c", "/dev/null"]).stdout
    return "__GNUC__" in found and "__clang__" not in found


def run_test(compiler: str, folder: Path, name: str, scratch: Path) -> float:
    """Compile NAME.c with NAME_test.c and run it; the largest difference that it tells [unit of the input].

    scratch: a folder for the executable. Raises UserError where the compiler refuses, or the test fails.
    """
    executable = scratch / "policy_test"
    files = [str(folder / f"{name}.c"), str(folder / f"{name}_test.c")]
    built = _run([compiler, *FLAGS, *files, "-o", str(executable), "-lm"])
    if built.returncode:
        raise UserError(f"{name}.c: {compiler} does not compile it: {_last_line(built.stderr)}")
    tested = _run([str(executable)])
    found = LARGEST.search(tested.stdout)
    if tested.returncode or found is None:
        raise UserError(
            f"{name}.c: does not answer as the policy does: {_last_line(tested.stdout)}; nothing is written"
        )
    return float(found[1])


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UserError(f"{command[0]}: can't be run ({error}); export with --format onnx, or repair it") from error


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it says nothing"

"""The C compiler of the machine, if there is one."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

COMPILERS = ("cc", "gcc", "clang")
CHOICE = "CC"
"""Environment variable that names another one, as make has it."""
FLAGS = ("-std=c99", "-O2", "-pedantic", "-Wall", "-Wextra")
TIME_LIMIT = 900.0
"""Of compiling, and of running what was compiled [s]; the first time ziglang compiles its C library, too."""

LARGEST = re.compile(r"largest difference (\S+),")


def found() -> str | None:
    """The compiler that CC names, else the first of the usual ones that is on the path.

    Raises UserError where CC names no program.
    """
    if chosen := os.environ.get(CHOICE):
        if shutil.which(chosen) is None:
            raise UserError(
                f"{CHOICE}={chosen}: there is no such program; give the name or path of a C compiler, without flags"
            )
        return chosen
    return next((name for name in COMPILERS if shutil.which(name)), None)


def is_gcc(compiler: str) -> bool:
    """Whether a compiler is gcc, by whatever name."""
    found = run([compiler, "-dM", "-E", "-x", "c", "/dev/null"]).stdout
    return "__GNUC__" in found and "__clang__" not in found


def run_test(compiler: str, folder: Path, name: str, scratch: Path) -> float:
    """Compile NAME.c with NAME_test.c and run it; the largest difference that it tells [unit of the input].

    scratch: a folder for the executable. Raises UserError where the compiler refuses, or the test fails.
    """
    executable = scratch / "policy_test"
    files = [str(folder / f"{name}.c"), str(folder / f"{name}_test.c")]
    built = run([compiler, *FLAGS, *files, "-o", str(executable), "-lm"])
    if built.returncode:
        raise UserError(f"{name}.c: {compiler} does not compile it: {_last_line(built.stderr)}")
    tested = run([str(executable)])
    found = LARGEST.search(tested.stdout)
    if tested.returncode or found is None:
        raise UserError(
            f"{name}.c: does not answer as the policy does: {_last_line(tested.stdout)}; nothing is written"
        )
    return float(found[1])


def run(command: list[str], what: str = "export", folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder. what: beginning of the error. Raises UserError where it can't be run."""
    try:
        return subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=TIME_LIMIT, stdin=subprocess.DEVNULL,
            check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        late = f"is not ready after {TIME_LIMIT:g} s: is the machine busy?"
        raise UserError(f"{what}: {Path(command[0]).name} {late}") from error
    except OSError as error:
        raise UserError(f"{what}: {Path(command[0]).name} can't be run: {error}") from error


def compile_source(command: list[str], what: str, folder: Path | None = None, by: str = "") -> None:
    """Run a compiler, by its name or as ``by``. Raises UserError with its first error where it refuses."""
    done = run(command, what, folder)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line] or ["it says nothing"]
        raise UserError(
            f"{what}: {by or command[0]} does not compile it: {lines[0].strip()}; give "
            "another compiler (CC), or report this"
        )


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it says nothing"

"""WebAssembly: C files compiled by the wheel ziglang, which is clang with a C library for it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from hybrid_sysid_ros.support.errors import UserError

FLAGS = (
    "-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c99", "-O2", "-w",
    "-Wl,--gc-sections", "-Wl,--strip-all", "-Wl,-z,stack-size=262144",
)  # fmt: skip
TIME_LIMIT = 900.0
"""Of compiling [s]; the first time the C library is compiled, too."""


def check_compiler() -> None:
    """Raise UserError where the wheel is missing."""
    if find_spec("ziglang") is None:
        raise UserError(
            "export: WebAssembly is compiled by the wheel ziglang, which is missing: "
            "pip install 'hybrid_sysid_ros[page]'"
        )


def library_licence() -> str:
    """The notice of musl, whose mathematics is in each module, "" where the wheel has none."""
    found = find_spec("ziglang")
    path = Path(str(found and found.origin)).parent / "lib" / "libc" / "musl" / "COPYRIGHT"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def module_of(files: Mapping[str, str], sources: Sequence[str]) -> bytes:
    """A module of C files, given by their names with their texts. sources: those that are compiled.

    Raises UserError where the compiler refuses one.
    """
    check_compiler()
    with TemporaryDirectory() as scratch:
        root = Path(scratch)
        for name, text in files.items():
            (root / name).write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, *sources, "-o", "module.wasm"]
        try:
            done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=TIME_LIMIT, check=False)
        except subprocess.TimeoutExpired as error:
            raise UserError(f"export: ziglang is not ready after {TIME_LIMIT:g} s: is the machine busy?") from error
        except OSError as error:
            raise UserError(f"export: ziglang can't be run: {error}") from error
        if done.returncode:
            lines = [line for line in done.stderr.splitlines() if "error" in line] or ["it says nothing"]
            raise UserError(f"export: ziglang does not compile {sources[0]}: {lines[0].strip()}; report this")
        return (root / "module.wasm").read_bytes()

"""WebAssembly: C files compiled by the wheel ziglang, which is clang with a C library for it."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from hybrid_sysid_ros.extensions.export.compiler import compile_source
from hybrid_sysid_ros.support.errors import UserError

FLAGS = (
    "-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c99", "-O2", "-w",
    "-Wl,--gc-sections", "-Wl,--strip-all", "-Wl,-z,stack-size=262144",
)  # fmt: skip


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
            (root / name).parent.mkdir(exist_ok=True)
            (root / name).write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, *sources, "-o", "module.wasm"]
        compile_source(command, f"export: {sources[0]}", root, by="ziglang")
        return (root / "module.wasm").read_bytes()

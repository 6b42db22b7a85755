"""A process of its own for command lines and code, which finds packages beside this one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
Apart = Callable[..., "subprocess.CompletedProcess[str]"]
END = "--- end ---\n"
COMMANDS = f"""
import os, sys
from hybrid_sysid_ros.commands import app
for line in os.environ["LINES"].splitlines():
    sys.argv = ["hybrid-sysid", *line.split()]
    try:
        app.main()
    except SystemExit as end:
        if end.code:
            raise
    print({END.strip()!r}, flush=True)
"""
"""Command lines one after another, in one process that compiles and imports once."""


def apart_in(folder: Path) -> Apart:
    """A command line, or Python code, in a process that finds the packages in folder / "site"."""

    def called(*words: str | Path, code: str = "", lines: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join(map(str, (folder / "site", ROOT)))
        program = ["-c", code] if code else ["-m", "hybrid_sysid_ros"]
        return subprocess.run(
            [sys.executable, *program, *map(str, words)],
            capture_output=True, text=True, cwd=folder, timeout=600,
            env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200", "LINES": "\n".join(lines)},
        )  # fmt: skip

    return called

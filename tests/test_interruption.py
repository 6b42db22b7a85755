"""Ctrl-C is heard, also where Python would print and forget it."""

from __future__ import annotations

import subprocess
import sys

import pytest

FRAME = """
import os, signal, sys, time
from hybrid_sysid_ros import interruption

interruption.install()

def interrupt(*_):
    os.kill(os.getpid(), signal.SIGINT)
    done.add("whole")

done = set()
try:
    {work}
    time.sleep(5.0)
except KeyboardInterrupt:
    print(*done, "interrupted")
"""
COMPILE = """
    import numba
    from numba.core.codegen import CPUCodeLibrary
    CPUCodeLibrary._object_compiled_hook = staticmethod(interrupt)  # LLVM calls it once code is made
    numba.njit(lambda x: x + 1)(1)
"""
IMPORT = """
    open("slow.py", "w").write("import __main__; __main__.interrupt()")
    sys.path.append("")
    import slow
"""
DELETE = """
    class Fleeting:
        def __del__(self):
            interrupt()
    Fleeting()
"""
FORGET = """
    import weakref
    kept = type("Fleeting", (), {})()
    weakref.finalize(kept, interrupt)
    del kept
"""


@pytest.mark.parametrize("work", [COMPILE, IMPORT, DELETE, FORGET], ids=["compiler", "import", "del", "weakref"])
def test_an_interrupt_waits_until_it_is_heard(work: str, tmp_path) -> None:
    end = subprocess.run(
        [sys.executable, "-c", FRAME.replace("{work}", work.strip())],
        capture_output=True,
        text=True,
        timeout=60.0,
        cwd=tmp_path,
    )
    assert (end.stdout, end.stderr) == ("whole interrupted\n", "")


def test_an_interrupt_elsewhere_comes_at_once() -> None:
    work = "interrupt()"
    end = subprocess.run(
        [sys.executable, "-c", FRAME.replace("{work}", work)], capture_output=True, text=True, timeout=60.0
    )
    assert (end.stdout, end.stderr) == ("interrupted\n", "")

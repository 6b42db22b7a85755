"""Ctrl-C is heard, also where Python would print and forget it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

FRAME = """
import os, signal, sys, time
from hybrid_sysid_ros.support import interruption

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


CALLBACK = "import weakref; kept = type('Fleeting', (), {})(); seen = weakref.ref(kept, interrupt); del kept"


MANAGER = "os.kill(os.getpid(), signal.SIGTERM)"


@pytest.mark.parametrize(
    "work", ["interrupt()", CALLBACK, MANAGER], ids=["plain", "a reference's callback", "a manager's"]
)
def test_an_interrupt_elsewhere_comes_at_once_or_again_if_it_was_lost(work: str) -> None:
    end = subprocess.run(
        [sys.executable, "-c", FRAME.replace("{work}", work)], capture_output=True, text=True, timeout=60.0
    )
    assert (end.stdout, end.stderr) == ("interrupted\n", "")


PROGRAM = """
import os, signal, sys

class Interrupting:
    def find_spec(self, name, *_):
        if name == "numba":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
from hybrid_sysid_ros.__main__ import main
main()
"""


def test_a_program_that_is_interrupted_while_it_is_imported_says_so(tmp_path) -> None:
    bag = Path(__file__).parents[1] / "bags" / "beam_multisine"
    command = [sys.executable, "-c", PROGRAM, "identify", str(bag), "--out", str(tmp_path / "model")]
    end = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert (end.stdout, end.stderr) == ("", "interrupted\n")
    assert end.returncode in (130, -signal.SIGINT)  # a shell says 130 of both

"""The emulator's processes end with whoever started them."""

import os
import signal
import subprocess
import sys
import time

import pytest

from hybrid_sysid_ros.extensions.export.board.emulator import BoardEmulator
from hybrid_sysid_ros.extensions.export.board.folder import make
from hybrid_sysid_ros.support.errors import UserError

MAKEFILE = """
build/loop.elf:
serve:
\techo $$$$ > process; echo char device redirected to /dev/pts/99; sleep 1000; true
fails:
\techo no such board >&2; false
"""
STARTER = """
import os, signal, sys
from hybrid_sysid_ros.extensions.export.board.emulator import BoardEmulator
BoardEmulator(sys.argv[1]).start()
os.kill(os.getpid(), signal.SIGTERM)
"""


@pytest.fixture
def board(tmp_path):
    (tmp_path / "Makefile").write_text(MAKEFILE)
    return tmp_path


def is_gone(board) -> bool:
    """Whether the served process is, within seconds."""
    number, end = int((board / "process").read_text()), time.monotonic() + 20.0
    while time.monotonic() < end:
        try:
            os.kill(number, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.01)
    return False


def test_an_emulator_ends_with_a_killed_starter(board):
    done = subprocess.run([sys.executable, "-c", STARTER, str(board)], check=False)
    assert done.returncode == -signal.SIGTERM
    assert is_gone(board)


def test_an_emulator_ends_with_its_context_and_starts_again(board):
    with BoardEmulator(board) as emulator:
        emulator.stop()
        assert is_gone(board)
        emulator.start()
        assert emulator.port == "/dev/pts/99"
    assert is_gone(board)


def test_a_goal_that_fails_says_why(board):
    with pytest.raises(UserError, match=r"make fails fails: .*Error 1"):
        make(board, "fails")

"""Somebody who waits at a terminal is given the reason once; a process that writes to a file gets no line."""

import io
import sys

import pytest

from hybrid_sysid_ros.library import compiling


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("stream", "lines"), [(Terminal(), 1), (io.StringIO(), 0)])
def test_the_first_function_that_is_compiled_is_announced_at_a_terminal(monkeypatch, stream, lines):
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    listener = compiling.Announcement()
    for _ in range(2):  # by hand: whoever called hs.mpc before in this process has another listener at work
        listener.on_start(None)
    assert stream.getvalue().count("compiling once") == lines

"""Interruption: Ctrl-C that is never lost, and processes that don't outlive their starter."""

from __future__ import annotations

import signal
import sys
from types import FrameType

DEAF = frozenset({"importlib", "llvmlite", "weakref", "_weakrefset"})
"""Packages that are called back from where no exception gets out, and whose work had better be finished. An import is
among them since it calls back for its locks, and some libraries take an interrupt for a missing one.
"""
RETRY = 0.05  # s
TETHER = "HYBRID_SYSID_TETHER"
"""Set in the environment of a process that is to end when its standard input does: when its starter is gone."""


def ending() -> tuple[signal.Signals, ...]:
    """Signals that end a loop well, its inputs at rest: of Ctrl-C, of a manager, and of a terminal that closes, unless
    nohup has that one ignored.
    """
    hangup = () if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN else (signal.SIGHUP,)
    return (signal.SIGINT, signal.SIGTERM, *hangup)


def install() -> None:
    """From now on the signals of :func:`ending` raise KeyboardInterrupt where they are heard, see :func:`interrupt`, so
    that nothing half-written is left; but for SIGINT where it is ignored, as in the background of a script. For the
    main thread.
    """
    for number in ending():
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, interrupt)
    repeat_unheard()


def repeat_unheard() -> None:
    """Have an interrupt raised where Python can only print it, as in the callback of a weak reference, come again."""
    print_it = sys.unraisablehook

    def hook(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, RETRY)
        else:
            print_it(lost)

    sys.unraisablehook = hook
    signal.signal(signal.SIGALRM, interrupt)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, or have SIGALRM call again a little later where it would be lost: a signal handler."""
    later = is_deaf(frame)
    signal.setitimer(signal.ITIMER_REAL, RETRY if later else 0.0)
    if not later:
        raise KeyboardInterrupt


def is_deaf(frame: FrameType | None) -> bool:
    """Whether an exception in this frame may never reach those who wait for it."""
    while frame is not None:
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if package in DEAF or frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False

"""Keys: what is pressed in the terminal that a program runs in."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Thread

PATIENCE = 0.2  # s, after which it looks whether it is over


@contextmanager
def keys(actions: Mapping[bytes, Callable[[], None]]) -> Iterator[bool]:
    """For as long as the context lasts, do what belongs to the keys, by what the terminal sends for them, in a thread.

    Yields whether there is a terminal to press keys in, which gets its settings back.
    """
    if not sys.stdin or not sys.stdin.isatty():
        yield False
        return
    import termios
    import tty

    terminal, over = sys.stdin.fileno(), False
    before = termios.tcgetattr(terminal)

    def listen() -> None:
        while not over:
            if select.select([terminal], [], [], PATIENCE)[0]:
                action = actions.get(os.read(terminal, 8))
                if action is not None:
                    action()

    tty.setcbreak(terminal)
    listener = Thread(target=listen, daemon=True)
    listener.start()
    try:
        yield True
    finally:
        over = True
        listener.join()
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)

"""A bare sleeper: what this machine does to any process of that priority that wants the processor 200 times a second.

It sleeps from one absolute deadline to the next and notes how late it wakes, nothing else; or, where it is told to, how
late it was done with a piece of work, always the same, that it began when it woke. It ends when its standard input
does; then it writes what it noted to its standard output, as float64: the first deadline on the monotonic clock
[s], and each lateness [s].
"""

from __future__ import annotations

import gc
import os
import sys
from array import array
from threading import Thread
from time import monotonic, sleep


def main() -> int:
    """Sleep; arguments: rate [Hz], priority (0: as any other), the longest time [s], time that it works [s]."""
    rate, priority, longest, working = float(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4])
    late = array("d", bytes(8 * round(rate * longest)))  # there before it matters
    ended: list[bool] = []
    Thread(target=lambda: ended.append(not os.read(0, 1)), daemon=True).start()
    gc.freeze()
    gc.disable()
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    amount = round(working / _unit()) if working else 0
    first, count = monotonic() + 1.0 / rate, 0
    while not ended and count < len(late):
        deadline = first + count / rate
        sleep(max(deadline - monotonic(), 0.0))
        _work(amount)
        late[count] = monotonic() - deadline
        count += 1
    sys.stdout.buffer.write(array("d", [first]).tobytes() + late[:count].tobytes())
    return 0


def _work(amount: int) -> int:
    total = 0
    for number in range(amount):
        total += number * number
    return total


def _unit() -> float:
    """Time that one unit of work takes [s], as a rule."""
    times = []
    for _ in range(101):
        begin = monotonic()
        _work(10_000)
        times.append(monotonic() - begin)
    return sorted(times)[50] / 10_000


if __name__ == "__main__":
    sys.exit(main())

"""What the soak benchmark counts and what it calls growth."""

import math
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import linregress

from benchmarks.soak.__main__ import Sleeper
from benchmarks.soak.trend import excess, too_late, trend
from benchmarks.soak.watch import Watch, taken


def test_a_trend_is_the_line_of_least_squares_behind_the_settling():
    times = np.linspace(0.0, 1800.0, 181)
    values = 200.0 + np.random.default_rng(0).normal(0.0, 0.3, len(times)) + 1e-3 * times
    values[:10] = 100.0  # settles
    found = trend(times, values, allowed=1.0)
    line = linregress(times[18:] / 3600.0, values[18:])
    assert found["slope_per_hour"] == pytest.approx(line.slope)
    assert found["error_per_hour"] == pytest.approx(line.stderr)


def test_a_line_rises_from_third_to_third_by_two_thirds_of_all():
    times = np.arange(1000.0)
    found = trend(times, 3.0 * times, allowed=1.0)
    assert found["rose"] == pytest.approx(3.0 * 600.0)  # of the 900 that are left
    assert found["grows"]
    assert not trend(times, -3.0 * times, allowed=1.0)["grows"]


def test_noise_and_little_do_not_grow():
    times = np.arange(400.0)
    noise = np.random.default_rng(1).normal(size=len(times))
    assert not trend(times, noise, allowed=0.5)["grows"]
    assert not trend(times, 1e-3 * times, allowed=1.0)["grows"]  # a third of what is allowed


def test_too_few_samples_say_nothing():
    found = trend([0.0, 5.0], [1.0, 2.0], allowed=0.1)
    assert (found["slope_per_hour"], found["grows"]) == (None, False)


def test_a_stall_of_several_periods_is_as_many_wake_ups_too_late():
    """A stall of 12 ms at 200 Hz: the sleeper wakes for three deadlines at once, 12, 7 and 2 ms late."""
    assert too_late([1e-4, 12e-3, 7e-3, 2e-3, 1e-4], 3e-3) == 2


def test_a_worker_is_done_so_long_after_a_deadline_as_it_works():
    """2 ms of work in periods of 10: done after 2 ms at the earliest, but for what the processor's speed changes."""
    with Sleeper(100.0, 0, 1.0, working=2e-3) as worker:
        worker.process.wait()  # it ends by itself after its longest time
    assert len(worker.late) == 100
    assert 1e-3 < np.median(worker.late) < 20e-3


def test_the_chance_of_as_many_is_that_of_fair_coins():
    assert excess(8, 2) == pytest.approx(sum(math.comb(10, k) for k in (8, 9, 10)) / 2**10)
    assert excess(0, 5) == excess(0, 0) == 1.0


BLOCK = 32_000_000
"""Bytes that a process takes, and a file that it opens, after a line on its standard input."""
TAKER = f"""
print("begun", flush=True)
input()
block, file = b"x" * {BLOCK}, open("/dev/null")
print("done", flush=True)
input()
"""


def test_what_a_process_takes_is_what_the_kernel_says():
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", TAKER], stdin=pipe, stdout=pipe, bufsize=0) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        before = taken(process.pid)
        process.stdin.write(b"\n")
        process.stdout.readline()
        after = taken(process.pid)
        process.stdin.write(b"\n")
    assert after["memory_mb"] - before["memory_mb"] == pytest.approx(1e-6 * BLOCK, abs=1.0)
    assert after["files"] == before["files"] + 1
    assert after["page_faults"] > before["page_faults"]


def test_a_watch_samples_no_more_often_than_its_period():
    watch = Watch(period=3600.0)
    watch.look()
    first = watch.latest
    watch.look()
    assert len(watch.times) == 1
    assert watch.latest >= first

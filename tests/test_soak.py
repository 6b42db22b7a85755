"""What the soak benchmark counts and what it calls growth."""

import math
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import linregress

from benchmarks.soak.trend import excess, too_late, too_late_at_work, trend
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


def test_a_process_at_work_is_open_to_stalls_for_longer_than_a_sleeper():
    """Stalls of 3.5 to 12 ms at random, none two in one period; a turn of 1.8 ms in periods of 5, simulated."""
    random, period, working, count = np.random.default_rng(5), 5e-3, 1.8e-3, 400_000
    begins = period * (20.0 * np.arange(count // 20) + random.uniform(0.0, 15.0, count // 20))
    lengths = random.uniform(3.5e-3, 12e-3, count // 20)
    ticks = period * np.arange(count)
    stall = np.clip(np.searchsorted(begins, ticks, side="right") - 1, 0, None)
    late = np.clip(begins[stall] + lengths[stall] - ticks, 0.0, None) * (begins[stall] <= ticks)
    done = ticks + late + working
    following = np.clip(np.searchsorted(begins, ticks + late, side="right"), None, len(begins) - 1)
    hit = (begins[following] > ticks + late) & (begins[following] < done)
    missed = np.count_nonzero(done + hit * lengths[following] > ticks + period)
    expected = too_late_at_work(late, period - working, working)
    assert too_late(late, period - working) < 0.8 * missed
    assert expected == pytest.approx(missed, rel=0.02)


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

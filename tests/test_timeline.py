"""A timeline goes on steadily, whatever somebody does to the clock of its stamps."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.timing import DRIFT, SET, SLEW, Timeline

PERIOD = SECOND // 200


class Clocks:
    """A steady clock and one that runs ``rate`` times as fast and can be set."""

    def __init__(self) -> None:
        self.steady, self.offset, self.rate = 7 * SECOND, 1_000 * SECOND, 1.0

    def clock(self) -> int:
        return round(self.steady * self.rate) + self.offset

    def timeline(self) -> Timeline:
        return Timeline(self.clock, lambda: self.steady)


@pytest.mark.parametrize("seconds", [3600.0, 0.05, -0.05, -3600.0])
def test_stamps_follow_a_clock_that_is_set_at_once_and_time_goes_on(seconds: float) -> None:
    clocks = Clocks()
    timeline = clocks.timeline()
    clocks.steady += SECOND
    assert timeline.follow() == SECOND
    clocks.offset += round(seconds * SECOND)
    clocks.steady += PERIOD
    assert timeline.follow() == SECOND + PERIOD
    assert timeline.start + timeline.elapsed() == clocks.clock()
    assert timeline.sets == 1


@pytest.mark.parametrize("ppm", [500.0, -500.0])
def test_stamps_follow_a_clock_that_drifts_without_a_jump(ppm: float) -> None:
    """500 ppm is the most by which ntpd lets a clock go faster or slower."""
    clocks = Clocks()
    clocks.rate = 1.0 + 1e-6 * ppm
    timeline = clocks.timeline()
    stamps, errors = [], []
    for _ in range(100 * 200):
        clocks.steady += PERIOD
        stamps.append(timeline.follow() + timeline.start)
        errors.append(stamps[-1] - clocks.clock())
    assert timeline.sets == 0
    assert np.abs(errors).max() <= DRIFT + 2 * SLEW < SET
    assert np.abs(np.diff(stamps) - PERIOD).max() <= SLEW


def test_a_clock_that_is_right_leaves_the_stamps_equally_far_apart() -> None:
    clocks = Clocks()
    timeline = clocks.timeline()
    start = timeline.start
    for jitter in (0, DRIFT, -DRIFT, DRIFT // 2):
        clocks.offset = 1_000 * SECOND + jitter
        clocks.steady += PERIOD
        timeline.follow()
    assert timeline.start == start


def test_time_may_begin_with_a_stamp_of_the_past() -> None:
    clocks = Clocks()
    timeline = clocks.timeline()
    timeline.begin(clocks.clock() - 3 * PERIOD)
    assert timeline.elapsed() == 3 * PERIOD

"""Stamps of a log become the even times at which its device sampled, rows that are lost or not."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.importing.grid import clean_stamps, grid_of
from hybrid_sysid_ros.support.errors import UserError

PERIOD, ROWS = 0.01, 6000
LOST = {
    "none": [],
    "one row": [100],
    "twenty rows": list(range(100, 120)),
    "a gap before the middle": list(range(2500, 3100)),
    "rows here and there": np.random.default_rng(0).choice(np.arange(3000, 5990), 120, replace=False),
}


@pytest.mark.parametrize("lost", LOST.values(), ids=LOST)
def test_exact_times_stay_where_rows_are_lost(lost):
    kept = np.setdiff1d(np.arange(ROWS), np.asarray(lost, dtype=int))
    grid = grid_of(clean_stamps(PERIOD * kept, "t"), "t")
    assert grid.even
    assert grid.period == PERIOD
    np.testing.assert_allclose(grid.times, PERIOD * np.arange(ROWS), atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(grid.measured), kept)


def test_jitter_that_is_no_clocks_moves_the_period_by_less_than_its_mean():
    rng = np.random.default_rng(1)
    kept = np.setdiff1d(np.arange(ROWS), np.arange(100, 700))
    grid = grid_of(clean_stamps(PERIOD * kept + 1e-5 * rng.standard_normal(len(kept)), "t"), "t")
    assert grid.even
    # The variance of a line's slope is that of the jitter over the sum of squares about the mean.
    deviation = 1e-5 / (np.std(kept) * np.sqrt(len(kept)))
    assert abs(grid.period - PERIOD) < 4.0 * deviation + 1e-9


@pytest.mark.parametrize("scored", [3.0 * PERIOD, 5.0 * PERIOD])
def test_uneven_logs_of_one_logger_are_sampled_alike(scored):
    def uneven(seed):
        random = np.random.default_rng(seed)
        return clean_stamps(np.cumsum(PERIOD * random.uniform(0.8, 1.2, 2000)), "t")

    assert grid_of(uneven(0), "t").period != grid_of(uneven(1), "t").period
    alike = {grid_of(uneven(seed), "t", scored=scored).period for seed in range(3)}
    assert alike == {scored / round(scored / PERIOD)}


def test_uneven_steps_that_are_no_part_of_the_scored_period_stay():
    stamps = clean_stamps(np.cumsum(PERIOD * np.random.default_rng(0).uniform(0.8, 1.2, 2000)), "t")
    assert grid_of(stamps, "t", scored=1.3 * PERIOD).period == grid_of(stamps, "t").period


@pytest.mark.parametrize("back", [4.5, 20.0, 20.5, 200.0])
def test_a_clock_that_was_set_back_is_no_disorder(back):
    times = PERIOD * np.arange(ROWS, dtype=np.float64)
    times[ROWS // 2 :] -= back * PERIOD
    with pytest.raises(UserError, match=f"set back.* at row {ROWS // 2}"):
        clean_stamps(times, "t")


@pytest.mark.parametrize("late", [1, 5, 15])
def test_a_row_that_came_late_is_put_in_its_place(late):
    order = np.insert(np.delete(np.arange(ROWS), 3000), 3000 + late, 3000)
    np.testing.assert_array_equal(clean_stamps(PERIOD * order.astype(np.float64), "t").times, PERIOD * np.arange(ROWS))


def test_stamps_that_jitter_past_one_another_are_sorted_however_many_they_are():
    rng = np.random.default_rng(2)
    times = np.arange(300_000) + 0.4 * rng.standard_normal(300_000)
    np.testing.assert_array_equal(clean_stamps(times, "t").times, np.sort(times))

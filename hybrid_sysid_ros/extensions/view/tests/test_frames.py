"""Tables and frames: what a page gets is what was said, in order, once, however slow it is."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.view.tables import Cursor, Tables, packed, unpacked

SECOND = 1_000_000_000


def tables(capacity: int = 8) -> Tables:
    return Tables({"a": 3, "b": 2}, capacity=capacity)


def test_a_cursor_reads_each_row_once_and_in_order() -> None:
    made, cursor, read = tables(), Cursor(), []
    for k in range(20):
        made.tables["a"].add([k, 2 * k, -k])
        if k % 3 == 2:
            _, arrays = unpacked(made.frame(cursor))
            read.append(arrays["a"])
    _, arrays = unpacked(made.frame(cursor))
    read.append(arrays["a"])
    number = np.arange(20.0)
    np.testing.assert_array_equal(np.concatenate(read), np.column_stack([number, 2 * number, -number]))
    head, arrays = unpacked(made.frame(cursor))
    assert not arrays
    assert not head["tables"]


def test_who_comes_late_gets_what_is_still_there() -> None:
    made = tables(capacity=8)
    for k in range(100):
        made.tables["b"].add([k, k])
    _, arrays = unpacked(made.frame(Cursor()))
    np.testing.assert_array_equal(arrays["b"][:, 0], np.arange(92, 100))


def test_what_is_replaced_comes_in_its_newest_form_and_once() -> None:
    made, cursor = tables(), Cursor()
    for k in range(3):
        made.replace("plan", np.full((4, 2), float(k)))
        made.replace("words", {"line": f"{k}"})
    head, arrays = unpacked(made.frame(cursor))
    np.testing.assert_array_equal(arrays["plan"], np.full((4, 2), 2.0))
    assert head["news"] == {"words": {"line": "2"}}
    head, arrays = unpacked(made.frame(cursor))
    assert not arrays
    assert not head["news"]


def test_time_begins_anew_where_stamps_go_back() -> None:
    made, cursor = tables(), Cursor()
    for stamp in (5 * SECOND, 6 * SECOND):
        made.tables["b"].add([made.time(stamp, leads=True), 0.0])
    _, arrays = unpacked(made.frame(cursor))
    np.testing.assert_allclose(arrays["b"][:, 0], [0.0, 1.0])
    made.tables["b"].add([made.time(6 * SECOND - 1000, leads=True), 0.0])  # a little late: no new epoch
    made.tables["b"].add([made.time(2 * SECOND, leads=True), 0.0])
    head, arrays = unpacked(made.frame(cursor))
    assert head["epoch"] == 1
    np.testing.assert_allclose(arrays["b"][:, 0], [0.0])
    head, arrays = unpacked(made.frame(Cursor()))
    np.testing.assert_allclose(arrays["b"][:, 0], [0.0])


def test_time_begins_anew_where_the_clock_was_set() -> None:
    """From a simulated clock to the system's: no axis shows the seconds since 1970."""
    made, cursor, epoch = tables(), Cursor(), 1_700_000_000 * SECOND
    for stamp in (5 * SECOND, 6 * SECOND, epoch, epoch + SECOND):
        made.tables["b"].add([made.time(stamp, leads=True), 0.0])
    head, arrays = unpacked(made.frame(cursor))
    assert head["epoch"] == 1
    np.testing.assert_allclose(arrays["b"][:, 0], [0.0, 1.0])
    assert np.isnan(made.time(6 * SECOND))  # an answer to a measurement before
    assert made.time(epoch + 3 * SECOND) == pytest.approx(3.0)  # a preview


@pytest.mark.parametrize("words", ["", "a", "äöü", "x" * 7, "\u2028\ud7ff"])
def test_numbers_in_a_frame_are_aligned(words: str) -> None:
    """As Float64Array of JavaScript needs them."""
    frame = packed({"tables": [("a", 1, 2)], "latest": [], "words": words}, [[1.5, np.nan]])
    length = int.from_bytes(frame[:4], "little")
    assert (4 + length) % 8 == 0
    assert json.loads(frame[4 : 4 + length])["words"] == words
    np.testing.assert_array_equal(np.frombuffer(frame[4 + length :], "<f8"), [1.5, np.nan])

"""A record with short gaps: what is missing is known, filled in, and left out by fits and scores."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from test_bags import RATE, SIGNALS, other_topics, plain, stamps, states  # type: ignore[import-not-found]
from test_large_bags import in_chunks  # type: ignore[import-not-found]

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import bag as bag_module
from hybrid_sysid_ros.identification import evaluate, identify
from hybrid_sysid_ros.identification.part import without_gaps
from hybrid_sysid_ros.models import Sampling

SAMPLES = 200
LOST = [30, 31, 32, 100, 199 - 5]
KEPT = np.delete(np.arange(SAMPLES), LOST)


def holed(path, **chosen):
    """Samples k = 0, 1, ... of a position 0.1 k and an input k, but for those that are lost."""
    position, effort = np.column_stack([0.1 * KEPT] * 2), np.column_stack([1.0 * KEPT] * 2)
    return in_chunks(path, [states(len(KEPT), at=stamps(SAMPLES)[KEPT], position=position, effort=effort)], **chosen)


@pytest.mark.parametrize("block", [1 << 15, 1])
def test_what_is_missing_is_known_and_said(tmp_path, caplog, monkeypatch, block):
    monkeypatch.setattr(bag_module, "BLOCK", block)
    with caplog.at_level(logging.WARNING):
        record = bags.read(holed(tmp_path / "run"), SIGNALS)
    assert "5 of 200 samples are missing, in 3 gaps of up to 3" in caplog.text
    assert record.measured is not None
    assert np.flatnonzero(~record.measured).tolist() == LOST
    np.testing.assert_allclose(record.output[:, 0], 0.1 * np.arange(SAMPLES), rtol=1e-12)
    assert record.input[29:33, 0].tolist() == [33.0] * 4  # applied from sample 29 to 33, as the next message says
    assert np.isnan(record.channels["filtered"][LOST]).all()
    assert np.isfinite(record.channels["filtered"][KEPT]).all()


def test_a_slower_record_misses_what_lies_on_its_samples(tmp_path):
    record = bags.read(holed(tmp_path / "run"), SIGNALS, period=10 / RATE)
    assert record.samples == SAMPLES // 10
    assert record.measured is not None
    assert np.flatnonzero(~record.measured).tolist() == [3, 10]


def test_a_command_is_held_over_a_gap(tmp_path):
    drive = plain("/lab/drive", stamps(SAMPLES), np.arange(SAMPLES, dtype=float))
    angle = plain("/lab/angle", stamps(SAMPLES)[KEPT], 1.0 * KEPT)
    record = bags.read(bags.write_bag(tmp_path / "run", [angle, drive]), other_topics("following"))
    np.testing.assert_allclose(record.input[:, 0], np.arange(SAMPLES))  # that topic has no gap


def test_a_record_is_split_where_scored_samples_are_missing(tmp_path):
    record = bags.read(holed(tmp_path / "run"), SIGNALS)
    pieces = without_gaps([record], Sampling(step=1 / RATE, period=1 / RATE))
    assert [piece.samples for piece in pieces] == [30, 67, 93]
    assert all(piece.measured is None and piece.time[0] == 0.0 for piece in pieces)
    slow = without_gaps([record], Sampling(step=1 / RATE, period=7 / RATE))
    assert [piece.samples for piece in slow] == [SAMPLES]


def test_what_was_not_measured_teaches_and_scores_nothing(linear_records, rig):
    record = linear_records[0]
    measured = np.ones(record.samples, dtype=bool)
    measured[record.samples // 3 :: record.samples // 3] = False
    spoiled = replace(record, output=np.where(measured[:, None], record.output, 10.0), measured=measured)
    sampling = Sampling(step=record.sampling_time, period=record.sampling_time)
    model = identify([spoiled], rig, "linear", sampling=sampling)
    scores = [evaluate(model, item).r2 for item in (record, spoiled, replace(spoiled, measured=None))]
    assert scores[0] > 0.99
    assert scores[1] == pytest.approx(scores[0], abs=1e-3)
    assert scores[2] < 0.9

"""A model takes the place of another one if it is certainly better, and never else."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_sysid_ros.extensions.promotion.model_gain import LEVEL, ModelGain
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.runtime.parameters import shipped
from tests.command_line import refused

BAGS = Path(__file__).parents[4] / "bags"
HELD_OUT = BAGS / "beam_swept_sine"


def differences(seed, *, gain=0.0, pole=0.9, samples=2000):
    """Slow differences of squared errors, with a mean, over a record."""
    noise = np.random.default_rng(seed).normal(size=samples + 200)
    return lfilter([1.0 - pole], [1.0, -pole], noise)[200:] + gain


def test_a_model_that_is_as_good_is_rarely_promoted_and_one_that_is_better_often():
    promoted = [np.mean([ModelGain.of([differences(k, gain=gain)]).is_better for k in range(400)]) for gain in (0, 0.1)]
    assert promoted[0] == pytest.approx(1.0 - LEVEL, abs=0.03)
    assert promoted[1] > 0.95


def test_a_better_model_takes_the_place_of_the_one_in_use(command, linear_model, tmp_path):
    better, in_use = shipped("cam_beam", "model"), copytree(linear_model, tmp_path / "in_use")
    status, out, error = command("promote", better, "--in-use", in_use, HELD_OUT, BAGS / "beam_random_steps")
    assert status == 0, error
    assert "R2 over 2 records is higher by" in out
    assert load(in_use).seal == load(better).seal
    refused(command("promote", linear_model, "--in-use", in_use, HELD_OUT), "stays in use", "lower by")
    refused(command("promote", better, "--in-use", in_use, HELD_OUT), "stays in use")
    assert load(in_use).seal == load(better).seal
    assert [path.name for path in tmp_path.iterdir()] == ["in_use"]


def test_records_that_a_model_was_trained_on_say_nothing(command, linear_model, tmp_path):
    in_use = copytree(linear_model, tmp_path / "in_use")
    refused(command("promote", linear_model, "--in-use", in_use, BAGS / "beam_multisine"), "was trained on it")
    refused(command("promote", linear_model, "--in-use", tmp_path / "none", HELD_OUT), "none")
    refused(command("promote", linear_model, "--in-use", in_use, HELD_OUT), "no better")

"""Gates and thresholds: each opens where it says, a hair before it and a hair beyond."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.bags.gaps import GAP, LONGEST_GAP, SamplingError, missing_before
from hybrid_sysid_ros.bags.record import UNIFORMITY, Record
from hybrid_sysid_ros.bags.sampling import (
    FEWEST,
    JITTER,
    PERIOD_TOLERANCE,
    RecordSamples,
    check_order,
    multiple,
    uniform_period,
)
from hybrid_sysid_ros.control.policy.kernels import TrainingRange
from hybrid_sysid_ros.estimation import Tuning
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.sampling import LONGEST, MOST_STEPS
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.runtime.parameters import NodeParameter, check_rules
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear

MS = 1_000_000
HAIR = 1e-3


def opens(action) -> bool:
    """Whether there is no refusal."""
    try:
        action()
    except (UserError, SamplingError):
        return False
    return True


def stamps(*moved: tuple[int, float], count: int = 101) -> np.ndarray:
    """A grid of 10 ms on which some stamps are moved, by parts of that."""
    found = 10 * MS * np.arange(count)
    for k, part in moved:
        found[k] += round(10 * MS * part)
    return found


@pytest.mark.parametrize(
    ("given", "opened"),
    [
        (stamps(count=FEWEST), True),
        (stamps(count=FEWEST - 1), False),
        (stamps((50, JITTER - 5 * HAIR)), True),
        (stamps((50, JITTER + 5 * HAIR)), False),
        (stamps((50, -JITTER - 5 * HAIR)), False),
    ],
)
def test_stamps_of_a_uniform_sampling_lie_near_a_grid(given, opened):
    assert opens(lambda: uniform_period(given)) is opened


@pytest.mark.parametrize(("part", "opened"), [(HAIR, True), (-HAIR, True), (3 * HAIR, False), (-3 * HAIR, False)])
def test_a_sampling_time_is_the_expected_one(part, opened):
    expected = 0.01 / (1.0 + math.copysign(PERIOD_TOLERANCE - 2 * HAIR, part) + part)
    assert opens(lambda: uniform_period(stamps(), expected=expected)) is opened
    count, time = 5, 0.01 / (1.0 + math.copysign(PERIOD_TOLERANCE - 2 * HAIR, part) + part)
    assert opens(lambda: multiple(count * time, 0.01)) is opened


def test_a_period_is_one_sample_at_least():
    assert multiple(0.01, 0.01) == 1
    assert multiple(0.05, 0.01) == 5
    assert not opens(lambda: multiple(0.004, 0.01))


@pytest.mark.parametrize(("step", "words"), [(1, ""), (0, "repeated"), (-1, "reversed")])
def test_stamps_rise(step, words):
    given = np.array([0, 10, 20, 20 + step, 30], np.int64)
    if not words:
        check_order(given)
        return
    with pytest.raises(SamplingError, match=rf"^{words} stamp at sample 3"):
        check_order(given)


def test_an_interval_that_leaves_out_a_sample_is_a_gap():
    assert not missing_before(stamps((100, GAP - 1.0 - HAIR)), 0.01).any()
    for shift in (GAP - 1.0 + HAIR, 1.0):
        assert np.flatnonzero(missing_before(stamps((100, shift)), 0.01)).tolist() == [99]


def test_a_gap_is_short():
    assert missing_before(stamps((100, float(LONGEST_GAP))), 0.01).sum() == LONGEST_GAP
    long = np.delete(stamps(count=200), [*range(10, 10 + LONGEST_GAP), *range(100, 101 + LONGEST_GAP)])  # the second
    with pytest.raises(SamplingError, match=rf"\(0\.99 s\), about {LONGEST_GAP + 1} samples missing"):
        missing_before(long, 0.01)


@pytest.mark.parametrize(("lost", "opened"), [(10, True), (11, False)])
def test_a_tenth_of_a_record_may_be_missing(lost, opened):
    samples = RecordSamples(expected=None, period=None)
    samples.add(10 * MS * np.delete(np.arange(100), 3 * np.arange(1, lost + 1)))
    assert opens(samples.missing) is opened


@pytest.mark.parametrize(
    ("time", "opened"),
    [
        (np.arange(5.0), True),
        (np.arange(5.0) + 0.1, False),
        (-np.arange(5.0), False),
        (np.zeros(5), False),
        (np.array([0.0, 1.0, np.nan, 3.0, 4.0]), False),
        (np.array([0.0, 1.0, 2.0 + 0.5 * UNIFORMITY, 3.0, 4.0]), True),
        (np.array([0.0, 1.0, 2.0 + 2.0 * UNIFORMITY, 3.0, 4.0]), False),
    ],
)
def test_a_record_s_time_is_uniform_from_0_on(time, opened):
    one = np.zeros((5, 1))
    assert opens(lambda: Record(name="one", time=time, input=one, output=one)) is opened


@pytest.mark.parametrize(
    ("step", "period", "opened"),
    [
        (0.01, 0.01, True),
        (0.01, 0.05, True),
        (0.01, 0.055, False),
        (0.01, 0.005, False),
        (0.0, 0.05, False),
        (-0.01, 0.05, False),
        (LONGEST, LONGEST, True),
        (2.0 * LONGEST, 2.0 * LONGEST, False),
        (0.01, 0.01 * MOST_STEPS, True),
        (0.01, 0.01 * (MOST_STEPS + 1), False),
    ],
)
def test_a_period_is_a_multiple_of_a_step(step, period, opened):
    assert opens(lambda: Sampling(step=step, period=period)) is opened


@pytest.mark.parametrize(
    ("text", "opened"),
    [("0:1", True), ("0.2:0.3", True), ("0.3:0.3", False), ("0.3:0.2", False), ("-.1:1", False), ("0:1.1", False)],
)
def test_a_part_has_a_length_within_the_record(text, opened):
    assert opens(lambda: Part.parse(text)) is opened


@pytest.mark.parametrize(
    ("value", "opened"), [(0.0, True), (2, True), (-HAIR, False), (2.0 + HAIR, False), (math.nan, False), (True, False)]
)
def test_a_parameter_is_in_its_range(value, opened):
    parameter = NodeParameter(name="one", default=1.0, description="", low=0.0, high=2.0)
    assert opens(lambda: parameter.checked(value)) is opened


def test_a_parameter_that_must_be_above_another_is_no_equal():
    known = {
        "low": NodeParameter(name="low", default=1.0, description=""),
        "high": NodeParameter(name="high", default=2.0, description="", above="low"),
    }
    assert opens(lambda: check_rules(known, {"low": 1.0, "high": 1.0 + HAIR}))
    for high in (1.0, 1.0 - HAIR, math.nan):
        assert not opens(lambda high=high: check_rules(known, {"low": 1.0, "high": high}))


@pytest.mark.parametrize(
    ("change", "opened"),
    [
        ({"horizon": 1, "window": 0.0, "gate": HAIR, "patience": 0}, True),
        ({"horizon": 0}, False),
        ({"window": -HAIR}, False),
        ({"window": math.inf}, False),
        ({"gate": 0.0}, False),
        ({"gate": math.nan}, False),
        ({"patience": -1}, False),
        ({"followed": {"gain": HAIR}}, True),
        ({"followed": {"gain": 0.0}}, False),
        ({"followed": {"gain": math.inf}}, False),
        ({"followed": {"input_delay": HAIR}}, False),
    ],
)
def test_a_tuning_makes_sense(change, opened):
    system = Linear(gain=5.0, centre=0.9, stiffness=24.0, damping=22.0, input_delay=0.005)
    one = (1.0,)
    tuning = Tuning(measurement_noise=one, process_noise=one, disturbance_noise=one, disturbance_limit=one)
    assert opens(lambda: replace(tuning, **change).checked(system)) is opened


@pytest.mark.parametrize(
    ("change", "opened"),
    [({}, True), ({"high": -1.0}, False), ({"low": 2.0}, False), ({"rate": 0.0}, False), ({"high": math.inf}, False)],
)
def test_an_actuator_has_room_to_move(change, opened):
    assert opens(lambda: Actuator(**{"low": -1.0, "high": 2.0, "rate": HAIR, **change})) is opened


@pytest.mark.parametrize(
    ("high", "reach", "opened"),
    [(0.0, 0.0, True), (-HAIR, 1.0, False), (math.nan, 1.0, False), (1.0, -HAIR, False), (1.0, math.nan, False)],
)
def test_a_training_range_is_no_less_than_a_point(high, reach, opened):
    made = {"low": np.zeros(2), "whitening": np.eye(2), "reach": reach}
    assert opens(lambda: TrainingRange(high=np.array([1.0, high]), **made)) is opened


def test_troubles_are_judged_by_their_share_since_the_last_look():
    pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
    from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN, Troubles

    troubles, shares = Troubles(), {"warn": 0.25, "error": 0.5}
    assert troubles.judge({"late": 1, "lost": 0}, 4, **shares) == (WARN, "1 late, of 4")
    assert troubles.judge({"late": 1, "lost": 0}, 9, **shares) == (OK, "running")
    assert troubles.judge({"late": 2, "lost": 0}, 14, **shares) == (OK, "1 late, of 5")
    assert troubles.judge({"late": 3, "lost": 2}, 20, **shares) == (ERROR, "2 lost, 1 late, of 6")
    assert troubles.judge({"late": 6, "lost": 2}, 20, **shares) == (ERROR, "3 late, of 3")


@pytest.mark.parametrize(
    ("off", "start", "sets"), [(0, 0, 0), (1, 0, 0), (2, 1, 0), (-2, -1, 0), (20, 1, 0), (21, 21, 1), (-21, -21, 1)]
)
def test_stamps_follow_a_clock_that_is_off(off, start, sets):
    """By nothing up to a millisecond, by a slew up to 20, and at once beyond."""
    pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
    from hybrid_sysid_ros.nodes.timing import SLEW, Timeline

    clock = [10**15]
    timeline = Timeline(lambda: clock[0], lambda: 0)
    clock[0] += off * MS
    assert timeline.follow() == 0
    assert timeline.start - 10**15 == (start * MS if sets else start * SLEW)
    assert timeline.sets == sets


def test_what_mutants_are_made_of_is_there():
    tomllib = pytest.importorskip("tomllib")
    root = Path(__file__).parents[1]
    for gate in tomllib.loads((root / "benchmarks" / "mutants.toml").read_text(encoding="utf-8"))["gate"]:
        tree = ast.parse((root / gate["file"]).read_text(encoding="utf-8"))
        named = [getattr(node, "name", "") for node in ast.walk(tree)]
        assert named.count(gate["function"]) == 1, gate
        assert all((root / test.partition("::")[0]).is_file() for test in gate["tests"]), gate

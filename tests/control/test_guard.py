"""Guard: the ladder from evidence to rest, the governor of references, and what commands may do."""

import math

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from hybrid_sysid_ros.control.safety.failsafe import (
    AGAIN,
    NOTHING,
    ROOM,
    Evidence,
    Failsafe,
    Ladder,
    LoopState,
    judge_evidence,
)
from hybrid_sysid_ros.control.safety.governor import GovernedOutput, ReferenceGovernor, follow_reference, lead_from
from hybrid_sysid_ros.control.safety.guard import Guard, GuardSettings, acting_alike
from hybrid_sysid_ros.control.safety.guarding import RETURN
from hybrid_sysid_ros.estimation.reversed_input import NONE
from hybrid_sysid_ros.estimation.sensor_monitoring import MISSING
from hybrid_sysid_ros.estimation.suspicion import CLEAREST

LADDER = Ladder(slowed=0.1, holding=0.2, resting=0.3)
STEP, RECENT = 0.005, 10
UNKNOWN = np.full(1, math.nan)


def guard(**changes):
    given = {
        "act": True, "ladder": LADDER, "slow_share": 0.5, "resume_rate": np.array([2.0]), "tolerance": 0.05,
        "recent": RECENT * STEP, "reach": (np.array([-3.0]), np.array([np.nan])),
        "low": np.array([-10.0]), "high": np.array([10.0]), "rate": np.array([np.inf]),
        "state_low": np.array([-1.0, -np.inf]), "state_high": np.array([1.0, np.inf]),
        "stops": np.zeros(2), "alike": np.zeros((1, 1)), **changes,
    }  # fmt: skip
    return Guard(GuardSettings(**given))


def judge(found, steps, *, doubt=0.0, without=0.0, reversed=NONE, applied=UNKNOWN, state=(0.0, 0.0)):
    return [
        found.judge(doubt, without, reversed, applied, np.zeros(len(applied)), np.array(state), STEP)
        for _ in range(steps)
    ]


def test_evidence_climbs_the_ladder_one_level_after_the_other():
    """At twice the threshold suspicion is the time; each level comes after its own."""
    failsafe, kinds = Failsafe(*LADDER), [Evidence(2.0), Evidence(0.0)]
    levels = [judge_evidence(failsafe, kinds, 0.01) for _ in range(35)]
    for level, after in zip((LoopState.SLOWED, LoopState.HOLDING, LoopState.RESTING), LADDER, strict=True):
        assert levels.index(level) == pytest.approx(after / 0.01 - 1, abs=1)
    assert levels == sorted(levels)
    assert failsafe.cause == 0


@pytest.mark.parametrize("wrong", [1.0, 7.0, 0.5, -2.0, 1e300, math.inf, -math.inf, math.nan])
def test_a_reversed_input_that_is_none_of_the_rig_s_turns_nothing(wrong):
    """As a message may name it: the rig has one input, which is 0."""
    found = guard()
    judge(found, 1, reversed=wrong)
    assert found.turned(np.array([3.0])).tolist() == [3.0]


def test_a_reversed_input_is_turned_and_its_past_commands_are_what_acted():
    found = guard(low=np.array([-10.0]), high=np.array([4.0]))
    found.commanded(np.array([3.0]))
    judge(found, 1, applied=np.array([3.0]))
    judge(found, 1, without=1.0, reversed=0, applied=np.array([-3.0]))
    assert found.evidence["actuator"] == 0.0
    assert found.turned(np.array([2.0])) == -2.0
    assert found.turned(np.array([-9.0])) == 4.0, "within its bounds"
    assert found.level is LoopState.DRIVING
    assert "acts reversed" in found.reason
    judge(found, 1, reversed=math.nan)
    assert found.turned(np.array([2.0])) == -2.0, "an estimate that says nothing changes nothing"


def test_the_way_back_has_hysteresis_and_takes_a_known_time():
    failsafe, kinds = Failsafe(*LADDER), [Evidence(1e9)]
    for _ in range(1000):
        judge_evidence(failsafe, kinds, 0.01)
    assert failsafe.level == LoopState.RESTING
    kinds[0].value = 0.0
    levels = [judge_evidence(failsafe, kinds, 0.001) for _ in range(400)]
    assert levels == sorted(levels, reverse=True)
    left = next(k for k, level in enumerate(levels) if level < LoopState.RESTING) * 0.001
    assert left == pytest.approx((ROOM - AGAIN) * LADDER.resting, abs=0.003)
    back = levels.index(LoopState.DRIVING) * 0.001
    assert back == pytest.approx(ROOM * LADDER.resting - AGAIN * LADDER.slowed, abs=0.003)
    assert failsafe.cause == NOTHING


def test_evidence_below_its_threshold_never_trips():
    failsafe, kinds = Failsafe(*LADDER), [Evidence(0.99)]
    assert {judge_evidence(failsafe, kinds, 0.1) for _ in range(10_000)} == {LoopState.DRIVING}


def test_a_governor_leads_on_at_its_rate_and_is_free_when_it_has_met():
    governor, outputs, times = ReferenceGovernor(), [GovernedOutput(10.0, math.nan, math.nan)], [0.1, 0.2, 0.3]
    lead_from(governor, outputs, [0.0])

    def followed():
        preview = [5.0] * 3
        follow_reference(governor, outputs, [5.0], preview, times, 1.0, 0.1, False)
        return preview

    found = followed()
    assert found == pytest.approx([2.0, 3.0, 4.0])
    met = [governor.free]
    for _ in range(4):
        followed()
        met.append(governor.free)
    assert met == [False, False, False, False, True]
    assert outputs[0].reference == pytest.approx(5.0)


def test_doubt_slows_holds_and_rests():
    found = guard()
    levels = judge(found, 100, doubt=2.0)
    assert [levels[k] for k in (0, 25, 45, 65)] == [0, 1, 2, 3]
    assert "measurements" in found.reason


def test_a_missing_sensor_slows_and_no_more():
    assert set(judge(guard(), 100, without=1.0)) == {LoopState.SLOWED}


def test_a_sensor_that_shows_nothing_is_called_so_whether_the_others_tell_the_state_or_not():
    for doubt, words in ((0.0, "a sensor is missing"), (MISSING, "a sensor is missing"), (9.0, "contradict the model")):
        found = guard()
        judge(found, 100, doubt=doubt, without=1.0)
        assert words in found.reason
    found = guard()
    assert found.reason == ""
    judge(found, 100, doubt=MISSING)
    assert "contradict the model" in found.reason


def test_who_is_told_only_to_tell_drives_on():
    found = guard(act=False)
    assert set(judge(found, 100, doubt=5.0)) == {LoopState.DRIVING}
    assert found.level is LoopState.RESTING


def test_an_actuator_is_held_against_the_recent_commands():
    found = guard()
    for command in (3.0, 5.0):
        found.commanded(np.array([command]))
    judge(found, 1, applied=np.array([4.0]))
    assert found.evidence["actuator"] <= 0.0
    judge(found, 1, applied=np.array([-1.0]))
    assert found.evidence["actuator"] >= 1.0  # a volt below rest, of a tolerance of a volt
    judge(found, 1)
    assert found.evidence["actuator"] == 0.0, "what acts is not known"
    for _ in range(RECENT + 1):
        found.commanded(np.array([8.0]))
        judge(found, 1)
    levels = judge(found, 60, applied=np.array([0.0]))
    assert levels[-1] is LoopState.RESTING
    assert "actuator" in found.reason
    assert not found.may_stabilise
    judge(found, 60)
    assert found.may_stabilise


@pytest.mark.parametrize("step", [0.001, 0.002, 0.01, 0.02])
def test_an_actuator_has_the_same_time_at_any_rate_of_commands(step):
    found, allowed = guard(), RECENT * STEP
    found.commanded(np.array([8.0]))
    late = []
    for _ in range(round(2.0 * allowed / step)):
        found.judge(0.0, 0.0, NONE, np.zeros(1), np.zeros(1), np.zeros(2), step)
        found.commanded(np.array([8.0]))
        late.append(found.evidence["actuator"] > 0.0)
    assert late.index(True) * step == pytest.approx(allowed, abs=2.0 * step)


@pytest.mark.parametrize(("gain", "evident"), [(-1.0, True), (0.0, True), (0.2, True), (0.8, False), (1.2, False)])
def test_an_actuator_with_another_gain_is_found_by_small_commands(gain, evident):
    """Commands of 2 % of the range, which is less than the tolerance."""
    found, worst = guard(), 0.0
    for k in range(400):
        command = np.array([0.4 * math.sin(0.02 * k)])
        found.commanded(command)
        judge(found, 1, applied=gain * command)
        worst = max(worst, found.evidence["actuator"])
    assert (worst > 1.0) is evident


def test_a_state_outside_its_range_is_evidence():
    found = guard()
    judge(found, 1, state=(1.04, 1e6))
    assert found.evidence["range"] == pytest.approx(1.0)
    judge(found, 1, state=(math.nan, 0.0))
    assert found.evidence["range"] == 0.0


def test_no_evidence_is_worth_more_than_the_clearest():
    found = guard()
    judge(found, 1, doubt=math.inf)
    assert found.evidence["estimate"] == math.inf
    assert judge(found, 1, doubt=math.nan) == [LoopState.DRIVING]
    assert LADDER.slowed > (CLEAREST - 1.0) * STEP


def test_slowed_inputs_stay_near_rest_and_within_their_bounds():
    found = guard()
    judge(found, 40, doubt=2.0)
    assert found.slowed(np.array([9.0]), np.zeros(1)) == pytest.approx([5.0])
    assert found.slowed(np.array([9.0]), np.array([8.0])) == pytest.approx([9.0])
    assert found.slowed(np.array([12.0]), np.array([8.0])) == pytest.approx([10.0])


def test_inputs_get_their_range_back_within_a_stated_time():
    """A flipped sensor looks right at rest: it must show itself before the rig has been driven far."""
    found = guard()
    assert not found.slows
    judge(found, 40, doubt=2.0)
    while judge(found, 1)[0] > LoopState.DRIVING:
        assert found.slowed(np.array([10.0]), np.zeros(1)) == pytest.approx([5.0])
    room = []
    while found.slows:
        room.append(float(found.slowed(np.array([10.0]), np.zeros(1))[0]))
        judge(found, 1)
    assert np.diff(room) == pytest.approx(5.0 * STEP / RETURN)
    assert len(room) * STEP == pytest.approx(RETURN, abs=2 * STEP)


def test_a_command_is_no_faster_than_its_actuator():
    found = guard(rate=np.array([40.0]))
    assert found.followed(np.array([10.0]), np.array([0.0]), STEP) == pytest.approx([0.2])
    assert guard().followed(np.array([10.0]), np.array([0.0]), STEP) == pytest.approx([10.0])


def test_a_slowed_reference_moves_slowly_and_a_held_one_does_not():
    found, times = guard(), np.array([1.0])
    now, preview, where = np.array([4.0]), np.array([[4.0]]), np.array([1.0])
    assert found.reference(LoopState.DRIVING, now, where, preview, times, STEP) is preview
    found.reference(LoopState.SLOWED, np.array([0.0]), where, preview, times, STEP)
    assert found.reference(LoopState.SLOWED, now, where, preview, times, 1.0) == pytest.approx(np.array([[2.0]]))
    assert found.reference(LoopState.HOLDING, now, where, preview, times, 1.0) == pytest.approx(np.array([[1.0]]))
    assert found.reference(LoopState.DRIVING, now, where, preview, times, 0.5) == pytest.approx(np.array([[4.0]]))
    assert found.memory.outputs[0].reference == pytest.approx(2.0)


@pytest.mark.parametrize(("where", "begin"), [(0.5, 0.5), (7.0, 7.0), (-7.0, -3.0), (math.nan, 4.0)])
def test_a_loop_that_is_slowed_no_more_leads_the_reference_on_from_where_the_rig_is(where, begin):
    """An estimate that was wrong shows only then that the rig has been led astray."""
    found, times = guard(), np.array([1.0])
    now, preview = np.array([4.0]), np.array([[4.0]])
    found.reference(LoopState.SLOWED, now, now, preview, times, STEP)
    found.reference(LoopState.DRIVING, now, np.array([where]), preview, times, 0.0)
    assert found.memory.outputs[0].reference == begin
    for k in range(10):
        found.reference(LoopState.DRIVING, now, np.array([where]), preview, times, STEP)
        least = max(abs(begin - 4.0) - 2.0 * STEP * (k + 1), 0.0)
        assert abs(found.memory.outputs[0].reference - 4.0) == pytest.approx(least)


def test_a_reference_begins_within_the_reach_of_set_points():
    """A rig that was driven beyond all set-points is not led back from there."""
    found = guard()
    for begin, expected in ((-7.0, -3.0), (7.0, 7.0)):
        found.come_back(np.array([begin]))
        assert found.memory.outputs[0].reference == expected


@pytest.mark.parametrize(
    ("gain", "offset", "worst"),
    [
        (1.0, 1.5, LoopState.SLOWED),
        (0.0, 0.0, LoopState.SLOWED),
        (0.0, 9.0, LoopState.HOLDING),
        (-1.0, 0.0, LoopState.RESTING),
        (-1.0, 1.5, LoopState.RESTING),
    ],
)
def test_a_stabiliser_goes_on_with_all_actuators_but_one_that_does_the_opposite(gain, offset, worst):
    """A rig that can't rest loses more by a rest than by an actuator that is off, weak or stuck."""
    found, levels = guard(stabilised=True, low=np.array([-10.0]), high=np.array([10.0])), set()
    for k in range(400):
        command = np.array([1.5 * math.sin(0.05 * k)])
        found.commanded(command)
        levels |= {*judge(found, 1, applied=gain * command + offset)}
    assert max(levels) is worst
    assert found.may_stabilise is (worst < LoopState.RESTING)
    assert max(levels) <= found.level
    if worst < LoopState.RESTING:
        assert judge(found, 200, doubt=5.0)[-1] is LoopState.HOLDING, "nor does it for what else is in doubt"
        assert judge(found, 200, state=(9.0, 0.0))[-1] is LoopState.RESTING, "but it does where it is beyond its range"


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 2.0), (3.0, 0.0), (-1.0, 0.0), (-1.5, 0.0)])
def test_above_a_stabiliser_an_actuator_that_reports_what_it_does_is_made_to_do_what_was_wanted(gain, offset):
    """And when it acts as it is told again, it does so within the same time."""
    found, off = guard(stabilised=True, slow_share=0.9), list[float]()
    acted = np.zeros(1)
    for k in range(1200):
        broken = 200 <= k < 700
        wanted = np.array([2.0 + 0.5 * math.sin(0.01 * k)])
        level = judge(found, 1, applied=acted)[0]
        acting = found.slowed(wanted, np.zeros(1)) if found.slows else wanted
        found.commanded(acting)
        sent = found.turned(acting)
        acted = gain * sent + offset if broken else sent
        off.append(abs(float(acted[0] - wanted[0])))
        assert level < LoopState.RESTING or k < 300
    assert max(off[200:210]) > 1.0
    assert max(off[600:700]) < 1.1, "its tolerance is 1: what is less is held against none"
    assert max(off[1100:]) < 1e-2


def test_an_actuator_that_does_not_answer_is_not_trimmed():
    """What would be added would only act once it answers again."""
    found, most = guard(stabilised=True), 0.0
    for k in range(400):
        found.commanded(np.array([3.0 * math.sin(0.05 * k)]))
        judge(found, 1, applied=np.zeros(1))
        most = max(most, abs(found.memory.inputs[0].trim))
    assert most < 0.1


@pytest.mark.parametrize("acted", [math.nan, math.inf, -math.inf, 1e300])
def test_what_no_actuator_does_leaves_its_commands_numbers(acted):
    found, wanted = guard(stabilised=True), np.array([2.0])
    actuator = found.memory.inputs[0]
    for elapsed in (0.0, STEP, STEP):
        found.commanded(wanted)
        found.judge(0.0, 0.0, NONE, np.array([acted]), np.zeros(1), np.zeros(2), elapsed)
        assert np.isfinite([actuator.trim, actuator.common, actuator.spread]).all()
    assert np.isfinite(found.slowed(wanted, np.zeros(1))).all()


def test_a_rig_that_has_fallen_to_its_stop_is_named_and_not_lifted():
    """The estimate is then at the end of the travel, beyond which nothing comes."""
    found = guard(stabilised=True, stops=np.array([1.0, 0.0]))
    assert judge(found, 100, state=(0.95, 9.0))[-1] is LoopState.DRIVING
    assert found.may_stabilise
    levels = judge(found, 100, state=(1.0, 0.0))
    assert levels[-1] is LoopState.RESTING
    assert levels.index(LoopState.RESTING) * STEP < 0.5
    assert "travel" in found.reason
    assert not found.may_stabilise
    assert judge(found, 100, state=(0.0, 0.0))[-1] is LoopState.DRIVING, "somebody put it up again"
    assert found.may_stabilise


def test_a_rig_that_has_fallen_is_said_to_have_fallen_whatever_else_is_wrong():
    found = guard(stabilised=True, stops=np.array([1.0, 0.0]))
    judge(found, 100, doubt=5.0)
    judge(found, 100, doubt=5.0, state=(-1.0, 0.0))
    assert "travel" in found.reason


def test_inputs_act_alike_where_their_rows_of_an_lqr_are_parallel():
    """SciPy's gains, with Bryson's weights, tell by how much one of two with one effect makes up for the other."""
    state, one, ranges = np.array([[0.0, 1.0], [9.0, 0.0]]), np.array([0.0, 2.0]), np.array([4.0, 1.0])
    effect = np.column_stack([one, -3.0 * one])
    weights = np.diag(1.0 / ranges**2)
    cost = solve_continuous_are(state, effect, np.eye(2), weights)
    gains = np.linalg.solve(weights, effect.T @ cost)
    assert acting_alike(gains, ranges) == pytest.approx(np.array([[1.0, -3.0], [-1.0 / 3.0, 1.0]]))


def test_inputs_of_other_effects_make_up_for_none():
    assert acting_alike(np.eye(2), np.ones(2)) == pytest.approx(np.eye(2))
    assert acting_alike(np.array([[1.0, 2.0], [0.0, 0.0]]), np.ones(2)) == pytest.approx(np.diag([1.0, 0.0]))


def pair(**changes):
    """A guard of two inputs that do the same."""
    both = {"low": np.full(2, -10.0), "high": np.full(2, 10.0), "rate": np.full(2, np.inf)}
    return guard(**both, stabilised=True, alike=np.ones((2, 2)), **changes)


def test_an_input_makes_up_for_one_that_is_off_what_it_was_sent():
    found = pair()
    found.commanded(np.array([2.0, 2.0]))
    found.judge(0.0, 0.0, NONE, np.array([7.0, 2.0]), np.zeros(2), np.zeros(2), STEP)
    assert found.followed(np.array([3.0, 3.0]), np.zeros(2), STEP).tolist() == [3.0, -1.0]
    assert found.followed(np.array([-9.0, -9.0]), np.zeros(2), STEP).tolist() == [-9.0, -10.0], "within its bounds"
    found.judge(0.0, 0.0, NONE, np.array([7.0, 7.0]), np.zeros(2), np.zeros(2), STEP)
    assert found.followed(np.array([3.0, 3.0]), np.zeros(2), STEP).tolist() == [3.0, 3.0], "none is left that could"
    found.judge(0.0, 0.0, NONE, np.array([2.0, 2.0]), np.zeros(2), np.zeros(2), STEP)
    assert found.followed(np.array([3.0, 3.0]), np.zeros(2), STEP).tolist() == [3.0, 3.0]


def test_a_guard_that_only_tells_makes_up_for_nothing():
    found = pair(act=False)
    found.commanded(np.array([2.0, 2.0]))
    found.judge(0.0, 0.0, NONE, np.array([7.0, 2.0]), np.zeros(2), np.zeros(2), STEP)
    assert found.followed(np.array([3.0, 3.0]), np.zeros(2), STEP).tolist() == [3.0, 3.0]


@pytest.mark.parametrize("stabilised", [False, True])
def test_an_estimate_reports_an_input_of_a_stabiliser_that_is_far_off(stabilised):
    """The plan is of constant disturbances, which the answers of a stabiliser to its actuator are not."""
    found, disturbance = guard(alike=np.full((1, 1), float(stabilised))), np.array([6.0])
    found.commanded(np.array([5.0]))
    found.judge(0.0, 0.0, NONE, np.array([5.0]), disturbance, np.zeros(2), STEP)
    assert disturbance.tolist() == [0.0 if stabilised else 6.0]
    assert (found.evidence["actuator"] > 5.0) is stabilised
    found.judge(0.0, 0.0, NONE, np.array([5.0]), disturbance := np.array([0.9]), np.zeros(2), STEP)
    assert disturbance.tolist() == [0.9], "within the tolerance, it is the plan's"
    found.judge(0.0, 0.0, NONE, np.array([np.nan]), disturbance := np.array([6.0]), np.zeros(2), STEP)
    assert disturbance.tolist() == [6.0], "nothing is known of what it adds to"

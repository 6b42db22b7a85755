"""Gates of a plan: the bounds that a network's plan must keep, and when a prepared step is thought over."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hybrid_sysid_ros.control.mpc import sequential, shooting
from hybrid_sysid_ros.control.safety.supervision import INPUT_ROUNDING as ROUNDING
from hybrid_sysid_ros.control.safety.supervision import _bounded

LIMITS = SimpleNamespace(low=np.array([-2.0, -1.0]), high=np.array([4.0, 1.0]), rate=np.array([1.5, 9.0]))
STEADY = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])


@pytest.mark.parametrize(
    ("previous", "changes", "bounded"),
    [
        ([1.0, 0.0], {}, True),
        ([1.0, 0.0], {(2, 1): 1.0}, True),  # at a bound, and as far beyond it as rounding may lead
        ([1.0, 0.0], {(2, 1): 1.0 + 0.5 * ROUNDING}, True),
        ([1.0, 0.0], {(2, 1): -1.0 - 0.5 * ROUNDING}, True),
        ([1.0, 0.0], {(2, 1): 1.0 + 4.0 * ROUNDING}, False),
        ([1.0, 0.0], {(2, 1): -1.0 - 4.0 * ROUNDING}, False),
        ([1.0, 0.0], {(0, 0): 2.5 + 4.0 * ROUNDING}, False),  # changes too fast: at first,
        ([1.0, 0.0], {(2, 0): 2.5}, True),
        ([1.0, 0.0], {(2, 0): 2.6}, False),  # at last,
        ([1.0, 0.0], {(1, 0): -0.6}, False),  # downwards,
        ([-1.0, 0.0], {}, False),  # and from the input before
        ([9.0, 0.0], dict.fromkeys([(0, 0), (1, 0), (2, 0)], 3.0), True),  # which was beyond its bounds: from these
        ([1.0, 0.0], {(1, 1): np.nan}, False),
    ],
)
def test_a_plan_keeps_the_bounds_of_inputs_and_of_their_changes(previous, changes, bounded):
    inputs = STEADY.copy()
    for place, value in changes.items():
        inputs[place] = value
    assert _bounded(SimpleNamespace(previous=np.array(previous)), SimpleNamespace(limits=LIMITS), inputs) is bounded


class Calls(list[tuple[object, ...]]):
    """What the feedback phase does, where a step that changes costs by 100 is predicted to cost 100 and costs something
    else.
    """

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, cost: float, *, expected: float = 100.0, solvable: bool = True
    ) -> None:
        super().__init__()
        answers = {"make_step": (expected, 100.0), "simulated_cost": cost, "improve": "about the state itself"}
        for name in ("evaluate_program", "make_step", "simulated_cost", "apply_step", "assign", "improve"):
            monkeypatch.setattr(shooting, name, self._noted(name, answers.get(name)))
        program = SimpleNamespace(solve=lambda *_: solvable, keep_working_set=self._noted("keep", None))
        monkeypatch.setattr(shooting, "quadratic", program)

    def _noted(self, name, answer):
        def call(*arguments):
            self.append((name, *(item for item in arguments if isinstance(item, int | float))))
            return answer

        return call

    def feedback(self):
        horizon = SimpleNamespace(disturbance=None, progress=[SimpleNamespace(foreseen=3)])
        return shooting.iterate(None, horizon, None, SimpleNamespace(disturbance=None), shooting.FEEDBACK)


@pytest.mark.parametrize("cost", [50.0, 100.0 + 100.0 * sequential.DOUBT])
def test_a_step_that_costs_what_was_predicted_is_taken(monkeypatch, cost):
    calls = Calls(monkeypatch, cost)
    found = calls.feedback()
    assert (found.iterations, found.solved) == (1, False)
    assert [call for call in calls if call[0] in ("make_step", "apply_step", "improve")] == [("make_step",)]
    assert calls[0] == ("evaluate_program", True)


@pytest.mark.parametrize("cost", [100.0 * (1.0 + 1.1 * sequential.DOUBT), np.inf, np.nan])
def test_a_step_that_costs_more_is_taken_back_and_made_about_the_state_itself(monkeypatch, cost):
    calls = Calls(monkeypatch, cost)
    assert calls.feedback() == "about the state itself"
    assert [call for call in calls if call[0] in ("make_step", "apply_step", "improve")] == [
        ("make_step",),
        ("apply_step", -1.0),
        ("improve", False),
    ]


def test_a_cost_below_zero_is_judged_as_one_above(monkeypatch):
    """Economic problems have prices of either sign, and a constant in them changes nothing."""
    for constant in (-1e4, -100.0, 0.0, 1e4):
        assert Calls(monkeypatch, constant + 90.0 * sequential.DOUBT, expected=constant).feedback().iterations == 1
        assert Calls(monkeypatch, constant + 110.0 * sequential.DOUBT, expected=constant).feedback() == (
            "about the state itself"
        )


def test_without_a_solution_the_trajectory_stays(monkeypatch):
    calls = Calls(monkeypatch, 0.0, solvable=False)
    assert (calls.feedback().iterations, calls.feedback().solved) == (0, False)
    assert not [call for call in calls if call[0] == "make_step"]

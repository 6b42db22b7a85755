"""Near misses: they are about the instances that a policy misses, with the answers of the exact law."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc, StageTerm
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.extensions.policies.near_misses import NEAR, cheaper_plans, misses, near_misses
from hybrid_sysid_ros.extensions.policies.samples import sample
from hybrid_sysid_ros.extensions.policies.tests.test_samples import CARTS_SPREAD, SPREADS
from tests.linear_policies import CARTS, CASES, broken_policy, exact_policy


@pytest.mark.parametrize("name", CASES)
def test_a_law_misses_what_it_is_broken_at_and_the_exact_one_misses_nothing(name):
    case = CASES[name]
    samples = sample(case.system, case.problem, SPREADS[name], 7)
    free = np.all(
        np.abs(samples.plans) < 0.35 * case.problem.input_high[0], axis=(1, 2)
    )  # the exact law is linear there
    some = dataclasses.replace(samples, instances=samples.instances[free], plans=samples.plans[free])
    assert len(misses(exact_policy(case), some, 0)) == 0
    disturbance = some.instances[:, len(case.a)]
    found = misses(broken_policy(case), some, 0)
    assert 0 < np.sum(disturbance > 0.0) < len(disturbance)
    np.testing.assert_array_equal(found, np.flatnonzero(disturbance > 0.0))


def test_answers_near_a_miss_are_those_of_the_exact_law():
    case, spread = CARTS, CARTS_SPREAD.sized(CARTS.system)
    missed = sample(case.system, case.problem, CARTS_SPREAD, 7).instances[50]
    found = near_misses(case.system, case.problem, spread, exact_policy(case), missed[None], 3, followed={})
    instances, plans = found["instances"], found["plans"]
    moved = np.concatenate([spread.push, spread.disturbance, spread.input_jitter])
    asked = instances[:, : len(moved)] - missed[: len(moved)]
    np.testing.assert_allclose(asked.std(axis=0), NEAR * moved / np.sqrt(3.0), rtol=0.1)  # of sizes from none to NEAR
    np.testing.assert_array_equal(instances[:, len(moved) :], np.tile(missed[len(moved) :], (len(instances), 1)))
    for instance, plan in list(zip(instances, plans, strict=True))[::100]:
        np.testing.assert_allclose(plan, case.plan(instance), atol=2e-3)


@dataclass(frozen=True, kw_only=True)
class Point(System):
    """x' = u."""

    states = ("place [m]",)
    inputs = ("speed [m/s]",)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return (u[0],)


@pytest.mark.parametrize(("first", "second"), [(-1.0, 1.0), (1.0, -1.0)])
def test_of_two_local_solutions_the_cheaper_one_is_learned(first, second):
    """Two wells, at -1 and 1, the right one deeper by 2 a for (x^2 - 1)^2 - a x."""
    wells = (StageTerm(name="wells", value="(place**2 - 1)**2 - 0.1 * place", price=1.0),)
    problem = ControlProblem(
        horizon=10, period=0.1, substeps=1, output_weights=(0.0,), input_weights=(1e-3,), input_low=(-3.0,),
        input_high=(3.0,), terms=wells,
    )  # fmt: skip
    mpc, instances = ExactMpc(Point(), problem.sized(Point())), np.zeros((1, 1 + 2 + 10))
    plans = mpc.solve_many(instances, np.full((1, 10, 1), first), threads=1).inputs
    policy: Any = SimpleNamespace(
        features=lambda asked: asked, evaluate=lambda asked: np.full((len(asked), 4, 1), second)
    )
    assert np.sign(plans[0].sum()) == first
    assert cheaper_plans(mpc, policy, instances, plans)[0].sum() > 0.5

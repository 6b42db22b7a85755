"""Policies of a linear MPC that is never bounded: the exact law, by hand, and that law broken."""

import numpy as np
from test_mpc import LINEAR, least_squares_form  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import Problem
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.training_range import TrainingRange

__all__ = ["BROKEN_BY", "FEATURES", "LINEAR", "PROBLEM", "broken_policy", "exact_policy", "plan_by_hand"]

PROBLEM = Problem(
    horizon=8,
    period=0.02,
    substeps=4,
    output_weight=25.0,
    rate_weight=1.0,
    input_limit=100.0,  # never reached: the exact law is linear
    output_scale=0.0227,
    smoothing=0.005,
    max_iterations=50,
)
FEATURES = 2 + 2 + PROBLEM.horizon
SMALL = 1e-5
BROKEN_BY = 5.0  # V


def plan_by_hand(question, problem=PROBLEM):
    """The best inputs (horizon,) for [x, d, u_previous, q], by the normal equations."""
    matrix, right = least_squares_form(problem, question[:2], question[2], question[3], question[4:])
    return np.linalg.solve(matrix.T @ matrix, matrix.T @ right)


def exact_policy(problem=PROBLEM):
    """The exact law u = K [x, d, u_previous, q] + k."""
    return _policy(problem, np.zeros(FEATURES), np.zeros(problem.horizon))  # as many units as the broken one


def broken_policy(problem=PROBLEM):
    """The exact law, but off by a constant where the estimated disturbance is positive."""
    switch = np.zeros(FEATURES)
    switch[2] = 1e9
    return _policy(problem, switch, np.full(problem.horizon, BROKEN_BY / 2))


def _policy(problem, weights, effect):
    """Hidden units so small that they are straight, and one more of any weights and effect."""
    offset = plan_by_hand(np.zeros(FEATURES), problem)
    gains = np.array([plan_by_hand(row, problem) - offset for row in np.eye(FEATURES)]).T
    gains[:, 0] += gains[:, 4:].sum(axis=1)  # of the features the preview is q - y
    limit = problem.input_limit
    return Policy(
        problem=problem,
        model="5ea1",
        rig="cam_beam",
        states=2,
        output=0,
        centre=np.zeros(FEATURES),
        scale=np.ones(FEATURES),
        layers=(
            (np.vstack([SMALL * gains, weights]), np.zeros(problem.horizon + 1)),
            (np.column_stack([np.eye(problem.horizon) / SMALL, effect]) / limit, (offset + effect) / limit),
        ),
        training_range=TrainingRange(
            low=np.full(FEATURES, -1e3), high=np.full(FEATURES, 1e3), whitening=np.zeros((FEATURES,) * 2), reach=1.0
        ),
    )

"""Policies of random weights, small enough to be worked out by hand, for the tests."""

import dataclasses
from itertools import pairwise

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.policy.kernels import TrainingRange
from hybrid_sysid_ros.control.policy.policy import Correction, Policy
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.models import Model, Sampling
from tests.one_joint import Linear

PROBLEM = ControlProblem(
    horizon=4,
    period=0.05,
    substeps=10,
    output_weights=(100.0,),
    rate_weights=(1.0,),
    input_low=(-10.0,),
    input_high=(10.0,),
    output_scales=(0.0227,),
    smoothing=0.005,
    max_iterations=50,
    state_low=(-np.inf,) * 2,
    state_high=(np.inf,) * 2,
    soft_linear=(0.0,) * 2,
    soft_quadratic=(1e4,) * 2,
)
TWO = dataclasses.replace(
    PROBLEM,
    horizon=3,
    output_weights=(4.0, 0.0, 100.0),
    output_scales=(1.0, 1.0, 0.1),
    rate_weights=(1.0, 0.1),
    input_weights=(0.0, 0.0),
    rate_limits=(np.inf, np.inf),
    input_low=(-10.0, 0.0),
    input_high=(10.0, 3.0),
    state_low=(-np.inf,) * 4,
    state_high=(np.inf,) * 4,
    soft_linear=(0.0,) * 4,
    soft_quadratic=(1e4,) * 4,
)
"""Four states, two inputs, of which one is never negative, and three outputs, of which one is not tracked."""
MAPS = {1: np.array([[1.0, 0.0]]), 2: np.array([[1.0, 0.0, 0.5, 0.0], [0.0, -1.0, 0.0, 0.0]])}
SPREAD = Spread(amplitude=(4.0 * 0.0227,), disturbance=(0.3,), input_jitter=(1.0,), push=(0.01, 0.2))
SEAL = "5ea1"


def layers_of(random, widths):
    return tuple(
        (random.normal(size=(after, before)) / np.sqrt(before), random.normal(size=after) / 5)
        for before, after in pairwise(widths)
    )


def policy_of(seed=0, hidden=(5, 3), problem=PROBLEM, *, plan=False, correction=None):
    """A network of random weights with self-check vectors that are its own answers."""
    random = np.random.default_rng(seed)
    inputs = len(problem.input_low)
    features = features_count(problem)
    bare = Policy(
        problem=problem,
        model=SEAL,
        rig="cam_beam",
        output_map=MAPS[inputs],
        centre=random.normal(size=features) / 7,
        scale=random.uniform(0.1, 3.0, features),
        layers=layers_of(random, (features, *hidden, inputs * (problem.horizon if plan else 1))),
        training_range=TrainingRange.of(random.normal(size=(500, features)), np.zeros(features), np.ones(features)),
        correction=correction,
        training={"seed": seed},
    )
    check = random.normal(size=(20, features))
    return dataclasses.replace(bare, check=(check, by_hand(bare, check)))


def features_count(problem):
    tracked = sum(weight > 0 for weight in problem.output_weights)
    return MAPS[len(problem.input_low)].shape[1] + 2 * len(problem.input_low) + problem.horizon * tracked


def correction_of(problem, *, plan=True, hidden=(8,)):
    """Of two parameters."""
    answers = len(problem.input_low) * (problem.horizon if plan else 1)
    return Correction(
        names=("gain", "coulomb"),
        nominal=np.array([5.0, 2.0]),
        spread=np.array([0.5, 0.4]),
        layers=layers_of(np.random.default_rng(9), (features_count(problem), *hidden, 2 * answers)),
    )


def by_hand(policy, features):
    """The network in matrices: standardised features, tanh layers, a straight output that is +-1 at the bounds."""
    answers = in_matrices(policy.layers, (features - policy.centre) / policy.scale)
    low, high = np.array(policy.problem.input_low), np.array(policy.problem.input_high)
    return 0.5 * (low + high) + 0.5 * (high - low) * answers.reshape(len(features), -1, len(low))


def in_matrices(layers, signal):
    for matrix, bias in layers[:-1]:
        signal = np.tanh(signal @ matrix.T + bias)
    matrix, bias = layers[-1]
    return signal @ matrix.T + bias


def features_of(policy, state, d, previous, preview):
    errors = preview[:, list(policy.tracked)] - policy.output_map @ state
    return np.concatenate([state, d, previous, errors.ravel()])[None]


def instances(count, problem=PROBLEM, seed=0):
    """(state, disturbance, previous input, preview), one after another."""
    random = np.random.default_rng(seed)
    inputs, outputs = len(problem.input_low), len(problem.output_weights)
    states = MAPS[inputs].shape[1]
    for _ in range(count):
        state = random.normal(size=states) * 0.1
        preview = 0.08 * random.normal(size=(problem.horizon, outputs))
        yield state, random.normal(size=inputs), 5 * random.normal(size=inputs), preview


def model_of(seal=""):
    system = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
    names = tuple(item.name for item in system.parameters)
    return Model(
        rig="cam_beam",
        structure="viscous",
        system=system,
        sampling=Sampling(),
        names=names,
        covariance=np.eye(len(names)),
        training_range={},
        seal=seal,
    )

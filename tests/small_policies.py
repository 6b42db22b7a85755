"""Policies and a problem small enough to be worked out by hand, for the tests."""

import dataclasses
from itertools import pairwise

import numpy as np
from hybrid_sysid_ros.control.policy.sampling import Spread

from hybrid_sysid_ros.control import Problem
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.training_range import TrainingRange
from hybrid_sysid_ros.models import Model, Sampling
from tests.one_joint import Linear

PROBLEM = Problem(
    horizon=4,
    period=0.05,
    substeps=10,
    output_weight=100.0,
    rate_weight=1.0,
    input_limit=10.0,
    output_scale=0.0227,
    smoothing=0.005,
    max_iterations=50,
)
SPREAD = Spread(amplitude=4.0, disturbance=0.3, input_jitter=1.0, kick=(0.01, 0.2))
SEAL = "5ea1"


def layers_of(random, widths):
    return tuple(
        (random.normal(size=(after, before)) / np.sqrt(before), random.normal(size=after) / 5)
        for before, after in pairwise(widths)
    )


def policy_of(seed=0, widths=(8, 5, 3, 1), problem=PROBLEM, correction=None):
    """A network of random weights with self-check vectors that are its own answers."""
    random = np.random.default_rng(seed)
    layers = layers_of(random, widths)
    bare = Policy(
        problem=problem,
        model=SEAL,
        rig="cam_beam",
        states=2,
        output=0,
        centre=random.normal(size=8) / 7,
        scale=random.uniform(0.1, 3.0, 8),
        layers=layers,
        training_range=TrainingRange.of(random.normal(size=(500, 8)), np.zeros(8), np.ones(8)),
        correction=correction,
        training={"seed": seed},
    )
    features = random.normal(size=(20, 8))
    return dataclasses.replace(bare, check=(features, by_hand(bare, features)))


def by_hand(policy, features):
    """The network in matrices: standardised features, tanh layers, a straight output in units of the limit."""
    return policy.problem.input_limit * in_matrices(policy.layers, (features - policy.centre) / policy.scale)


def in_matrices(layers, signal):
    for matrix, bias in layers[:-1]:
        signal = np.tanh(signal @ matrix.T + bias)
    matrix, bias = layers[-1]
    return signal @ matrix.T + bias


def features_of(state, d, previous, preview):
    return np.concatenate([state, d, previous, preview - state[0]])[None]


def questions(count, seed=0):
    random = np.random.default_rng(seed)
    for _ in range(count):
        state, preview = random.normal(size=2) * [0.05, 0.3], 0.08 * random.normal(size=4)
        yield state, random.normal(size=1), 5 * random.normal(size=1), preview


def model_of(seal=""):
    system = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
    names = tuple(item.name for item in system.parameters)
    return Model(
        rig="cam_beam",
        structure="linear",
        system=system,
        sampling=Sampling(),
        names=names,
        covariance=np.eye(len(names)),
        training_range={},
        seal=seal,
    )

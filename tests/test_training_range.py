"""What a policy was trained on, and what is beyond it."""

import dataclasses

import numpy as np
import pytest
from small_policies import policy_of  # type: ignore[import-not-found]

from hybrid_sysid_ros.control.policy.kernels import TrainingRange


def test_the_training_data_are_inside_their_range_and_what_is_far_from_them_is_not():
    random = np.random.default_rng(5)
    # Two features that nearly agree, and six that have nothing to do with each other.
    features = random.normal(size=(2000, 8))
    features[:, 1] = features[:, 0] + 0.05 * features[:, 1]
    centre, scale = features.mean(axis=0), features.std(axis=0)
    policy = dataclasses.replace(policy_of(), training_range=TrainingRange.of(features, centre, scale))
    policy = dataclasses.replace(policy, centre=centre, scale=scale)

    def inside(row):
        return policy.inside(row[:2], row[2:3], row[3:4], row[4:, None] + row[0])

    assert all(inside(row) for row in features)
    low, high = features.min(axis=0), features.max(axis=0)
    for j in range(8):
        for value in (low[j] - 0.01, high[j] + 0.01):
            row = centre.copy()
            row[j] = value
            assert not inside(row)
    torn = centre.copy()
    torn[:2] = 1.5, -1.5  # each is ordinary, together they were never seen
    assert np.all((torn > low) & (torn < high))
    assert not inside(torn)
    assert inside(centre)
    for j in range(8):
        row = centre.copy()
        row[j] = np.nan
        assert not inside(row)


def test_the_distance_of_a_range_is_that_of_mahalanobis():
    random = np.random.default_rng(2)
    features = random.normal(size=(4000, 8)) @ random.normal(size=(8, 8))
    centre, scale = features.mean(axis=0), features.std(axis=0)
    found = TrainingRange.of(features, centre, scale)
    inverse = np.linalg.inv(np.cov(((features - centre) / scale).T, bias=True) + 1e-3 * np.eye(8))
    row = (random.normal(size=8) - centre) / scale
    assert np.sum((found.whitening @ row) ** 2) == pytest.approx(row @ inverse @ row, rel=1e-9)

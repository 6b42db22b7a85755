"""Fuzzy rules as blocks of a law: they are what they are written as, with their derivatives."""

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.fuzzy.affine_rules import AffineRules
from hybrid_sysid_ros.extensions.fuzzy.linked_rules import LinkedRules
from hybrid_sysid_ros.extensions.fuzzy.memberships import Memberships
from tests.core.test_networks import check_slopes


def fuzzy_c_means(block, weights, z):
    """Bezdek (1981), (11.3a): 1 / h_i = sum_k (d_i / d_k)^2."""
    rows = weights.reshape(block.rules, 2, -1)
    d = np.sqrt(np.sum(((z - rows[:, 0]) / np.exp(rows[:, 1])) ** 2, axis=1))
    return 1.0 / np.sum((d[:, None] / d) ** 2, axis=1)


def takagi_sugeno(block, weights, z):
    """Takagi and Sugeno (1985): the consequents' mean, weighed by the memberships."""
    h = fuzzy_c_means(block, weights[: 2 * block.rules * len(z)], z)
    rows = weights[2 * block.rules * len(z) :].reshape(block.outputs, block.rules, -1)
    return (rows[:, :, 0] + rows[:, :, 1:] @ z) @ h


def centre_of_area(block, weights, z):
    """As the five layers are written."""
    terms = weights.reshape(block.features + block.outputs, 2, -1)
    second = np.exp(-(((z[:, None] - terms[: len(z), 0]) / np.exp(terms[: len(z), 1])) ** 2))
    third = np.array([np.prod([second[j, t] for j, t in enumerate(rule)]) for rule in block.rules])
    found = []
    for links, (centres, widths) in zip(block.links, terms[len(z) :], strict=True):
        fourth = np.zeros(block.terms)
        for rule, term in links:
            fourth[term] += third[rule]
        areas = fourth * np.exp(widths)
        found.append(areas @ centres / areas.sum())
    return np.array(found)


BLOCKS = {
    "memberships": (Memberships(features=2, rules=4), fuzzy_c_means, 1e-9),
    "affine rules": (AffineRules(features=2, rules=3, outputs=2), takagi_sugeno, 1e-9),
    "linked rules": (
        LinkedRules(
            rules=((0, 1), (1, 1), (2, 0)), links=(((0, 0), (1, 1), (2, 1), (0, 2)), ((0, 2), (2, 0))), terms=3
        ),
        centre_of_area,
        1e-14,
    ),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_rules_have_slopes_by_features_and_weights(name):
    check_slopes(*BLOCKS[name])

"""What tests of certificates and trials share."""

import pytest

from tests.linear_policies import BEAM, broken_policy, exact_policy


@pytest.fixture(scope="module")
def law():
    return exact_policy(BEAM)


@pytest.fixture(scope="module")
def broken():
    return broken_policy(BEAM)

"""A guard stays silent in the loops of its rig's certificate, which have no fault."""

from __future__ import annotations

import pytest

from benchmarks.false_alarms import certificate
from hybrid_sysid_ros.extensions.policies.mixture import STRATA
from hybrid_sysid_ros.rigs.rig import load


@pytest.mark.parametrize("rig", ["flexible_joint", "wheel_motor"])
def test_the_guard_is_silent_in_the_loops_of_a_certificate(rig: str) -> None:
    """One of each stratum; python -m benchmarks.false_alarms --certificate N counts more, of all rigs."""
    found = certificate(load(rig), 0, loops=len(STRATA))
    assert found["alarmed"] == []
    assert found["suspicion"] < 1.0

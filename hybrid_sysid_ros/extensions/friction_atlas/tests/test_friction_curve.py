"""Friction over speed as an input, against the law in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.friction_atlas.friction_curve import friction_curve
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError


def test_the_curve_is_the_law_s() -> None:
    rig = load("cam_beam").system
    given = {**rig.named, "asymmetry": 0.0, "stribeck_excess": 0.8}
    beam = rig.with_values([given[item.name] for item in rig.parameters])
    speeds = np.linspace(0.02, 1.0, 7)
    named = beam.named
    level = named["coulomb"] + 0.8 / (1.0 + (speeds / named["stribeck_speed"]) ** 2) ** 2
    wanted = (level + named["damping"] * speeds) / named["gain"]
    np.testing.assert_allclose(friction_curve(beam, speeds).inputs, wanted, rtol=1e-3)


def test_what_has_no_one_curve_is_refused() -> None:
    with pytest.raises(UserError, match="needs one velocity"):
        friction_curve(load("flexible_joint").system, np.ones(1))

"""Regression of texels and pixels, against least squares over those pictures alone in which nobody comes by."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.reading.regression import line

COUNT, NOISE = 160, 2.5


@pytest.mark.parametrize(("slope", "level"), [(1.0, 0.0), (0.0, 230.0), (0.5, 90.0)])
@pytest.mark.parametrize("covered", [0.0, 0.24, 0.35])
def test_who_comes_by_does_not_move_the_line(slope: float, level: float, covered: float) -> None:
    """Clear, hiding and half of both, before brick, panel and strip, somebody grey before it in some pictures."""
    random = np.random.default_rng(round(100 * covered))
    behind = random.choice([84.0, 107.0, 140.0, 184.0], COUNT) + random.standard_normal(COUNT)
    seen = slope * behind + level + NOISE * random.standard_normal(COUNT)
    grey = random.uniform(size=COUNT) < covered
    seen[grey] = 40.0
    found = line(seen, behind, NOISE, np.empty(COUNT))
    wanted = np.polyfit(behind[~grey], seen[~grey], 1)
    assert found[0] == pytest.approx(min(max(wanted[0], 0.0), 1.0), abs=0.02)
    assert found[0] * 130.0 + found[1] == pytest.approx(np.polyval(wanted, 130.0), abs=0.5)

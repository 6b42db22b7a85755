"""hybrid-sysid check: the shipped model of every shipped rig passes, and for a rig without one that is reported."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from hybrid_sysid_ros.extensions.checks.commands.check import Checks
from hybrid_sysid_ros.rigs.folder import find, names
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.parameters import NothingShippedError


@pytest.mark.parametrize("name", sorted(names()))
def test_every_shipped_model_explains_its_rig(name: str, tmp_path: Path) -> None:
    """Also the vehicle's, which is unstable and whose commands begin after a minute."""
    checks = Checks(load(name), tmp_path)
    assert "samples" in checks.bag()
    assert "R2 " in checks.model()


def test_a_user_of_a_rig_of_their_own_learns_that_nothing_comes_with_it(tmp_path: Path) -> None:
    folder = shutil.copytree(find("flexible_joint").path, tmp_path / "my_joint")
    checks = Checks(load(folder), tmp_path)
    checks.bag()
    for check in (checks.model, checks.policy, checks.loop):
        with pytest.raises(NothingShippedError, match="comes with the package for the rig my_joint"):
            check()

"""What tests of rigs share."""

import pytest

from hybrid_sysid_ros.rigs import outside
from hybrid_sysid_ros.rigs import rig as rigs


@pytest.fixture(autouse=True)
def _nothing_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each test begins as a process does, with no rig named by its path."""
    monkeypatch.setenv(outside.VARIABLE, "")
    monkeypatch.setattr(rigs, "_LOADED", dict(rigs._LOADED))

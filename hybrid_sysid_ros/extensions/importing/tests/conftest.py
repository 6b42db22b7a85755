"""Commands as tests call them."""

from __future__ import annotations

from functools import partial

import pytest

from hybrid_sysid_ros.commands import app


@pytest.fixture
def program(call):
    return partial(call, app.main, "hybrid-sysid")


@pytest.fixture
def imported(call, tmp_path):
    return partial(call, app.main, "hybrid-sysid", "import", "--rig", "cam_beam", "--out", str(tmp_path / "bags"))

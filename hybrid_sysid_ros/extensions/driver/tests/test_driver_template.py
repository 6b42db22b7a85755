"""The driver that `rig driver` writes, against the board that it writes beside it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hybrid_sysid_ros.commands import rig_new
from hybrid_sysid_ros.extensions.driver.commands import rig_driver
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")


def test_what_is_written_passes_its_own_test(tmp_path: Path) -> None:
    folder = tmp_path / "driven_sled"
    rig_new.command(folder)
    rig_driver.command(folder)
    options = ["-q", "-p", "no:cacheprovider", "--rootdir", str(folder), str(folder)]
    found = subprocess.run(
        [sys.executable, "-m", "pytest", *options], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert found.returncode == 0, found.stdout
    with pytest.raises(UserError, match=r"driver\.py: is there already"):
        rig_driver.command(folder)


def test_a_folder_that_is_no_rig_is_refused(tmp_path: Path) -> None:
    shutil.copytree(Path(rig_driver.TEMPLATE), tmp_path / "other")
    with pytest.raises(UserError, match=r"rig\.yaml"):
        rig_driver.command(tmp_path / "other")

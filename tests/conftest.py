"""What all tests share."""

import os
from pathlib import Path

import pytest

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # before the first import of a message: a wrong type fails, not corrupts


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real records that HYBRID_SYSID_DATA names."""
    folder = os.environ.get("HYBRID_SYSID_DATA", "")
    if folder and not Path(folder).is_dir():
        pytest.fail(f"HYBRID_SYSID_DATA={folder} is not a folder: correct it, or unset it to skip the real records")
    if not folder or not any(Path(folder).iterdir()):
        pytest.skip("needs the real records: set HYBRID_SYSID_DATA to their folder (see the README)")
    return Path(folder)

"""What tests of searches share."""

from pathlib import Path

import pytest


@pytest.fixture
def place(tmp_path: Path) -> str:
    """Where the studies of a search are kept; nothing is there yet."""
    return str(tmp_path / "deep" / "search.db")

"""What tests of the studies share."""

from pathlib import Path

import pytest

from hybrid_sysid_ros.bags.record import Record
from studies.beam_lecture import lecture


@pytest.fixture(scope="session")
def author_records(data: Path) -> list[Record]:
    """The author's records, turned into bags and read."""
    return lecture.read_folder(data)

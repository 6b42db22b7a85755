"""What tests of rigs share."""

from pathlib import Path

import pytest

from tests.rigs.tank import TANK, TANK_VALUES


@pytest.fixture
def make(tmp_path: Path):
    """Write a rig's folder."""

    def made(name: str = "tanks", system: str | None = TANK, values: str | None = TANK_VALUES) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        for file, text in (("system.py", system), ("rig.yaml", values)):
            if text is not None:
                (folder / file).write_text(text)
        return folder

    return made

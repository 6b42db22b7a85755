"""docs/add-a-rig.md, word for word: the files it shows, the commands it gives."""

import re
from functools import partial
from pathlib import Path

import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.rigs.rig import load

PAGE = (Path(__file__).parents[2] / "docs" / "add-a-rig.md").read_text(encoding="utf-8")
PYTHON, VALUES = (re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)[0] for kind in ("python", "yaml"))
COMMANDS = [line.split()[1:] for line in re.findall(r"^    (hybrid-sysid .*)$", PAGE, re.MULTILINE)]


@pytest.fixture
def command(call):
    """Run hybrid-sysid with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid")


def test_the_pendulum_is_short():
    assert len(PYTHON.splitlines()) < 60
    assert len(VALUES.splitlines()) < 60


def test_the_pendulum_passes_its_check_and_is_simulated(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    new, check, *rest = COMMANDS
    assert new[:2] == ["rig", "new"]
    assert command(*new)[0] == 0
    (tmp_path / "pendulum" / "system.py").write_text(PYTHON)
    (tmp_path / "pendulum" / "rig.yaml").write_text(VALUES)
    assert check[:2] == ["rig", "check"]
    status, _, error = command(*check)
    assert (status, error) == (0, "")
    simulate = rest[0]
    assert simulate[0] == "simulate"
    assert command(*simulate)[0] == 0
    record = bags.read(tmp_path / "bags" / "multisine", load(tmp_path / "pendulum").signals)
    assert record.input.shape == record.output.shape == (8001, 1)
    assert 0.3 < abs(record.output).max() < 3.2  # it swings, and stays below the upright

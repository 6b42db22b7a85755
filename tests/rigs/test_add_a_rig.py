"""The tutorials on rigs, word for word: their files and their commands, in a folder outside the package."""

import re
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from hybrid_sysid_ros import bags, models
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.identification import Part, evaluate
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
PAGE = "\n".join((TUTORIALS / name).read_text(encoding="utf-8") for name in ("add-a-rig.md", "two-inputs.md"))
COMMANDS = [line.split()[1:] for line in re.findall(r"^    (hybrid-sysid .*)$", PAGE, re.MULTILINE)]
PYTHON, VALUES = (re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) for kind in ("python", "yaml"))


class Shown(NamedTuple):
    """A rig of the pages."""

    name: str
    system: str
    values: str
    records: tuple[str, ...]
    tracking: dict[tuple[str, int], float]
    """(segment of the reference, output): largest root mean square error, as the output is shown."""


RIGS = [
    Shown(
        "pendulum",
        PYTHON[0],
        VALUES[0],
        ("multisine", "random_steps"),
        {("steps", 0): 12.0, ("sine", 0): 1.0},  # deg; steps of up to 80, which the limit of the torque lets take time
    ),
    Shown(
        "axis",
        PYTHON[1],
        VALUES[1],
        ("steps_1", "steps_2"),
        {("angles", 0): 15.0, ("torques", 1): 0.25},  # deg, N m
    ),
]


@pytest.fixture(params=RIGS, ids=[shown.name for shown in RIGS])
def shown(request) -> Shown:
    return request.param


@pytest.fixture
def command(call):
    """Run hybrid-sysid with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid")


def test_the_rigs_are_short(shown):
    assert len(shown.system.splitlines()) < 60
    assert len(shown.values.splitlines()) < 60


@pytest.mark.slow
def test_the_pages_lead_from_a_new_folder_to_a_certified_policy_in_the_loop(
    shown, command, domain, tmp_path, monkeypatch
):
    pytest.importorskip("torch", reason="needs the extra [train]")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    folder = tmp_path / shown.name
    new, *rest = [words for words in COMMANDS if f"./{shown.name}" in words]
    assert command(*new)[0] == 0
    (folder / "system.py").write_text(shown.system)
    (folder / "rig.yaml").write_text(shown.values)
    for words in rest:
        status, _, error = command(*words)
        assert status == 0, (words, error)
    rooms = ["check", "simulate", "simulate", "identify", "evaluate", "train", "certify", "run"]
    assert [next(word for word in words if word in rooms) for words in rest] == rooms

    rig = load(folder)
    model = models.load(tmp_path / "model", rig=folder)
    assert model.structure == "hybrid"
    for name in shown.records:
        unseen = evaluate(model, bags.read(tmp_path / "bags" / name, rig.signals), part=Part(start=0.5))
        assert min([unseen.r2, *(item.r2 for item in unseen.outputs.values())]) > 0.995
    policy = policies.load(tmp_path / "policy", model=model)
    assert policy.certificate is not None
    assert policy.certificate.rates["supervised"]["mixture"]["bounds"] == 1.0
    assert policy.certificate.rates["supervised"]["mixture"]["cost"] > 0.9

    loop = LoopRecord.from_bag(tmp_path / "loop", rig)
    schedule = rig.schedule()
    assert loop.missed_commands() < 0.01 * len(loop.stamps)  # of processes in real time, whatever runs beside
    assert np.diff(loop.stamps).max() == np.diff(loop.stamps).min() == 5_000_000  # ns
    assert loop.time[-1] > schedule.duration - 0.1
    assert np.isfinite(loop.outputs).all()
    assert (loop.inputs >= [actuator.low for actuator in rig.actuators]).all()
    assert (loop.inputs <= [actuator.high for actuator in rig.actuators]).all()
    segments = {segment.name: segment for segment in schedule.segments}
    for (name, output), most in shown.tracking.items():
        found = loop.tracking_rmse(segments[name].start, segments[name].stop, output=output)
        assert 0.0 < found < most, (name, found)

"""A rig is a folder, found by name, path or entry point; what is wrong with one is said in one line with its file."""

import dataclasses
import importlib.metadata
import pickle
import subprocess
import sys
from typing import Any

import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.rigs import folder as folders
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.folder import HOME
from hybrid_sysid_ros.runtime.parameters import declarations, parameters
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused
from tests.rigs.tank import TANK


def test_a_rig_outside_of_the_package_is_found_by_its_path(make):
    folder = make()
    rig = rigs.load(str(folder))
    assert rig.name == "tanks"
    assert [item.name for item in rig.system.states] == ["upper", "lower", "heat"]
    assert [(item.low, item.high) for item in rig.actuators] == [(0.0, 0.002), (0.0, 100.0)]
    assert [(display.unit, display.scale) for display in rig.display] == [("mm", 1e-3), ("K", 1.0), ("m^3/s", 1.0)]
    assert rig.source == str(folder)
    assert rigs.load(folder) is rig
    assert rigs.load("tanks") is rig  # named by its path before


def test_signals_follow_from_the_joints(make):
    signals = rigs.load(make()).signals
    assert {name: signal.field for name, signal in signals.inputs.items()} == {
        "pump": "effort[pump]",  # an input of no joint has one of its own name
        "heater": "effort[boiler]",
    }
    assert {name: signal.field for name, signal in signals.outputs.items()} == {
        "lower": "position[lower]",
        "heat": "position[boiler]",
        "inflow": "position[inflow]",
    }
    assert signals.topic(signals.outputs["heat"]) == "/tanks/joint_states"
    assert set(signals.channels) == {
        "reference_lower", "reference_heat", "reference_inflow", "command_pump", "command_heater",
    }  # fmt: skip


def test_what_was_edited_is_read_again_by_whoever_loads_it(make):
    """In a notebook the law is corrected between two fits; models that were loaded before keep theirs."""
    folder = make()
    before = hs.load_rig(folder)
    assert hs.load_rig(folder) is before
    (folder / "system.py").write_text(TANK.replace("0.1, 0.01, 1.0", "0.25, 0.01, 1.0"))
    after = hs.load_rig(folder)
    assert (before.system.named["area"], after.system.named["area"]) == (0.1, 0.25)
    assert rigs.load("tanks") is after
    (folder / "rig.yaml").write_text(f"{(folder / 'rig.yaml').read_text()}\nnamespace: other\n")
    assert hs.load_rig(folder).namespace == "other"
    assert pickle.loads(pickle.dumps(hs.load_rig(folder).system)).named["area"] == 0.25


def test_each_folder_has_its_own_python(make):
    one = rigs.load(make("one"))
    two = rigs.load(make("two", TANK.replace("0.1, 0.01, 1.0", "0.2, 0.01, 1.0")))
    assert type(one.system) is not type(two.system)
    assert (one.system.named["area"], two.system.named["area"]) == (0.1, 0.2)


def test_a_process_that_is_started_knows_the_rig_and_its_classes(make):
    """As workers do: a system travels as it is, and a model's rig is found by its name."""
    system: Any = rigs.load(make()).system
    code = (
        "import pickle, sys; from hybrid_sysid_ros.rigs.rig import load;"
        "system = pickle.loads(bytes.fromhex(sys.argv[1])); assert type(system) is type(load('tanks').system);"
        "print(system.named['area'])"
    )
    sent = pickle.dumps(dataclasses.replace(system, area=0.3)).hex()
    found = subprocess.run([sys.executable, "-c", code, sent], capture_output=True, text=True, check=False)
    assert (found.stdout, found.stderr) == ("0.3\n", "")


def test_a_package_offers_a_rig_by_an_entry_point(make, monkeypatch):
    package = make("offered_tanks")
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(package.parent))
    point = importlib.metadata.EntryPoint(name="tanks", value="offered_tanks", group=folders.GROUP)
    monkeypatch.setattr(folders, "_installed", lambda: [point])
    rig = rigs.load("tanks")
    assert (rig.name, rig.folder, rig.source) == ("tanks", package, "tanks")
    assert type(rig.system).__module__ == "offered_tanks.system"
    twin = importlib.metadata.EntryPoint(name="cam_beam", value="offered_tanks", group=folders.GROUP)
    monkeypatch.setattr(folders, "_installed", lambda: [twin])
    with pytest.raises(UserError, match=r"two rigs are called cam_beam: in .* and offered_tanks"):
        rigs.load("cam_beam")
    for name in [name for name in sys.modules if name.startswith("offered_tanks")]:
        del sys.modules[name]


def test_a_rig_that_is_found_twice_is_one(call, monkeypatch):
    """By a package that is installed twice, and by another name for a rig of this package."""
    own, other = (
        importlib.metadata.EntryPoint(name=name, value="hybrid_sysid_ros.rigs.cam_beam", group=folders.GROUP)
        for name in ("cam_beam", "beam")
    )
    monkeypatch.setattr(folders, "_installed", lambda: [own, other, own])
    assert rigs.load("cam_beam") is rigs.load("beam") is rigs.load(HOME / "cam_beam")
    status, shown, _ = call(app.main, "hybrid-sysid", "rig", "list")
    assert (status, shown.count(str(HOME / "cam_beam"))) == (0, 1)


def test_two_rigs_of_one_name_are_reported_in_the_list(call, monkeypatch):
    other = "hybrid_sysid_ros.rigs.flexible_joint"
    twin = importlib.metadata.EntryPoint(name="cam_beam", value=other, group=folders.GROUP)
    monkeypatch.setattr(folders, "_installed", lambda: [twin])
    refused(call(app.main, "hybrid-sysid", "rig", "list"), "two rigs are called cam_beam")


def test_an_entry_point_that_fails_is_reported(monkeypatch):
    point = importlib.metadata.EntryPoint(name="crane", value="no_such_package", group=folders.GROUP)
    monkeypatch.setattr(folders, "_installed", lambda: [point])
    with pytest.raises(UserError, match="rig crane: entry point no_such_package can't be imported"):
        rigs.load("crane")


def test_a_rig_of_the_package_is_the_same_by_name_and_by_path(make):
    assert rigs.load(HOME / "cam_beam") is rigs.load("cam_beam")
    assert rigs.load("cam_beam").source == "cam_beam"


def test_two_rigs_of_one_name_are_reported(make):
    with pytest.raises(UserError, match="a rig is called cam_beam already, in hybrid_sysid_ros"):
        rigs.load(make("cam_beam"))
    first = make("a")
    (first / "tanks").mkdir()
    for file in ("system.py", "rig.yaml"):
        (first / "tanks" / file).write_text((first / file).read_text())
    rigs.load(first / "tanks")
    with pytest.raises(UserError, match="a rig is called tanks already"):
        rigs.load(make("tanks"))


def test_a_missing_rig_is_reported_with_those_that_are_there(tmp_path, monkeypatch):
    with pytest.raises(UserError, match=r"no rig 'crane': known are .*cam_beam"):
        rigs.load("crane")
    (tmp_path / "crane").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=r"write \./crane"):
        rigs.load("crane")
    with pytest.raises(UserError, match="the folder is empty"):
        rigs.load("./crane")
    with pytest.raises(UserError, match="no such folder"):
        rigs.load("./winch")
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="is a file"):
        rigs.load("./file")


def test_the_rigs_of_the_package_load_and_hold_their_numbers():
    for name in folders.names():
        rig = rigs.load(name)
        rig.system.check()
        for structure in rig.structures.values():
            structure.check()
            assert structure.inputs == rig.system.inputs
            assert structure.outputs == rig.system.outputs


@pytest.mark.parametrize("name", sorted(folders.names()))
def test_values_of_a_rig_s_nodes_go_together(name: str) -> None:
    for node in declarations():
        assert parameters(name, node)

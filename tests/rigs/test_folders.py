"""A rig is a folder, found by name, path or entry point; what is wrong with one is said in one line with its file."""

import dataclasses
import importlib.metadata
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core import one_step, simulate, step_with_jacobian
from hybrid_sysid_ros.rigs import folder as folders
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.folder import HOME
from hybrid_sysid_ros.runtime.parameters import declarations, parameters
from hybrid_sysid_ros.support.errors import UserError, UserErrors
from tests.command_line import refused

TANK = """
from dataclasses import dataclass
from hybrid_sysid_ros.core import System, RungeKutta, bounded
from hybrid_sysid_ros.core.mathematics import maximum, sqrt

@dataclass(frozen=True, kw_only=True)
class Tanks(System):
    states = ("upper [m]", "lower [m]", "heat [K]")
    inputs = ("pump [m^3/s]", "heater [W]")
    outputs = ("lower", "heat", "inflow [m^3/s]")
    stepper = RungeKutta()
    delays = {"heater": "heater_delay"}
    area: float = bounded(0.1, 0.01, 1.0, unit="m^2")
    outlet: float = bounded(0.002, 0.0, 0.1, unit="m^2.5/s")
    capacity: float = bounded(500.0, 1.0, 1e5, unit="J/K")
    loss: float = bounded(5.0, 0.0, 100.0, unit="W/K")
    heater_delay: float = bounded(0.25, 0.0, 5.0, unit="s")

    def law(self, x, u):
        upper, lower, heat = x
        through, out = self.flow(upper), self.flow(lower)
        return (u[0] - through) / self.area, (through - out) / self.area, (u[1] - self.loss * heat) / self.capacity

    def flow(self, level):
        return self.outlet * level / sqrt(maximum(level, 1e-3))

    def output(self, x, u):
        return x[1], x[2], self.flow(x[0])
"""
TANK_VALUES = """
step: 0.1
sensors:
  lower: {unit: mm, scale: 0.001, white_noise: 1.0}
  heat: {delay: 1.0}
actuators:
  pump: {low: 0.0, high: 0.002}
  heater: {low: 0.0, high: 100.0}
joints:
  boiler: {position: heat, effort: heater}
experiments:
  excitations:
    both: {pump: {kind: constant, level: 0.001}, heater: {kind: random_steps, amplitude: 50, hold: 2}}
"""


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


CASES = {
    "no Python": (None, TANK_VALUES, r"has no system\.py"),
    "no values": (TANK, None, r"has no rig\.yaml"),
    "a syntax error": ("x = 1\nclass :", TANK_VALUES, r"system\.py: line 2: SyntaxError"),
    "an error": ("x = 1\ny = x / 0", TANK_VALUES, r"system\.py: line 2: ZeroDivisionError: division by zero"),
    "an import": ("import no_such_module", TANK_VALUES, r"system\.py: line 1: ModuleNotFoundError"),
    "an end": ("import sys\nsys.exit(0)", TANK_VALUES, r"system\.py: line 2: SystemExit"),
    "no system": ("x = 1", TANK_VALUES, r"system\.py: needs one System"),
    "two systems": (TANK + TANK.replace("Tanks(", "Others("), TANK_VALUES, "it has Tanks, Others"),
    "a system that is no data class": (
        TANK.replace("@dataclass(frozen=True, kw_only=True)", ""),
        TANK_VALUES,
        r"Tanks has no @dataclass\(frozen=True, kw_only=True\) above it",
    ),
    "a system without states": (
        "\n".join(line for line in TANK.splitlines() if "states = " not in line),
        TANK_VALUES,
        "Tanks has no states",
    ),
    "a namespace that is none": (TANK, TANK_VALUES + "namespace: my rig!", "namespace is 'my rig!'"),
    "no system in SYSTEM": (TANK + "SYSTEM = 3", TANK_VALUES, "SYSTEM is 3: it needs a System"),
    "a system that can't be made": (
        TANK.replace('unit="m^2")', 'unit="m^2")\n    rest: float'),
        TANK_VALUES,
        "SYSTEM: can't be made: TypeError",
    ),
    "a contact without its velocity": (
        TANK.replace("stepper = RungeKutta()", "contacts = (Dry(on='speed', level=1.0),)").replace(
            "RungeKutta, ", "Dry, "
        ),
        TANK_VALUES,
        r"system\.py: line \d+: Tanks: a contact is on 'speed', which is no state",
    ),
    "structures that are none": (TANK + "STRUCTURES = [Tanks()]", TANK_VALUES, "STRUCTURES is"),
    "a structure of other outputs": (
        TANK
        + TANK.replace("Tanks(", "Others(").replace('"lower", "heat", "in', '"upper", "heat", "in')
        + "SYSTEM = Tanks()\nSTRUCTURES = {'other': Others()}",
        TANK_VALUES,
        "Others has the outputs upper",
    ),
    "no YAML": (TANK, "step: [", "is no valid YAML in line"),
    "a section unknown": (TANK, TANK_VALUES + "colour: red", "unknown key 'colour'"),
    "no step": (TANK, TANK_VALUES.replace("step: 0.1", ""), "step is None"),
    "a step of 0": (TANK, TANK_VALUES.replace("step: 0.1", "step: 0"), "step is 0: it needs more than 0"),
    "a key twice": (TANK, TANK_VALUES + "step: 0.2", r"rig\.yaml: .* line \d+ \(key 'step'"),
    "a gain that is no number": (
        TANK,
        TANK_VALUES + "  loops: {pump: {gain: .nan}}",
        r"rig\.yaml: experiments\.loops\.pump\.gain is nan",
    ),
    "a limit without end": (
        TANK,
        TANK_VALUES.replace("high: 100.0", "high: .inf"),
        r"rig\.yaml: actuators\.heater\.high is inf",
    ),
    "a sensor of no output": (
        TANK,
        TANK_VALUES.replace("  heat: {", "  glow: {"),
        r"sensors\.glow: .* lower, heat, inflow",
    ),
    "an actuator missing": (
        TANK,
        TANK_VALUES.replace("  heater: {low: 0.0, high: 100.0}\n", ""),
        r"actuators\.heater is missing: .*\[W\]",
    ),
    "limits reversed": (
        TANK,
        TANK_VALUES.replace("high: 100.0", "high: -1.0"),
        r"actuators\.heater: low is 0, high -1",
    ),
    "a unit without its scale": (
        TANK,
        TANK_VALUES.replace("unit: mm, scale: 0.001", "unit: mm"),
        r"sensors\.lower: .* give scale, in m per mm",
    ),
    "a scale that is not its unit's": (
        TANK,
        TANK_VALUES.replace("scale: 0.001", "scale: 0.01"),
        r"sensors\.lower: .* scale is 0\.01: .* 0\.001",
    ),
    "a part unknown": (TANK, TANK_VALUES.replace("delay: 1.0", "lag: 1.0"), r"sensors\.heat: unknown key 'lag'"),
    "noise that is text": (TANK, TANK_VALUES.replace("white_noise: 1.0", "white_noise: much"), "it needs a number"),
    "a joint of no state": (
        TANK,
        TANK_VALUES.replace("position: heat", "position: warmth"),
        "'warmth' is none of upper",
    ),
    "a joint of no input": (TANK, TANK_VALUES.replace("effort: heater", "effort: fire"), "'fire' is none of pump"),
    "two joints with one output": (
        TANK,
        TANK_VALUES.replace("effort: heater}", "effort: heater}\n  other: {position: heat}"),
        "heat is carried by another joint already",
    ),
    "an experiment of an unknown kind": (
        TANK,
        TANK_VALUES.replace("kind: constant", "kind: knock"),
        "kind is 'knock': choose one of constant",
    ),
    "an experiment on no input": (
        TANK,
        TANK_VALUES.replace("both: {pump:", "both: {valve:"),
        "'valve' is no input; known are pump, heater",
    ),
    "an experiment without a number": (TANK, TANK_VALUES.replace(", hold: 2", ""), "hold is missing"),
    "a loop on no output": (
        TANK,
        TANK_VALUES + "  loops: {pump: {output: glow, gain: 1}}",
        "'glow' is no output",
    ),
    "a reference that ends before it begins": (
        TANK,
        TANK_VALUES + "references: {r: {duration: 9, segments: {s: {start: 3, stop: 2, kind: constant, level: 1}}}}",
        "its start must lie before its stop",
    ),
    "signals of other names": (
        TANK,
        TANK_VALUES + "signals: {inputs: {u: {topic: a, field: b}}}",
        "signals.inputs are u, the rig's are pump, heater",
    ),
    "signals in another unit": (
        TANK,
        TANK_VALUES + "signals: {inputs: {pump: {topic: a, field: b, unit: l/s}, heater: {topic: a, field: c}}}",
        "is in l/s, the rig's is in m\\^3/s",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_wrong_with_a_folder_is_one_line_with_its_file(make, case):
    system, values, message = CASES[case]
    folder = make(system=system, values=values)
    with pytest.raises(UserError) as chosen_paths:
        rigs.load(folder)
    text = str(chosen_paths.value)
    assert str(folder) in text
    assert "\n" not in text
    assert re.search(message, text), text


def test_the_rigs_of_the_package_load_and_hold_their_numbers():
    for name in folders.names():
        rig = rigs.load(name)
        rig.system.check()
        for structure in rig.structures.values():
            structure.check()
            assert structure.inputs == rig.system.inputs
            assert structure.outputs == rig.system.outputs


def test_the_flexible_joint_rings_at_the_frequency_of_its_spring():
    """Free-free, w^2 = Ke (1/J + 1/I): a small twist of the rig without friction or damping."""
    structures = rigs.load("flexible_joint").structures
    named = structures["linear"].named
    kind: Any = type(structures["linear"])
    joint = kind(viscous_friction=0.0)
    expected = np.sqrt(named["spring"] * (1 / named["motor_inertia"] + 1 / named["link_inertia"])) / (2 * np.pi)
    states = simulate(joint, np.array([0.01, 0.0, 0.0, 0.0]), np.zeros((20_000, 1)), step=1e-4)
    twist = states[:, 0] - states[:, 1]
    crossings = np.flatnonzero((twist[:-1] < 0) & (twist[1:] >= 0)) * 1e-4
    assert 1 / np.mean(np.diff(crossings)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("structure", ["dahl", "lugre"])
def test_bristles_at_rest_give_way_to_a_small_torque(structure):
    """The slope of the motor's speed by the torque is that of a small step, not zero: optimisers begin there."""
    system = rigs.load("flexible_joint").structures[structure]
    n, small = len(system.states), 1e-6
    _, jacobian = step_with_jacobian(system, np.zeros(n), np.zeros(1), step=1e-3, smoothing=0.01)
    moved = one_step(system, np.zeros(n), np.array([small]), step=1e-3) / small
    np.testing.assert_allclose(jacobian[:, n], moved, rtol=1e-4)
    assert moved[2] > 0.0


@pytest.mark.parametrize("name", sorted(folders.names()))
def test_values_of_a_rig_s_nodes_go_together(name: str) -> None:
    for node in declarations():
        assert parameters(name, node)


def test_all_that_is_wrong_with_a_file_is_reported_at_once(make):
    """Each by the key of its section."""
    wrong = "\nspeling: 1\ntravel: {nothing: [0, 1]}\noffsets: {nothing: 1.0}\nnamespace: a b\n"
    folder = make(values=TANK_VALUES + wrong)
    with pytest.raises(UserErrors) as problems:
        rigs.load(folder)
    keys = ("unknown key 'speling'", "namespace is", ": travel", ": offsets")
    assert [sum(key in line for line in problems.value.lines) for key in keys] == [1] * len(keys)
    assert all(line.startswith(f"{folder}/rig.yaml") for line in problems.value.lines)

"""What is wrong with a rig's folder is said in one line with its file."""

import re

import pytest

from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError, UserErrors
from tests.rigs.tank import TANK, TANK_VALUES

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


def test_all_that_is_wrong_with_a_file_is_reported_at_once(make):
    """Each by the key of its section."""
    wrong = "\nspeling: 1\ntravel: {nothing: [0, 1]}\noffsets: {nothing: 1.0}\nnamespace: a b\n"
    folder = make(values=TANK_VALUES + wrong)
    with pytest.raises(UserErrors) as problems:
        rigs.load(folder)
    keys = ("unknown key 'speling'", "namespace is", ": travel", ": offsets")
    assert [sum(key in line for line in problems.value.lines) for key in keys] == [1] * len(keys)
    assert all(line.startswith(f"{folder}/rig.yaml") for line in problems.value.lines)

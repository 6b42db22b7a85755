"""The file that says what to read from a bag."""

from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.bags.signals import Signal, Signals
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("signals: {input: {}}", "signals: unknown key 'input'"),
        ("signals: {outputs: {y: {topic: a, field: b}}}", "signals: inputs is missing"),
        ("signals: {inputs: {u: {topic: a, field: b}}}", "signals: outputs is missing"),
        ("signals: {inputs: {u: {topic: a}}}", r"signals\.inputs\.u: field is missing"),
        ("signals: {inputs: {u: {topic: a, field: b, gain: 2}}}", r"signals\.inputs\.u: unknown key 'gain'"),
        ("signals: {inputs: {u: {topic: a, field: b, scale: two}}}", r"signals\.inputs\.u\.scale is 'two'"),
        ("signals: {inputs: {u: {topic: a, field: b, holds: never}}}", "holds is 'never'"),
        ("signals: {inputs: {u: {topic: a, field: '[0]'}}}", "is no path into a message"),
        ("signals: {inputs: {u: {topic: a, field: 'a..b'}}}", "is no path into a message"),
        ("signals: {inputs: {u: {topic: a, field: 'a[0]b'}}}", "is no path into a message"),
        ("signals: {inputs: [1], outputs: {y: {topic: a, field: b}}}", "inputs needs keys"),
        ("signals: {inputs: {}, outputs: {y: {topic: a, field: b}}}", "at least one input"),
        (
            "signals: {inputs: {u: &s {topic: a, field: b}}, outputs: {y: *s, z: {topic: c, field: b}}}",
            "from one topic",
        ),
        ("signals: {period: -1, inputs: {u: &s {topic: a, field: b}}, outputs: {y: *s}}", "period is -1"),
        ("signals: {period: fast, inputs: {u: &s {topic: a, field: b}}, outputs: {y: *s}}", "period is 'fast'"),
        ("signals: 3", "no section 'signals'"),
        ("namespace: x", "no section 'signals'"),
        ("", "holds no keys"),
        ("a: [", "is no valid YAML in line"),
    ],
)
def test_a_wrong_signals_file_is_named_with_its_key(tmp_path, text, reason):
    path = tmp_path / "signals.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=rf"signals\.yaml: .*{reason}"):
        Signals.load(path)


def test_a_missing_signals_file_or_rig_is_named(tmp_path):
    with pytest.raises(UserError, match="cannot be read"):
        Signals.load(tmp_path / "missing.yaml")
    with pytest.raises(UserError, match=r"known are .*cam_beam"):
        load_rig("no_such_rig")


def test_topics_are_in_the_namespace_unless_absolute():
    signals = load_rig("cam_beam").signals
    assert signals.topic(signals.output[0]) == "/cam_beam/joint_states"
    assert signals.topic(Signal(topic="/tf", field="data")) == "/tf"
    assert signals.topic(Signal(topic="a/b", field="data")) == "/cam_beam/a/b"


def read_in(unit: str, folder: Path, name: str = "position") -> list[Record]:
    """The shipped multisine by signals that state a unit of the output."""
    output = f"{{topic: joint_states, field: 'position[beam]', {unit}}}"
    path = folder / "own.yaml"
    path.write_text(
        "namespace: cam_beam\n"
        "signals:\n"
        "  inputs: {drive: {topic: joint_states, field: 'effort[beam]', unit: V}}\n"
        f"  outputs: {{{name}: {output}}}\n"
    )
    bag = Path(__file__).parents[1] / "bags" / "beam_multisine"
    return read_records([bag], "cam_beam", path, False, 0.0, "averaged")


def test_an_output_in_another_unit_than_the_rig_s_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"own\.yaml: outputs position\[beam\] is in deg, the rig's is in rad: .*scale"):
        read_in("unit: deg", tmp_path)


def test_signals_of_other_names_than_the_rig_s_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"own\.yaml: signals\.outputs are height, the rig's are position"):
        read_in("unit: rad", tmp_path, "height")


def test_a_unit_is_that_of_the_scaled_value(tmp_path):
    """A driver of degrees, say: the scale makes radians of them."""
    plain, scaled = read_in("scale: 1.0", tmp_path), read_in("unit: rad, scale: 0.017453292519943295", tmp_path)
    assert np.allclose(np.degrees(scaled[0].output), plain[0].output)

"""The file that says what to read from a bag."""

import pytest

from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.signals import Signal, Signals


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("signals: {inputs: {}}", "signals: unknown key 'inputs'"),
        ("signals: {output: {topic: a, field: b}}", r"signals\.input: is missing"),
        ("signals: {input: {topic: a, field: b}}", r"signals\.output: is missing"),
        ("signals: {input: {topic: a}}", r"signals\.input: field is missing"),
        ("signals: {input: {topic: a, field: b, gain: 2}}", r"signals\.input: unknown key 'gain'"),
        ("signals: {input: {topic: a, field: b, scale: two}}", r"signals\.input\.scale is 'two'"),
        ("signals: {input: {topic: a, field: b, holds: never}}", "holds is 'never'"),
        ("signals: {input: {topic: a, field: '[0]'}}", "is no path into a message"),
        ("signals: {input: {topic: a, field: 'a..b'}}", "is no path into a message"),
        ("signals: {input: {topic: a, field: 'a[0]b'}}", "is no path into a message"),
        ("signals: {input: [], output: {topic: a, field: b}}", "at least one input"),
        ("signals: {input: &s {topic: a, field: b}, output: [*s, {topic: c, field: b}]}", "from one topic"),
        ("signals: {period: -1, input: &s {topic: a, field: b}, output: *s}", "period is -1"),
        ("signals: {period: fast, input: &s {topic: a, field: b}, output: *s}", "period is 'fast'"),
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
        Signals.of_rig("no_such_rig")


def test_topics_are_in_the_namespace_unless_absolute():
    signals = Signals.of_rig("cam_beam")
    assert signals.topic(signals.output[0]) == "/cam_beam/joint_states"
    assert signals.topic(Signal(topic="/tf", field="data")) == "/tf"
    assert signals.topic(Signal(topic="a/b", field="data")) == "/cam_beam/a/b"

"""Documents of YAML, of which none brings its reader down."""

import random

import pytest

from benchmarks.fuzz import crafted
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.support import yaml_text
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import read_mapping


@pytest.mark.parametrize("seed", range(60))
def test_no_document_of_yaml_brings_its_reader_down(tmp_path, seed):
    path = tmp_path / "some.yaml"
    path.write_bytes(crafted.document(random.Random(seed)))
    for read in (read_mapping, Signals.load):
        line = ""
        try:
            read(path)
        except UserError as error:
            line = str(error)
        assert line.isprintable()


@pytest.mark.parametrize("snippet", crafted.SNIPPETS)
def test_no_value_of_yaml_brings_its_reader_down(tmp_path, snippet):
    text = f"signals:\n  inputs: {snippet}\n  outputs: {{y: {{topic: a, field: {snippet}}}}}\n"
    (tmp_path / "signals.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(UserError) as caught:
        Signals.load(tmp_path / "signals.yaml")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "text",
    ["a: &x [*x]", "a: !!int abc", "{" * 5000, "a: 1\na: 2", "a: !!timestamp 2024-13-45", "a: " + "1" * 101, "a: *b"],
)
def test_what_is_no_plain_data_is_refused(text):
    with pytest.raises(yaml_text.TextError):
        yaml_text.parsed(text)


def test_a_date_is_text_and_an_alias_what_it_stands_for():
    assert yaml_text.parsed("a: &x [1, 2e3]\nb: *x\nc: 2024-13-45") == {"a": [1, 2e3], "b": [1, 2e3], "c": "2024-13-45"}
    assert yaml_text.parsed("a: &x {k: 1}\nb: {<<: *x, l: 2}")["b"] == {"k": 1, "l": 2}


def test_values_are_counted_as_often_as_aliases_repeat_them():
    levels = [f"k{k}: &k{k} [{', '.join([f'*k{k - 1}'] * 10)}]" for k in range(1, 4)]
    assert len(yaml_text.parsed("\n".join(["k0: &k0 [a]", *levels]))["k3"]) == 10
    levels = [f"k{k}: &k{k} [{', '.join([f'*k{k - 1}'] * 10)}]" for k in range(1, 6)]
    with pytest.raises(yaml_text.TextError):
        yaml_text.parsed("\n".join(["k0: &k0 [a]", *levels]))


def test_an_excitation_s_kind_is_a_text():
    with pytest.raises(UserError):
        Excitation.of({"kind": ["steps"]}, "here")

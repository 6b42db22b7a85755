"""python -m studies.beam_lecture: what a user types, and the one line that a wrong input gets."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from hybrid_sysid_ros.models import load
from studies.beam_lecture import __main__ as study
from studies.beam_lecture import comparison
from tests.command_line import PLACES, refused, refused_place

SHIPPED = Path(__file__).parents[2] / "bags"
BAGS = "bags"
"""The beam's among them, in the folder where a test runs."""


@pytest.fixture(autouse=True)
def bags(tmp_path_factory, monkeypatch):
    """A folder with the beam's bags only: a protocol takes all that it finds."""
    place = tmp_path_factory.mktemp("protocol")
    (place / BAGS).mkdir()
    for bag in SHIPPED.glob("beam_*"):
        (place / BAGS / bag.name).symlink_to(bag)
    monkeypatch.chdir(place)


@pytest.fixture
def command(call):
    """Run the study's program with arguments; give status, standard output and standard error."""
    return partial(call, study.main, "python -m studies.beam_lecture")


def test_a_protocol_of_the_shipped_bags_is_printed_written_and_its_pick_saved(command, tmp_path):
    results, model = tmp_path / "results.json", tmp_path / "model"
    arguments = ["--structure", "linear", "--structure", "stribeck", "--jobs", "1", "--json", results, "--out", model]
    status, out, error = command("protocol", "1", BAGS, *arguments)
    assert status == 0, error
    assert "free-run R2, protocol 1, averaged input" in out
    assert "chosen by training data only" in out
    content = json.loads(results.read_text())
    assert set(content["linear"]) == {"beam_multisine", "beam_random_steps", "beam_swept_sine"}
    assert content["chosen"] in ("linear", "stribeck")
    assert content["protocol"] == 1
    assert content["failed"] == {}
    for name in ("linear", "stribeck"):
        values = content[name]["beam_multisine"]
        assert values["min"] <= values["mean"] <= values["max"] <= 1.0
        assert content["validation"][name]["parameters"] == {"linear": 5, "stribeck": 8}[name]
    assert load(model).structure == content["chosen"]
    assert set(load(model).fit["choice"]["structures"]) == {"linear", "stribeck"}


@pytest.mark.slow
def test_an_interrupted_protocol_writes_what_is_finished_and_goes_on_from_there(command, tmp_path, monkeypatch):
    results, page, model = (tmp_path / name for name in ("results.json", "page.html", "model"))
    arguments = ["protocol", "1", BAGS, "--jobs", "1", "--json", results, "--report", page, "--out", model]
    arguments += ["--structure", "linear", "--structure", "stribeck"]
    work = comparison.work

    def interrupt_before_stribeck(task):
        if task.structure == "stribeck":
            raise KeyboardInterrupt
        return work(task)

    with monkeypatch.context() as patch:
        patch.setattr(comparison, "work", interrupt_before_stribeck)
        status, out, error = command(*arguments)
    assert status == 130
    assert "interrupted: 1 of 2 structures are finished" in " ".join(error.split())
    assert "the same command goes on from there" in " ".join(error.split())
    assert "interrupted: without stribeck" in out
    assert "chosen" not in out
    content = json.loads(results.read_text())
    assert (content["partial"], content["missing"], content["chosen"]) == (True, ["stribeck"], "")
    assert "beam_multisine" in content["linear"]
    assert "interrupted: without stribeck" in page.read_text()
    assert not model.exists()

    status, out, error = command(*arguments)
    assert status == 0, error
    again = json.loads(results.read_text())
    assert (again["partial"], again["missing"], again["kept"]) == (False, [], ["linear"])
    assert again["linear"] == content["linear"]
    assert load(model).structure == again["chosen"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model", "page.html", "results.json"]


def test_a_protocol_that_is_interrupted_at_once_says_so(command, monkeypatch):
    def interrupt(task):
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison, "work", interrupt)
    status, out, error = command("protocol", "1", BAGS, "--jobs", "1", "--structure", "linear")
    assert (status, out) == (130, "")
    assert "interrupted: 0 of 1 structures are finished; give --json" in " ".join(error.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["3", BAGS], ["protocol 3"]),
        (["1", "nowhere"], ["nowhere"]),
        (["1", BAGS, "--structure", "banana"], ["banana", "linear"]),
        (["1", BAGS, "--option", "input_bias"], ["input_bias", "NAME=NUMBER"]),
        (["1", BAGS, "--structure", "linear", "--option", "input_bias=1"], ["input_bias = 1 is outside 0 to 0.05"]),
        (["1", BAGS, "--option", "starts=2"], ["has no option starts"]),
        (["1", BAGS, "--input", "guessed"], ["guessed", "averaged", "sampled"]),
        (["1", BAGS, "--period", "0.033"], ["0.033"]),
        (["1", BAGS, "--step", "nan"], ["nan"]),
    ],
)
def test_a_wrong_argument_of_protocol_gets_one_line(command, arguments, words):
    refused(command("protocol", *arguments), *words)


def test_a_protocol_of_an_empty_folder_gets_one_line(command, tmp_path):
    refused(command("protocol", "1", tmp_path), tmp_path)


def test_a_protocol_says_at_once_where_it_cannot_write(command, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    refused(command("protocol", "1", BAGS, "--structure", "linear", "--out", tmp_path), str(tmp_path))


@pytest.mark.parametrize("option", ["--out", "--json", "--report"])
@PLACES
def test_a_protocol_says_where_it_cannot_write_before_anything_else(command, tmp_path, monkeypatch, option, place):
    refused_place(command, tmp_path, place, ("protocol", "1", "nowhere", option, "PLACE"), monkeypatch)


def test_a_folder_without_records_gets_one_line(command, tmp_path):
    refused(command("import", tmp_path, tmp_path / "bags"), tmp_path)
    refused(command("demo", tmp_path, "--out", tmp_path / "out"), tmp_path)


def test_the_study_lists_its_commands(command):
    status, out, _ = command("--help")
    assert status == 0
    for name in ("import", "protocol", "demo"):
        assert name in out
        assert command(name, "--help")[0] == 0

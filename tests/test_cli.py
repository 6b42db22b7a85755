"""The command line: what a user types, and the one line that a wrong input gets."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from hybrid_sysid_ros.bags import read
from hybrid_sysid_ros.commands import identify as identify_command
from hybrid_sysid_ros.models import load, storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.parameters import shipped
from hybrid_sysid_ros.runtime.run import Run, RunResult
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import Interrupted
from tests.command_line import PLACES, refused, refused_place

BAGS = Path(__file__).parents[1] / "bags"
MULTISINE = str(BAGS / "beam_multisine")


def test_a_gray_box_of_the_shipped_bags_predicts_a_bag_that_it_has_not_seen(command, tmp_path):
    # The bags come from the simulated beam itself, so its own equation must explain nearly all of them.
    model = tmp_path / "gray"
    bags = [BAGS / "beam_multisine", BAGS / "beam_random_steps"]
    status, out, _ = command("identify", *bags, "--structure", "gray", "--part", "0:0.5", "--out", model)
    assert status == 0
    assert "gain" in out
    status, out, _ = command("evaluate", model, BAGS / "beam_swept_sine", "--json")
    assert status == 0
    assert json.loads(out)["records"]["beam_swept_sine"]["r2"] > 0.99


def test_a_closed_loop_is_scored_beside_the_free_run(command, linear_model):
    """Where feedback acts on it the error of a poor model stays small; without a reference there is no loop."""
    status, out, error = command("evaluate", linear_model, BAGS / "beam_random_steps", "--json")
    assert status == 0, error
    scores = json.loads(out)["records"]["beam_random_steps"]
    assert scores["closed_loop"]["rmse"] < 0.5 * scores["rmse"]
    status, out, _ = command("evaluate", linear_model, BAGS / "beam_random_steps")
    assert "closed loop R2" in out
    assert f"{scores['closed_loop']['r2']:.4f}" in out


def test_a_score_over_training_samples_is_doubted(command, linear_model):
    part = "0:0.2"  # of what it was trained on
    status, out, _ = command("evaluate", linear_model, MULTISINE, "--part", part)
    assert status == 0
    assert "beam_multisine trained this model" in out
    assert "trained this model" not in command("evaluate", linear_model, BAGS / "beam_random_steps")[1]


def test_evaluate_prints_the_free_run_without_and_with_the_bias_of_its_beginning(command, linear_model, tmp_path):
    bag, page = BAGS / "beam_random_steps", tmp_path / "page.html"
    status, out, error = command("evaluate", linear_model, bag, "--adapt", 5, "--json", "--report", page)
    assert status == 0, error
    reported = json.loads(out)["records"]["beam_random_steps"]["adapted"]
    assert reported["seconds"] == 5.0
    assert set(reported["bias"]) == {"drive"}
    status, out, _ = command("evaluate", linear_model, bag, "--adapt", 5)
    assert f"{reported['without']['r2']:.4f}" in out
    assert f"{reported['adapted']['r2']:.4f}" in out
    assert f"{reported['adapted']['r2']:.4f}" in page.read_text(encoding="utf-8")
    assert (
        "adapted" not in json.loads(command("evaluate", linear_model, bag, "--json")[1])["records"]["beam_random_steps"]
    )


def test_a_bias_of_an_unstable_model_is_not_looked_for(command):
    refused(
        command("evaluate", shipped("winged_cone", "model"), BAGS / "winged_cone_flight", "--adapt", 5),
        "unstable",
        "leave out --adapt",
    )


def test_a_record_without_reference_has_no_closed_loop(command, linear_model, tmp_path):
    signals = {
        "inputs": {"drive": {"topic": "joint_states", "field": "effort[beam]", "unit": "V"}},
        "outputs": {"position": {"topic": "joint_states", "field": "position[beam]", "unit": "rad"}},
    }
    plain = tmp_path / "plain.yaml"
    plain.write_text(yaml.safe_dump({"namespace": "cam_beam", "signals": signals}))
    status, out, error = command("evaluate", linear_model, MULTISINE, "--signals", plain)
    assert status == 0, error
    assert "no closed loop: beam_multisine: has no channel reference" in " ".join(error.split())
    assert "closed loop" not in out
    _, out, _ = command("evaluate", linear_model, MULTISINE, "--signals", plain, "--json")
    assert json.loads(out)["records"]["beam_multisine"]["closed_loop"] is None


def test_a_bag_can_be_read_at_a_longer_period(command, tmp_path):
    """The same model comes of it as of the means of all samples, which the steps of 50 ms are either way."""
    models = [tmp_path / name for name in ("all", "kept")]
    arguments = ["identify", MULTISINE, "--structure", "linear", "--step", "0.05"]
    for model, more in zip(models, ([], ["--read-period", "0.05"]), strict=True):
        status, _, error = command(*arguments, *more, "--out", model)
        assert status == 0, error
    one, two = (load(model).system for model in models)
    assert two.values == pytest.approx(one.values, rel=0.02)
    refused(command(*arguments, "--read-period", "0.05", "--input", "sampled", "--out", tmp_path / "m"), "sampled")
    refused(command(*arguments, "--read-period", "0.0333", "--out", tmp_path / "m"), "0.0333")


def test_a_model_tells_where_it_comes_from(linear_model):
    content = yaml.safe_load((linear_model / "model.yaml").read_text())
    assert content["records"][0]["name"] == "beam_multisine"
    assert len(content["records"][0]["sha256"]) == 64
    assert content["parameters"]["velocity_per_drive"]["unit"] == "rad/s^2/V"
    assert content["parameters"]["velocity_per_drive"]["standard_error"] > 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], ["nowhere"]),
        ([MULTISINE, MULTISINE], ["beam_multisine"]),
        ([MULTISINE, "--structure", "banana"], ["banana", "hybrid"]),
        ([MULTISINE, "--rig", "trebuchet"], ["trebuchet", "cam_beam"]),
        ([MULTISINE, "--period", "0.033"], ["0.033"]),
        ([MULTISINE, "--period", "nan"], ["nan"]),
        ([MULTISINE, "--step", "inf", "--period", "inf"], ["inf"]),
        ([MULTISINE, "--step", "1e-9"], ["1e-09"]),
        ([MULTISINE, "--input", "guessed"], ["guessed", "averaged", "sampled"]),
        ([MULTISINE, "--initial", "still"], ["still", "estimated", "rest"]),
        ([MULTISINE, "--structure", "linear", "--initial", "speed=1"], ["speed", "position, velocity"]),
        ([MULTISINE, "--part", "half"], ["half"]),
        ([MULTISINE, "--part", "0:0.001"], ["beam_multisine"]),
        ([MULTISINE, "--signals", "none.yaml"], ["none.yaml"]),
        ([MULTISINE, "--option", "colour=1"], ["hybrid", "colour", "units", "creep"]),
        ([MULTISINE, "--structure", "linear", "--option", "creep=1"], ["linear", "creep"]),
        ([MULTISINE, "--option", "units=1000"], ["units", "1000", "32"]),
        ([MULTISINE, "--option", "units=2.5"], ["units", "2.5"]),
        ([MULTISINE, "--option", "creep=nan"], ["creep", "nan"]),
        ([MULTISINE, "--option", "units"], ["units"]),
        ([MULTISINE, "--option", "units=many"], ["units=many"]),
    ],
)
def test_a_wrong_argument_of_identify_gets_one_line(command, tmp_path, arguments, words):
    refused(command("identify", *arguments, "--out", tmp_path / "model"), *words)
    assert not (tmp_path / "model").exists()


def test_a_score_begins_as_it_is_asked_to(command, linear_model):
    scores = []
    for options in ([], ["--initial", "first"], ["--initial", "position=0.2"], ["--warm-up", "100"]):
        status, out, error = command("evaluate", linear_model, MULTISINE, *options, "--json")
        assert status == 0, error
        found = json.loads(out)["records"]["beam_multisine"]
        scores.append(found["r2"])
        assert 0.0 < found["bands"]["0.5"]["position"]["half"] < found["bands"]["0.9"]["position"]["half"]
    assert len(set(scores)) == 4
    assert scores[2] < scores[0]
    refused(command("evaluate", linear_model, MULTISINE, "--warm-up", "100000"), "warm-up", "100000")


def test_runs_that_are_numbered_behind_a_dot_are_two(command, tmp_path):
    runs = [tmp_path / "run.1", tmp_path / "run.2", tmp_path / "again" / "run.1"]
    for run in runs:
        shutil.copytree(MULTISINE if run.suffix == ".1" else BAGS / "beam_random_steps", run)
    arguments = ["--structure", "linear", "--part", "0:0.2", "--out", tmp_path / "model"]
    status, out, error = command("identify", *runs[:2], *arguments)
    assert status == 0, error
    assert "run.1" in out
    assert "run.2" in out
    refused(command("identify", *runs, *arguments, "--overwrite"), "run.1")


def test_an_option_puts_a_doubtful_term_into_the_gray_box(command, tmp_path):
    arguments = ["--structure", "gray", "--part", "0:0.3", "--step", "0.01"]
    for name, options in (("plain", []), ("creeping", ["--option", "creep=1"])):
        status, _, error = command("identify", MULTISINE, *arguments, *options, "--out", tmp_path / name)
        assert status == 0, error
    plain, creeping = load(tmp_path / "plain"), load(tmp_path / "creeping")
    assert "creep" not in plain.names
    assert "creep" in creeping.names
    assert (plain.fit["options"]["creep"], creeping.fit["options"]["creep"]) == (0, 1)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (KeyboardInterrupt(), "interrupted"),
        (Interrupted("3 loops are kept in out.part"), "interrupted: 3 loops are kept in out.part"),
    ],
)
def test_an_interrupted_command_says_so_in_one_line(command, tmp_path, monkeypatch, error, line):
    def interrupt(*_, **__):
        raise error

    monkeypatch.setattr(identify_command, "identify", interrupt)
    status, out, said = command("identify", MULTISINE, "--out", tmp_path / "model")
    assert (status, out, said) == (130, "", f"{line}\n")


@pytest.mark.parametrize(("kept", "line"), [(False, "interrupted"), (True, "interrupted: {} holds what was recorded")])
def test_an_interrupted_run_says_whether_there_is_a_bag(command, tmp_path, monkeypatch, kept, line):
    bag = tmp_path / "bag"
    if kept:
        bag.mkdir()
    monkeypatch.setattr(Run, "go", lambda _: RunResult(diagnostics={}, interrupted=True, bag=bag))
    assert command("run", "--bag", bag) == (130, "", f"{line.format(bag)}\n")


@pytest.mark.parametrize(
    "arguments",
    [
        ("identify", "nowhere", "--out", "PLACE"),
        ("evaluate", "nowhere", "nowhere", "--report", "PLACE"),
        ("run", "--model", "nowhere", "--bag", "PLACE"),
        ("simulate", "multisine", "PLACE", "--duration", "3600"),
    ],
    ids=lambda arguments: f"{arguments[0]} {arguments[-2]}",
)
@PLACES
def test_a_command_says_where_it_cannot_write_before_anything_else(command, tmp_path, monkeypatch, arguments, place):
    """Even before what it is to work on, which is not there either."""
    refused_place(command, tmp_path, place, arguments, monkeypatch)


def test_a_bag_that_is_there_is_not_recorded_over_unasked(command):
    refused(command("run", "--model", "nowhere", "--bag", MULTISINE), "beam_multisine")


def test_a_model_is_not_put_in_place_of_the_current_folder(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(command("identify", MULTISINE, "--structure", "linear", "--out", "."), "current folder")


def test_a_folder_of_something_else_is_not_overwritten(command, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    refused(command("identify", MULTISINE, "--structure", "linear", "--out", tmp_path), str(tmp_path))
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_an_old_model_stays_unless_it_is_to_be_replaced_by_one_that_is_made(command, linear_model, tmp_path):
    model = tmp_path / "model"
    shutil.copytree(linear_model, model)
    before = (model / "model.yaml").read_bytes()
    refused(command("identify", MULTISINE, "--structure", "linear", "--out", model), "--overwrite")
    refused(command("identify", tmp_path / "nowhere", "--out", model, "--overwrite"), "nowhere")
    assert (model / "model.yaml").read_bytes() == before


def test_an_altered_model_is_refused(command, linear_model, tmp_path):
    model = tmp_path / "model"
    shutil.copytree(linear_model, model)
    text = (model / "model.yaml").read_text()
    (model / "model.yaml").write_text(text.replace("rig: cam_beam", "rig: cam_dream"))
    refused(command("evaluate", model, MULTISINE), "model.yaml", "altered")


def test_a_truncated_bag_is_readable_on_request(command, linear_model, tmp_path):
    bag = tmp_path / "cut"
    shutil.copytree(MULTISINE, bag)
    file = next(bag.glob("*.mcap"))
    content = file.read_bytes()
    file.write_bytes(content[: len(content) * 2 // 3])
    refused(command("evaluate", linear_model, bag), "cut", "--recover")
    status, _, error = command("evaluate", linear_model, bag, "--recover")
    assert status == 0, error


def test_a_policy_of_another_model_is_refused(linear_model):
    from hybrid_sysid_ros.control.policy import policy
    from hybrid_sysid_ros.runtime import configuration
    from hybrid_sysid_ros.support.errors import UserError

    with pytest.raises(UserError, match="another model"):
        policy.load(configuration.shipped("cam_beam", "policy"), model=load(linear_model))
    assert policy.load(configuration.shipped("cam_beam", "policy")).model == storage.digest(
        configuration.shipped("cam_beam", "model"), kind="model"
    )


def test_signals_are_played_at_the_next_rate_that_a_slow_rig_has(command, tmp_path):
    folder, signals = tmp_path / "slow", tmp_path / "signals.csv"
    folder.mkdir()
    (folder / "system.py").write_text(
        "from dataclasses import dataclass\n\nfrom hybrid_sysid_ros.core import System, bounded\n\n\n"
        "@dataclass(frozen=True, kw_only=True)\nclass Slow(System):\n"
        '    states = ("level [m]",)\n    inputs = ("valve [1]",)\n    lag: float = bounded(2.0, 0.1, 9.0, unit="s")\n'
        "    def law(self, x, u):\n        return [(u[0] - x[0]) / self.lag]\n"
    )
    (folder / "rig.yaml").write_text(
        "step: 0.1\nsensors: {level: {white_noise: 0.01}}\nactuators: {valve: {low: -1.0, high: 1.0}}\n"
    )
    signals.write_text("time [s],valve [1]\n" + "".join(f"{0.1 * k:.1f},{k % 7 / 7:.3f}\n" for k in range(101)))
    status, shown, error = command("simulate", signals, tmp_path / "bag", "--rig", folder)
    assert (status, error) == (0, ""), shown
    record = read(tmp_path / "bag", load_rig(folder).signals)
    assert record.sampling_time == pytest.approx(0.1)


def test_an_unknown_experiment_gets_one_line(command, tmp_path):
    refused(command("simulate", "earthquake", tmp_path / "bag"), "earthquake", "multisine")
    refused(command("simulate", "multisine", tmp_path / "bag", "--rate", "300"), "300")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("identify", MULTISINE), ["--out", "see hybrid-sysid identify --help"]),
        (("identify", "--out", "model"), ["missing argument", "see hybrid-sysid identify --help"]),
        (("identify", MULTISINE, "--out", "model", "--seed", "-1"), ["--seed", "see hybrid-sysid identify --help"]),
        (("identify", MULTISINE, "--out", "model", "--step", "five"), ["--step", "valid"]),
        (("identify", MULTISINE, "--color", "red"), ["--color", "see hybrid-sysid identify --help"]),
        (("policy", "banana"), ["banana", "see hybrid-sysid policy --help"]),
        (("banana",), ["banana", "see hybrid-sysid --help"]),
        (("--banana",), ["--banana", "see hybrid-sysid --help"]),
    ],
)
def test_wrong_options_get_one_line_as_everything_else(command, arguments, words):
    refused(command(*arguments), *words)


@pytest.mark.parametrize("arguments", [(), ("rig",)])
def test_no_arguments_get_the_help(command, arguments):
    _, out, error = command(*arguments)
    helped = command(*arguments, "--help")
    assert helped[0] == 0
    assert "check" in helped[1] or "identify" in helped[1]
    assert (out + error).strip() == helped[1].strip()


COMMANDS = [words.split() for words in extensions.commands()]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_that_is_listed_can_be_called(command, words):
    assert words[-1] in command(*words[:-1], "--help")[1]
    status, out, _ = command(*words, "--help")
    assert status == 0
    assert f"hybrid-sysid {' '.join(words)} " in out


def test_the_list_of_commands_loads_none_of_them():
    code = "import sys; from hybrid_sysid_ros.__main__ import main\ntry: main()\nfinally: print(*sys.modules)"
    end = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True)
    assert "identify" in end.stdout
    assert {"numba", "numpy", "rosbags", "scipy", "torch"}.isdisjoint(end.stdout.splitlines()[-1].split())


def test_a_parameter_file_is_replaced_only_on_request(command, tmp_path):
    file = tmp_path / "cam_beam.yaml"
    file.write_text("mine")
    refused(command("parameters", "--out", file), file, "--overwrite")
    assert command("parameters", "--out", file, "--overwrite")[0] == 0
    assert "ros__parameters" in file.read_text()


def test_what_was_identified_is_there_as_json(command, tmp_path):
    arguments = ["--structure", "linear", "--step", "0.05", "--part", "0:0.3", "--out", tmp_path / "model", "--json"]
    status, out, _ = command("identify", MULTISINE, *arguments)
    assert status == 0
    found = json.loads(out)
    assert found["structure"] == "linear"
    assert {"value", "standard_error", "unit"} == set(next(iter(found["parameters"].values())))
    assert 0.5 < next(iter(found["scores"].values()))["r2"] <= 1.0

"""The public sets: their splits, the adapters to their loaders, and a choice in which tests have no say."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import all_tables
from hybrid_sysid_ros.support.errors import UserError
from studies.public import __main__ as program
from studies.public import identibench, loader, study
from studies.public.sets import PublicSet, read


def simulated(samples=400, seed=0):
    random = np.random.default_rng(seed)
    inputs, outputs = random.normal(size=samples), np.zeros(samples)
    for k in range(samples - 1):
        outputs[k + 1] = 0.8 * outputs[k] + 0.5 * inputs[k]
    return inputs, outputs


@pytest.fixture
def folder(tmp_path):
    """Files of the drives in the form in which they are published."""
    place = tmp_path / "coupled_drives"
    place.mkdir()
    for part in ("train", "test"):
        inputs, outputs = simulated(500, seed=len(part))
        for letter, values in (("X", inputs), ("Y", np.abs(outputs))):
            (place / f"{letter}_{part}.txt").write_text('"x"\n' + "\n".join(f"{value:.6g}" for value in values))
    return tmp_path


def test_the_official_splits_of_the_drives_and_their_starts(folder):
    public = read("drives", folder)
    assert [record.samples for record in (*public.train, *public.tests)] == [400, 400, 100, 100]
    assert (public.sampling.initial_samples, public.sampling.warm_up) == (10, 10)
    assert public.rig.system.outputs[0].unit == "ticks/s"


def test_the_silverbox_and_the_tanks_are_cut_as_published(data: Path):
    silverbox, tanks = read("silverbox", data / "public"), read("tanks", data / "public")
    assert [record.samples for record in silverbox.train] == [65062]
    assert [record.samples for record in silverbox.tests] == [21688, 40475, 32000]
    assert [record.samples for record in (*tanks.train, *tanks.tests)] == [1024, 1024]


def test_files_that_are_missing_or_of_another_kind_are_named(folder):
    with pytest.raises(UserError, match="silverbox"):
        read("silverbox", folder)
    with pytest.raises(UserError, match="dataBenchmark"):
        read("tanks", folder)
    (folder / "coupled_drives" / "X_train.txt").write_text("x\nnothing\n")
    with pytest.raises(UserError, match="X_train"):
        read("drives", folder)
    with pytest.raises(UserError, match="no public set"):
        read("robots", folder)


def test_the_simplest_of_about_equal_candidates_is_chosen():
    assert study.preferred([]) == 0
    assert study.preferred([0.9, 0.99, 0.99005]) == 1
    assert study.preferred([0.99, -1.0]) == 0


def test_what_is_finished_is_not_done_again(folder, tmp_path, call, monkeypatch):
    fits = []

    def row(public: PublicSet, structure, candidates, seeds):
        fits.append(structure)
        return study.Row(structure=structure, options={}, validation=[], training=[[1.0]], tests=[[0.1, 0.2]])

    monkeypatch.setattr(study, "_row", row)
    out = tmp_path / "found.json"
    arguments = ("run", str(folder), "--set", "drives", "--json", str(out))
    for _ in range(2):
        status, shown, _ = call(program.main, "python -m studies.public", *arguments)
        assert status == 0
        assert "0.084" in shown  # what is asked for
    assert fits == [structure for structure, _ in study.KINDS["drives"].values()]
    monkeypatch.setattr(study, "package_digest", lambda: "of changed sources")
    assert call(program.main, "python -m studies.public", *arguments)[0] == 0
    assert fits[3:] == fits[:3]
    assert set(json.loads(out.read_text())["drives"]) == set(study.KINDS["drives"])


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--set", "robots"), "no public set robots"),
        (("--kind", "magic"), "no kind magic"),
        (("--source", "web"), "no source web"),
    ],
)
def test_what_is_not_there_is_refused_in_a_line(folder, call, arguments, reason):
    status, _, error = call(program.main, "python -m studies.public", "run", str(folder), *arguments)
    assert status == 2
    assert reason in error
    assert error.count("\n") == 1


def test_sets_of_the_loader_become_records():
    inputs, outputs = simulated()
    data = [SimpleNamespace(u=inputs, y=outputs, sampling_time=0.02, name="train")]
    (record,) = loader.records_of(data)
    np.testing.assert_array_equal(record.output[:, 0], outputs)
    assert record.sampling_time == pytest.approx(0.02)
    with pytest.raises(UserError, match="one column"):
        loader.records_of([SimpleNamespace(u=np.zeros((9, 2)), y=outputs[:9], sampling_time=0.02, name="two")])


@pytest.mark.slow
def test_a_specification_of_identibench_gets_a_predictor():
    """As its run_benchmark asks for one: the inputs and a few outputs in, all outputs out."""
    train, test = simulated(600), simulated(300, seed=5)
    specification = SimpleNamespace(
        u_cols=["u0"], y_cols=["y0"], train_valid=None, task=SimpleNamespace(init_window=20)
    )
    sequence = SimpleNamespace(u=train[0][:, None], y=train[1][:, None], attrs={})
    context = SimpleNamespace(
        spec=specification, hyperparameters={"order": 2}, seed=1, get_train_sequences=lambda: [sequence]
    )
    predicted = identibench.build_model(context)(test[0][:, None], test[1][:20, None], {})
    assert predicted.shape == (300, 1)
    np.testing.assert_allclose(predicted[20:, 0], test[1][20:], atol=1e-3)


def test_every_benchmark_with_a_published_table_is_made_again():
    pages = [*Path("docs").rglob("*.md"), *Path("hybrid_sysid_ros/extensions").glob("*/docs/*.md")]
    text = " ".join(path.read_text(encoding="utf-8").replace("benchmarks.", "benchmarks ") for path in pages)
    named = {words.split()[0].strip("`.,)|") for words in text.split("python -m benchmarks ")[1:] if words.split()}
    made = {module.removeprefix("benchmarks.") for module in all_tables.TABLES} | {"all-tables"}
    assert {name for name in named if name.isidentifier()} <= made


def test_made_tables_are_kept_until_a_source_changes(tmp_path, monkeypatch):
    monkeypatch.setattr(all_tables, "DONE", tmp_path / "done.json")
    runs = []
    tables = {"benchmarks.a": (), "benchmarks.b": (), "benchmarks.public": (), "studies.c": (all_tables.DATA,)}
    monkeypatch.setattr(all_tables, "TABLES", tables)
    monkeypatch.delenv(all_tables.DATA, raising=False)
    monkeypatch.setattr(all_tables, "digest", lambda: "now")

    def run(command, **_):
        runs.append(command[2])
        return SimpleNamespace(returncode=int(command[2].endswith("b") and len(runs) < 3))

    monkeypatch.setattr(all_tables.subprocess, "run", run)
    assert all_tables.main([]) == 1  # b fails
    assert all_tables.main([]) == 0
    assert runs == ["benchmarks.a", "benchmarks.b", "benchmarks.b"]
    assert all_tables.main(["--again"]) == 0
    assert len(runs) == 5
    assert all_tables.main(["--more"]) == 2
    monkeypatch.setenv(all_tables.DATA, "records")
    assert all_tables.main([]) == 0  # what was skipped without records was not finished
    assert runs[5:] == ["benchmarks.public", "studies.c"]

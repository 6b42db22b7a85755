"""hybrid-sysid accuracy: its files, its page, and what it refuses."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.accuracy.statistics import Discrepancy, assess, read_shots
from hybrid_sysid_ros.extensions.shared.report.charts import logarithmic
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused

DECLARED = ("--mean-off", "0.5", "--spread-off", "0.1")


@pytest.fixture
def accuracy(call):
    return partial(call, app.main, "hybrid-sysid", "accuracy")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With simulated and live shots that agree."""
    generator = np.random.default_rng(0)
    table("simulated.csv", tmp_path, generator.standard_normal((200, 2)))
    table("live.csv", tmp_path, generator.standard_normal((8, 2)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def table(name: str, folder: Path, values: np.ndarray, heading: str = "x [m],y [m]") -> None:
    np.savetxt(folder / name, values, delimiter=",", header=heading, comments="")


def test_json_has_every_number(accuracy, folder: Path):
    (folder / "strata.csv").write_text("success;share\n.2;.3\n.6;.5\n.9;.2\n")
    status, out, error = accuracy(
        "simulated.csv", "live.csv", *DECLARED, "--until", "x=0.5", "--spread-until", "y=0.2", "--strata", "strata.csv",
        "--json",
    )  # fmt: skip
    assert (status, error) == (0, "")
    reported = json.loads(out)
    live = read_shots(folder / "live.csv").values
    assert reported["live_only"]["mean"]["x"]["value"] == pytest.approx(live[:, 0].mean())
    assert reported["simulation_counts_as"]["mean"] == pytest.approx(1 / (1 / 200 + 0.25))
    assert reported["joint"]["circular_error_probable"]["low"] < reported["joint"]["circular_error_probable"]["high"]
    assert [item["of"] for item in reported["further_shots"]] == ["x", "y"]
    assert reported["strata"]["allocation"] == [28, 58, 14]
    assert reported["conflict"]["contradictions"] == []


def test_the_page_shows_every_number_and_needs_no_network(accuracy, folder: Path):
    (folder / "strata.csv").write_text("success;share\n.2;.3\n.6;.5\n.9;.2\n")
    more = ("--until", "x=0.5", "--strata", "strata.csv")
    status, out, _ = accuracy("simulated.csv", "live.csv", *DECLARED, *more, "--report", "out/accuracy.html")
    assert status == 0
    assert "circular error probable about the mean [m]" in out
    page = (folder / "out" / "accuracy.html").read_text(encoding="utf-8")
    for word in (
        "systematic error of x [m]",
        "circular error probable",
        "p-value",
        "live.csv --mean-off 0.5",
        "at most 0.5 m wide",
        "28, 58, 14",
    ):
        assert word in page
    assert page.count('class="plotly-graph-div"') == 5
    places = re.findall(r' id="([^"]*)"', page.rpartition("</head>")[2])
    assert len(places) == len({*places})
    assert "src=" not in page.split("</script>")[-1]


def test_a_file_of_each_kind_holds_the_same_shots(folder: Path):
    values = read_shots("live.csv").values
    named: dict[str, Any] = {"x [m]": values[:, 0], "y [m]": values[:, 1]}
    np.savez("named.npz", **named)
    np.savez("rows.npz", values)
    Path("named.json").write_text(json.dumps({"x [m]": values[:, 0].tolist(), "y [m]": values[:, 1].tolist()}))
    Path("rows.json").write_text(json.dumps(values.tolist()))
    np.savetxt("rows.csv", values, delimiter="\t")
    for name in ("named.npz", "named.json", "rows.npz", "rows.json", "rows.csv"):
        shots = read_shots(name, unit="m")
        assert shots.values == pytest.approx(values)
        assert shots.names == (("x", "y") if name.startswith("named") else ("1", "2"))
        assert shots.units == ("m", "m")


def test_coordinates_go_by_their_names(accuracy, folder: Path):
    live = read_shots("live.csv").values
    table("turned.csv", folder, live[:, ::-1], "y [m],x [m]")
    answers = [accuracy("simulated.csv", name, *DECLARED, "--json")[1] for name in ("live.csv", "turned.csv")]
    assert json.loads(answers[0])["joint"] == json.loads(answers[1])["joint"]


def test_nothing_need_be_believed_of_the_simulated_mean(accuracy, folder: Path):
    """Each interval of a mean is then about as the live shots tell it: only their spread is better known."""
    for off in ("inf", "1e200"):
        status, out, _ = accuracy("simulated.csv", "live.csv", "--mean-off", off, "--spread-off", "0.1", "--json")
        assert status == 0
        reported = json.loads(out)
        assert reported["simulation_counts_as"]["mean"] == 0.0
        assert reported["joint"]["mean"]["x"]["value"] == pytest.approx(reported["live_only"]["mean"]["x"]["value"])
        assert reported["conflict"]["p_mean"] is None


@pytest.mark.parametrize(
    ("factor", "offset", "words"),
    [(1.0, 5.0, ("live mean contradicts", "look for the cause")), (1000.0, 0.0, ("live spread", "the same units"))],
)
def test_shots_that_contradict_the_simulation_are_reported(accuracy, folder: Path, factor, offset, words):
    table("other.csv", folder, factor * read_shots("live.csv").values + offset)
    status, out, error = accuracy("simulated.csv", "other.csv", *DECLARED)
    assert (status, error.count("\n")) == (0, 1)
    assert "together" in out
    for word in words:
        assert word in error


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("x [m],y [m]\n1,2\n3,5\n", ("2 shots", "need 3 at least")),
        ("x [m],z [m]\n1,2\n3,5\n4,4\n", ("coordinates x, z", "the same names")),
        ("x [m],y [mm]\n1,2\n3,5\n4,4\n", ("y is in mm", "convert one")),
        ("x [m],y\n1,2\n3,5\n4,4\n", ("y is in no stated unit", "state the unit")),
        ("x [m],y [m]\n1,2\n3,nan\n4,4\n", ("y of shot 2 is nan", "leave that shot out")),
        ("x [m],y [m]\n1,2\n3,far\n4,4\n", ("y [m] of shot 2 is 'far'",)),
        ("x [m],y [m]\n1,2\n3\n4,4\n", ("shot 2 has 1 numbers",)),
        ("x [m],x [m]\n1,2\n3,5\n4,4\n", ("two columns of one name",)),
        ("x [m],y [m]\n1,2\n1,5\n1,4\n", ("x is the same in all shots",)),
        ("x [m],y [m]\n1,2\n2,4\n4,8\n5,10\n", ("follows from the others",)),
        ("x [m],y [m]\n1,2\n3,1e300\n4,4\n", ("another unit",)),
        ("x [m],y [m]\n", ("0 shots",)),
        ("", ("is empty", "a line of headings")),
        ("x [m],y [m],\n1,2,\n3,5,\n4,4,\n", ("column 3 has no heading", "name or remove it")),
        ("x [m];y [m]\n1;2\n3;4,5\n4;4\n", ("y [m] of shot 2 is '4,5'", "a point before its decimals")),
    ],
)
def test_shots_that_tell_nothing_are_refused(accuracy, folder: Path, content, words):
    (folder / "bad.csv").write_text(content)
    refused(accuracy("simulated.csv", "bad.csv", *DECLARED), "bad.csv", *words)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("bad.npz", b"no archive"),
        ("bad.npz", b""),
        ("bad.json", b"{"),
        ("bad.json", b"3"),
        ("bad.json", b'{"x": [1, [2]]}'),
        ("bad.json", b'{"x": 1}'),
        ("bad.json", b"[" * 100_000),
        ("bad.json", b"[[1, 2], [3]]"),
        ("bad.csv", "x,y\n1,2\n".encode("utf-16")),
        ("bad.mat", b"x"),
        ("missing.csv", None),
        (".", None),
    ],
)
def test_a_file_that_is_none_is_refused_with_what_it_needs(accuracy, folder: Path, name, content):
    if content is not None:
        (folder / name).write_bytes(content)
    _, _, error = answer = accuracy("simulated.csv", name, *DECLARED)
    refused(answer, name)
    assert any(word in error for word in ("for each coordinate", "a row for each shot")), error


def test_an_archive_is_refused_by_what_it_would_take(accuracy, folder: Path):
    """A small one of zeros unpacks to more than is read."""
    np.savez_compressed(folder / "bad.npz", x=np.zeros(1 << 22), y=np.zeros(1 << 22))
    assert (folder / "bad.npz").stat().st_size < 1 << 17
    refused(accuracy("simulated.csv", "bad.npz", *DECLARED), "bad.npz", "64 MiB, more than 32")


def test_an_outlier_is_reported_and_changes_nothing(accuracy, folder: Path):
    values = read_shots("live.csv").values
    values[2, 1] += 50.0
    table("spoilt.csv", folder, values)
    status, out, error = accuracy("simulated.csv", "spoilt.csv", *DECLARED, "--json")
    assert status == 0
    assert "spoilt.csv: shot 3 is an outlier (y of shot 3 is +" in error
    assert json.loads(out)["live_only"]["mean"]["y"]["value"] == pytest.approx(values[:, 1].mean())


def test_a_spread_that_may_be_off_needs_simulated_shots(accuracy, folder: Path):
    table("few.csv", folder, read_shots("simulated.csv").values[:40])
    refused(accuracy("few.csv", "live.csv", *DECLARED), "few.csv", "40 shots", "50 simulated ones")
    assert accuracy("few.csv", "live.csv", "--mean-off", "0.5", "--spread-off", "0")[0] == 0


def test_pickled_shots_are_refused(accuracy, folder: Path):
    np.savez(folder / "bad.npz", x=np.array([1, "a", None], dtype=object))
    refused(accuracy("simulated.csv", "bad.npz", *DECLARED), "bad.npz")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--mean-off", "-1", "--spread-off", "0.1"), ("discrepancy of the mean",)),
        (("--mean-off", "1", "--spread-off", "800"), ("discrepancy of the spread",)),
        ((*DECLARED, "--level", "90"), ("from 0.01 to 0.999",)),
        ((*DECLARED, "--level", "1e-300"), ("from 0.01 to 0.999",)),
        ((*DECLARED, "--level", "0.9999999999999999"), ("from 0.01 to 0.999",)),
        ((*DECLARED, "--strata", "no_strata.csv"), ("there are no strata",)),
        ((*DECLARED, "--strata-shots", "60"), ("--strata", "leave it out")),
        ((*DECLARED, "--strata", "unknown.csv"), ("success of stratum 2 is nan", "leave that stratum out")),
        ((*DECLARED, "--until", "q=1"), ("known are x, y",)),
        ((*DECLARED, "--until", "x=0"), ("NAME=WIDTH",)),
        ((*DECLARED, "--report", "page.txt"), (".html",)),
        ((*DECLARED, "--strata", "live.csv"), ("share and success",)),
        (("--mean-off", "0.5"), ("--spread-off",)),
    ],
)
def test_options_that_say_nothing_are_refused(accuracy, folder: Path, options, words):
    (folder / "no_strata.csv").write_text("share,success\n")
    (folder / "unknown.csv").write_text("share,success\n.5,.3\n.5,nan\n")
    refused(accuracy("simulated.csv", "live.csv", *options), *words)


def test_the_simulation_is_not_taken_for_live_shots(accuracy, folder: Path):
    """Named twice, it would halve every interval."""
    refused(accuracy("simulated.csv", "simulated.csv", *DECLARED), "give the live shots second")


def test_shots_of_a_loop_that_ran_away_are_refused(folder: Path):
    simulated, live = read_shots("simulated.csv"), read_shots("live.csv")
    values = live.values.copy()
    values[3, 1] = np.inf
    with pytest.raises(UserError, match="y of shot 4 is inf: leave that shot out"):
        assess(simulated, replace(live, values=values), Discrepancy(mean=0.5, spread=0.1))


def test_the_page_says_what_to_do_about_a_conflict_and_keeps_the_names_of_coordinates(accuracy, folder: Path):
    for name, offset in (("simulated", 0.0), ("live", 9.0)):
        table(f"{name}.csv", folder, read_shots(f"{name}.csv").values + offset, "Vx,Vy")
    assert accuracy("simulated.csv", "live.csv", *DECLARED, "--report", "accuracy.html")[0] == 0
    alarm = re.search('<p class="alarm">(.*?)</p>', (folder / "accuracy.html").read_text(encoding="utf-8"))
    assert alarm is not None
    assert re.match("The live mean contradicts the simulation .*; V[xy] is off", alarm[1])
    assert "look for the cause" in alarm[1]


@pytest.mark.parametrize("ends", [(0.3, 30.0), (0.55, 0.9), (2e-7, 5e7), (1.0, 1.0)])
def test_a_logarithmic_axis_has_some_numbers_and_not_too_many(ends):
    ticks = logarithmic(*ends)
    assert 2 <= len(ticks["tickvals"]) <= 16
    assert all(ends[0] <= float(value) <= ends[1] for value in ticks["tickvals"])
    assert [float(text) for text in ticks["ticktext"]] == pytest.approx(ticks["tickvals"], rel=0.01)

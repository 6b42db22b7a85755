"""The mock-up: shots repeat and agree where model and rig are one, and the way from a prior to a verdict."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.accuracy.loop_measures import loop_numbers
from hybrid_sysid_ros.extensions.accuracy.mockup import ShotPlan, compared, latency_of, mockup
from hybrid_sysid_ros.extensions.accuracy.monte_carlo_runs import MonteCarloRuns, Range, drawn, recorded_runs
from hybrid_sysid_ros.extensions.accuracy.report.mockup_page import write_mockup
from hybrid_sysid_ros.extensions.accuracy.setup import Setup
from hybrid_sysid_ros.extensions.accuracy.statistics import Discrepancy, ShotQuantity, Verdict, compare, overall
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused

TEMPLATE = Path(rigs.__file__).parent / "_template"
COVARIANCE = np.array([[0.01, 0.008], [0.008, 0.04]])


@pytest.fixture(scope="module")
def sled(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """The rig that `rig new` writes, with a shorter reference."""
    folder = tmp_path_factory.mktemp("rigs") / "mock_sled"
    folder.mkdir()
    (folder / "system.py").write_text((TEMPLATE / "system.py").read_text())
    text = (TEMPLATE / "rig.yaml").read_text()
    text = text.replace("duration: 20.0", "duration: 4.0").replace("stop: 10.0", "stop: 2.0")
    text = text.replace("start: 10.0, stop: 20.0", "start: 2.0, stop: 4.0")
    text = text.replace("disturbance: [1.0]  # N", "disturbance: [0.2]")
    text = text.replace("push: [0.02, 0.2]", "push: [0.005, 0.05]").replace("parameters: 0.1", "parameters: 0.02")
    (folder / "rig.yaml").write_text(text + "\nmockup: {seconds: 10.0, tolerance: {sine: 60.0}}\n")
    return rigs.load(folder)


@pytest.fixture(scope="module")
def exact(sled: Rig) -> Model:
    """A model that is the rig."""
    return Model(
        rig=sled.name,
        place=str(sled.folder),
        structure="gray",
        system=sled.system,
        sampling=Sampling(),
        names=("mass", "damping"),
        covariance=COVARIANCE,
        training_range={},
    )


def runs(where: Range, count: int) -> MonteCarloRuns:
    return MonteCarloRuns(where=where, rows=where(range(count)))


def test_a_shot_repeats_by_its_number_whatever_was_fired_before(sled, exact):
    where = Range(rig=sled, model=exact, schedule=sled.schedule(), seed=3)
    several, alone = where([0, 1, 2]), where([2])
    for name, values in alone.items():
        np.testing.assert_array_equal(several[name][2], values[0])
    assert np.ptp(several["miss"][:, 0]) > 0.0


@pytest.fixture(scope="module")
def simulated(sled: Rig, exact: Model) -> MonteCarloRuns:
    """Shots of that model."""
    return runs(Range(rig=sled, model=exact, schedule=sled.schedule(), seed=0, predicted=True), 50)


def test_a_model_that_is_the_rig_is_not_contradicted_and_one_of_another_mass_is(sled, exact, simulated):
    """Six percent more mass, which moves the paths and hardly any error."""
    mass = sled.system.named["mass"]
    heavier = sled.system.with_values(
        np.array([1.06 * mass if p.name == "mass" else sled.system.named[p.name] for p in sled.system.parameters])
    )
    given = {"rig": sled, "model": exact, "schedule": sled.schedule(), "seed": 1}
    for reality, wrong in ((sled.system, False), (heavier, True)):
        live = runs(Range(reality=reality, **given), 10)
        found = compared(simulated, live, 0, 0.1)
        assert set(found) == {"steps, position", "sine, position", "inputs"}
        words = {overall(items) for items in found.values()}
        assert (Verdict.CONTRADICTED in words) == wrong
        assert live.sound.all()


def test_each_shot_is_of_one_rig_or_of_a_fleet(sled, exact):
    given = {"rig": sled, "model": exact, "schedule": sled.schedule(), "seed": 1}
    one, fleet = (
        {Range(fleet=fleet, **given).plant(k).rig.system.named["mass"] for k in range(5)} for fleet in (False, True)
    )
    assert (len(one), len(fleet)) == (1, 5)


def test_a_difference_is_noticed_as_often_as_is_said_and_a_right_model_seldom_contradicted():
    generator = np.random.default_rng(3)

    def quantities(count: int, shift: float) -> list[ShotQuantity]:
        path = np.cumsum(generator.normal(size=(count, 10)), axis=1)
        rmse = generator.normal(10.0 + shift, 1.0, (count, 1))
        return [ShotQuantity(name="path", unit="m", values=path), ShotQuantity(name="RMSE", unit="m", values=rmse)]

    for shift, least, most in ((0.0, 0, 6), (1.4, 30, 40)):
        found = [compare(quantities(100, 0.0), quantities(10, shift), generator, matters=0.1) for _ in range(40)]
        assert least <= sum(min(item.probability for item in items) < 0.05 for items in found) <= most
    assert np.mean([items[1].noticed for items in found]) == pytest.approx(1.4, abs=0.15)


def test_agreement_needs_a_bound_below_what_matters():
    generator = np.random.default_rng(4)
    some = [[ShotQuantity(name="RMSE", unit="m", values=generator.normal(10.0, 1.0, (n, 1)))] for n in (100, 3, 2000)]
    open_, agrees = (compare(some[0], live, generator, matters=0.1)[0].verdict for live in some[1:])
    assert (open_, agrees) == (Verdict.OPEN, Verdict.AGREES)


@pytest.mark.filterwarnings("error")
def test_a_number_that_is_zero_in_all_shots_says_nothing_of_the_others():
    """As the settling time of a part whose error is always small."""
    generator = np.random.default_rng(5)

    def quantities(count: int) -> list[ShotQuantity]:
        rmse = generator.normal(10.0, 1.0, (count, 1))
        settling = ShotQuantity(name="settling time", unit="s", values=np.zeros((count, 1)))
        return [ShotQuantity(name="RMSE", unit="m", values=rmse), settling]

    rmse, settling = compare(quantities(100), quantities(10), generator, matters=0.1)
    assert rmse.verdict is not Verdict.CONTRADICTED
    assert (settling.verdict, settling.probability) == (Verdict.AGREES, 1.0)
    assert settling.noticed == pytest.approx(0.0, abs=1e-200)


def test_shots_of_a_loop_that_ran_away_are_reported_in_a_line(sled, exact):
    where = Range(rig=sled, model=exact, schedule=sled.schedule(), seed=1)
    tracking_error = np.array([[0.1, 0.2], [np.nan, 0.1], [np.inf, 0.3]])
    with pytest.raises(UserError, match=r"live: 2 of 3 shots ended in no numbers.* of moves.* \S*rig\.yaml"):
        MonteCarloRuns(where=where, rows={"miss": tracking_error}).shots("live")


def test_parameters_are_drawn_by_their_covariance_and_kept_in_their_bounds(exact):
    random = np.random.default_rng(0)
    values = [drawn(exact, random).named for _ in range(3000)]
    table = np.array([[item["mass"], item["damping"]] for item in values])
    np.testing.assert_allclose(table.mean(axis=0), [1.5, 4.0], atol=0.02)
    np.testing.assert_allclose(np.cov(table.T), COVARIANCE, rtol=0.12)
    assert {item["friction"] for item in values} == {0.8}
    wide = replace(exact, covariance=100.0 * COVARIANCE)
    masses = [drawn(wide, random).named["mass"] for _ in range(200)]
    assert min(masses) == 0.1  # its lowest value


@pytest.mark.slow
def test_a_recorded_loop_is_a_shot_of_the_rig(call, sled, exact, tmp_path):
    """Numbers of the nodes' loop are those of a simulated shot, bit by bit up to rounding; a page tells the verdict."""
    model, bag = tmp_path / "model", tmp_path / "loop"
    exact.save(model)
    rig = ("--rig", str(sled.folder), "--model", str(model))
    run = ("hybrid-sysid", "run", *rig, "--policy", "exact", "--lockstep", "--composed", "--seed", "1")
    status, _, error = call(app.main, *run, "--bag", str(bag))
    assert status == 0, error
    loop = LoopRecord.from_bag(bag, sled)
    assert latency_of(sled, [loop]) == 0.0
    where = Range(rig=sled, model=exact, schedule=sled.schedule(), seed=0, latency=0.0)
    recorded = recorded_runs(where, [loop]).rows
    shot = where.loop()(Plant(sled, seed=1, bias=sled.bias))
    numbers = loop_numbers(sled, where.schedule, shot.time, shot.outputs, shot.references, shot.inputs)
    for name, values in numbers.items():
        np.testing.assert_allclose(recorded[name][0], values, rtol=1e-6, atol=1e-6, err_msg=name)
    random = np.random.default_rng(0)
    others = [replace(loop, outputs=loop.outputs + random.normal(size=loop.outputs.shape) * 1e-4) for _ in range(2)]
    nothing = Discrepancy(mean=0.5, spread=0.0)
    plan = ShotPlan(live=9, simulated=4, plants=2, discrepancy=nothing, recorded=[loop, *others], model=exact)
    found = mockup(Setup.of(sled), tmp_path, lambda where, count, name: runs(where, count), plan, lambda line: None)
    assert not found.errors
    assert len(found.runs["live"].sound) == 3
    page = write_mockup(tmp_path / "verdict.html", found, report.provenance(exact, "")).read_text()
    assert "Recorded loops of one rig (3)" in page
    assert "as the sensors read them" in page
    given = ("hybrid-sysid", "mockup", str(sled.folder), "--out", str(tmp_path / "out"), "--live-bags", str(bag))
    refused(call(app.main, *given, "--model", str(model)), "--live-bags: 1 shots, but the parts of moves need 3")
    refused(call(app.main, *given), "--live-bags are loops", "--model FOLDER")
    other = replace(loop, reference=1.1 * loop.reference)
    with pytest.raises(UserError, match="followed another reference than moves"):
        recorded_runs(where, [other])


@pytest.mark.slow
def test_from_a_prior_to_a_verdict_and_again_without_work(call, sled, tmp_path, monkeypatch):
    go = partial(call, app.main, "hybrid-sysid", "mockup", str(sled.folder), "--out", str(tmp_path / "out"))
    counts = ("--live", "5", "--simulated", "50", "--plants", "10", "--jobs", "1")
    status, _, error = go(*counts)
    assert status == 0, error
    reported = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert reported["structure"] == "hybrid"
    prior, model = (reported["errors"][name]["swept_sine"]["position"] for name in ("prior", "hybrid"))
    assert model < 0.5 * prior
    assert [reported["shots"][name]["count"] for name in ("prior", "simulated", "live", "uncertain")] == [50, 50, 5, 10]
    kept = {line["kept"] for line in reported["verdict"]}
    assert reported["kept"] == (False if False in kept else None if None in kept else True)
    before, after = ([row for rows in of.values() for row in rows] for of in reported["compared"].values())
    assert sum(row["verdict"] == "contradicted" for row in before) > 4
    assert all(ours["difference"] <= prior["difference"] for ours, prior in zip(after, before, strict=True))
    assert any("sine ends within 60 mm" in line["criterion"] for line in reported["verdict"])
    real = Setup.of(sled, 0).reality.named
    for row in reported["parameters"]:
        assert row["real"] == real[row["name"]]
    mass = next(row for row in reported["parameters"] if row["name"] == "mass")
    assert abs(mass["value"] - mass["real"]) < 0.1 * abs(mass["prior"] - mass["real"])
    page = (tmp_path / "out" / "verdict.html").read_text()
    assert reported["conclusion"] in page
    monkeypatch.setattr(Range, "__call__", lambda self, numbers: pytest.fail("fired again"))
    monkeypatch.setattr(
        "hybrid_sysid_ros.extensions.accuracy.mockup.identify", lambda *a, **k: pytest.fail("identified again")
    )
    status, out, error = go(*counts, "--json")
    assert status == 0, error
    assert json.loads(out) == json.loads((tmp_path / "out" / "verdict.json").read_text()) == reported


def test_what_the_rig_really_is_is_drawn_about_what_it_is_thought_to_be(sled):
    """By the deviation of policy_training, 2 %: seeds are independent, and one seed always draws the same."""
    thought = sled.system.named
    drawn_ones = [Setup.of(sled, seed).reality.named for seed in range(300)]
    assert Setup.of(sled, 7).reality.named == drawn_ones[7]
    shares = np.array([[real[name] / value for name, value in thought.items()] for real in drawn_ones])
    np.testing.assert_allclose(shares.mean(axis=0), 1.0, atol=4.0 * 0.02 / np.sqrt(300))
    np.testing.assert_allclose(shares.std(axis=0), 0.02, rtol=0.2)
    assert sled.system.named == thought


def test_what_is_not_there_is_reported_in_a_line(call, sled, tmp_path):
    folder = tmp_path / "other_sled"
    folder.mkdir()
    for file in ("system.py", "rig.yaml"):
        (folder / file).write_text((sled.folder / file).read_text())

    def refuse(old: str, new: str, *words: str, counts: tuple[str, ...] = ()) -> None:
        (folder / "rig.yaml").write_text((sled.folder / "rig.yaml").read_text().replace(old, new))
        rigs._LOADED.pop(folder.resolve(), None)
        refused(call(app.main, "hybrid-sysid", "mockup", str(folder), "--out", str(tmp_path / "out"), *counts), *words)

    refuse("{sine: 60.0}", "{sinus: 60.0}", "tolerance: moves has no part sinus")
    refuse("seconds: 10.0", "learn: [nothing]", "mockup.learn", "multisine, random_steps, swept_sine")
    refuse("mockup: {", "demo: {structure: magic}\nmockup: {", "structure 'magic' is unknown")
    refuse("policy_training:", "policy_trainings:", "policy_training")
    refuse("seconds: 10.0", "seconds: -10.0", "mockup.seconds is -10", "1 to 86400")
    refuse("seconds: 10.0", "options: {units: 3}", "mockup.options", "name one beside")
    refuse("seconds: 10.0", "rate: 0", "mockup.rate is 0")
    refuse("seconds: 10.0", "rate: 333", "mockup.rate 333 Hz: its period", "no multiple")
    refuse("{sine: 60.0}", "{sine: -60.0}", "mockup.tolerance.sine is -60", "above 0")
    refuse("seconds: 10.0", "learn: [multisine], test: [multisine]", "multisine can't be in both")
    third = "frequency: 0.3}\n      third: {start: 3.5, stop: 4.0, kind: constant, level: 0.0}"
    refuse("frequency: 0.3}", third, "--live: 3 shots, but the parts of moves need 4", counts=("--live", "3"))
    refused(call(app.main, "hybrid-sysid", "mockup", "no_such_rig", "--out", str(tmp_path / "out")), "no_such_rig")

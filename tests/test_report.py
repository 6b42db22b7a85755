"""The report: one whole page that needs no network and shows every record with its scores."""

import builtins
import dataclasses
import html.parser
import math
import sys

import numpy as np
import pytest

from hybrid_sysid_ros import report
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.identification import Part, Scores, evaluate
from hybrid_sysid_ros.identification.validation.residual_tests import independence, whiteness
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.report.figures import horizons, residual_tests
from hybrid_sysid_ros.report.rendering import seconds, significant
from hybrid_sysid_ros.report.residual_patterns import patterns
from hybrid_sysid_ros.report.sections import TESTS
from hybrid_sysid_ros.report.verdict import verdict
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.excitation import Excitation, multisine
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.page import write_protocol
from studies.beam_lecture.report import StructureResult, protocol_section

pytest.importorskip("plotly")
pytest.importorskip("jinja2")

RIG = rigs.load("cam_beam")
RATE, PERIOD = 200, 0.005
VOID = {"meta", "link", "br", "hr", "img", "input", "source"}


class Page(html.parser.HTMLParser):
    """Tags of a page: whether all are closed, which addresses they name, what its text is."""

    def __init__(self, text):
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.words: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.feed(text)
        self.close()
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        found = dict(attributes)
        self.addresses += [found[key] for key in ("src", "href", "data", "action") if key in found]
        self.ids += [found["id"]] if "id" in found else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)


def record(name, seed, duration=12.0):
    """A simulated experiment of the beam with a little noise. The law makes its drive of its reference."""
    time = PERIOD * np.arange(round(duration * RATE) + 1)
    drive = 1.0 + multisine(seed, amplitude=4.0, low=0.1, high=2.0, lines=20, period=duration)(time)[:, None]
    states = simulate(RIG.system, np.zeros(2), drive[:-1], step=PERIOD)
    noise = 5e-4 * np.random.default_rng(seed).normal(size=len(time))
    return Record(
        name=name,
        time=time,
        input=drive,
        output=states[:, :1] + noise[:, None],
        channels={
            "reference": states[:, 0] + RIG.display[0].si(drive[:, 0] / RIG.experiments.loops[0].gain),
            "filtered": states[:, 0],
        },
        digest=f"{seed:064x}",
    )


def model_of(training, correlation=0.99):
    """The rig's own equation as a model; two of its parameters are correlated."""
    names = tuple(item.name for item in RIG.system.parameters if not item.fixed)
    covariance = np.diag(np.full(len(names), 0.01**2))
    covariance[0, 3] = covariance[3, 0] = correlation * 0.01**2
    return Model(
        rig="cam_beam",
        structure="gray",
        system=RIG.system,
        sampling=Sampling(step=PERIOD, period=0.05),
        names=names,
        covariance=covariance,
        training_range={},
        records=({"name": training.name, "source": "", "sha256": training.digest, "part": [0.0, 0.5]},),
        fit={"seconds": 1.25},
        seal="5ea1" * 16,
    )


def loop_of(duration=51.0, delay=0.0015):
    """A loop that follows the hardware reference 0.1 V below, with one command too late."""
    time = PERIOD * np.arange(-10, round(duration * RATE))
    reference = RIG.display[0].si(np.where(time < 0, np.nan, RIG.schedule().of(0)(time)))
    delays = np.full(len(time), delay)
    delays[500] = 0.0063
    return LoopRecord(
        name="run",
        rig=RIG,
        stamps=(1e9 * (time + 10)).astype(np.int64),
        time=time,
        outputs=np.nan_to_num(reference)[:, None] - RIG.display[0].si(np.float64(0.1)),
        reference=reference[:, None],
        inputs=np.clip(3 * np.sin(time), -10, 10)[:, None],
        command=np.clip(3 * np.sin(time), -10, 10)[:, None],
        delay=delays,
        turnaround=delays,
        late=delays > PERIOD,
        source="run",
        digest="ab" * 32,
    )


@pytest.fixture(scope="module")
def first():
    return record("<first> & only", 1)


@pytest.fixture(scope="module")
def model(first):
    return model_of(first)


@pytest.fixture(scope="module")
def section(model, first):
    return report.identification_section(model, [(first, Part(start=0.5)), (record("second", 2), Part())])


@pytest.fixture(scope="module")
def text(section, model, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "new" / "report.html"
    loop = report.closed_loop_section(loop_of(), RIG)
    assert report.write_report(path, section, loop, report.provenance(model, "make demo < now")) == path
    return path.read_text(encoding="utf-8")


def test_the_page_is_whole(text):
    page = Page(text)
    assert page.open == []
    assert text.startswith("<!DOCTYPE html>")
    assert text.rstrip().endswith("</html>")
    assert len(page.ids) == len(set(page.ids))


def test_the_page_needs_no_network(text):
    page = Page(text)
    assert page.addresses
    assert all(address.startswith("#") and address[1:] in page.ids for address in page.addresses)
    assert "link" not in page.tags
    assert "@import" not in text[: text.index("<script>")]
    assert text.count("plotly.js v") == 1  # and plotly is in it once
    figures = sum(name.startswith(("figure-free-run-", "figure-zoom-")) for name in page.ids) + 4
    assert text.count('"showSendToCloud": false') == figures  # nor does it offer to upload anything


def test_every_record_is_there_with_its_scores(text, model, first):
    page = Page(text)
    for used, part in ((first, Part(start=0.5)), (record("second", 2), Part())):
        scores = evaluate(model, used, part=part)
        assert used.name in page.text
        assert f"R² {scores.r2:.4f}" in page.text
        assert f"{RIG.display[0].shown(np.float64(scores.rmse)):.3f} V, {np.degrees(scores.rmse):.3f}°" in page.text
        assert f"fit {scores.fit_percent:.1f} %" in page.text
    assert sum(name.startswith("figure-free-run-") for name in page.ids) == 2


def test_parameters_stand_with_error_unit_and_correlation(text):
    page = Page(text).text
    for item in RIG.system.parameters:
        assert f"{item.name} {item.description.replace('^2', '²')}" in page
    assert "damping gain \N{GREEK SMALL LETTER RHO} = 0.990" in page
    assert "rad/(s² V)" in page


def test_what_the_data_do_not_determine_is_said(text):
    page = Page(text).text
    assert "What the data don't determine" in page
    assert "can't be told apart from gain (+0.99)" in page


def test_every_experiment_is_done_again(text, section):
    page = Page(text).text
    for run in section.runs:
        assert f"{run.again.output.r2:.4f}" in page
        assert f"{run.again.input.r2:.4f}" in page


def test_an_experiment_without_a_reference_says_why_it_is_not_done_again(model, first, tmp_path):
    alone = dataclasses.replace(first, channels={})
    section = report.identification_section(model, [(alone, Part())])
    assert set(section.runs[0].tests) == set(TESTS) - {"phi_re"}
    path = report.write_report(tmp_path / "report.html", section, None, report.provenance(model, "evaluate"))
    assert "skipped: <first> & only: has no channel reference" in Page(path.read_text(encoding="utf-8")).text


def test_one_reason_for_all_records_is_given_once(model, section, tmp_path):
    """A rig without a loop of its own has no experiment that could be done again."""
    runs = [dataclasses.replace(run, again=None, skipped="no loop") for run in section.runs]
    found = dataclasses.replace(section, runs=[*runs, *runs])
    path = report.write_report(tmp_path / "report.html", found, None, report.provenance(model, "evaluate"))
    page = Page(path.read_text(encoding="utf-8")).text
    assert (page.count("skipped: no loop."), page.count("output R²")) == (1, 0)


def test_a_narrow_logarithmic_axis_has_its_ends_as_ticks(section):
    """7 to 9 would have no tick of 1, 2 and 5."""
    lines = [run.horizons for run in section.runs]
    flat = [dataclasses.replace(item, rmse=np.linspace(7e-3, 8e-3, len(item.rmse))) for item in lines]
    flat = [dataclasses.replace(item, free_run=dataclasses.replace(item.free_run, rmse=9e-3)) for item in flat]
    wide = [dataclasses.replace(item, rmse=np.geomspace(1e-3, 1.0, len(item.rmse))) for item in lines]
    narrow, ticks = ([float(v) for v in horizons(x, RIG.display[0]).layout.yaxis.ticktext] for x in (flat, wide))
    assert len(narrow) >= 2
    assert len(ticks) >= 3


@pytest.mark.parametrize(("value", "reported"), [(0.03, "0.03"), (0.187, "0.19"), (15.74, "15.7"), (0.0, "0")])
def test_a_short_time_keeps_its_digits(value, reported):
    assert seconds(value) == reported


def test_a_loop_of_a_rig_that_is_disturbed_says_so(section, model, tmp_path):
    """A hand on the drill string's brake, which would else be taken for a poor controller."""
    loop, brake = loop_of(), dataclasses.replace(RIG, disturbances={1: Excitation(kind="pulses", numbers={})})
    for rig, reported in ((RIG, 0), (brake, 1)):
        closed = report.closed_loop_section(dataclasses.replace(loop, rig=rig))
        path = report.write_report(tmp_path / "report.html", section, closed, report.provenance(model, "run"))
        page = Page(path.read_text(encoding="utf-8")).text
        assert page.count("which no model knows: velocity [rad/s]") == reported


def test_errors_over_the_horizon_end_in_those_of_the_free_run(section, text):
    assert "figure-horizon-curves" in Page(text).ids
    for run in section.runs:
        assert run.horizons.free_run == run.scores


def test_the_loop_is_judged_on_the_windows_of_the_hardware_reference(text):
    page = Page(text)
    assert "tracking RMSE, steps 0.100 V" in page.text
    assert "tracking RMSE, sine 0.100 V" in page.text
    assert "recorded misses 1 of 10200" in page.text
    assert "1.50 / 1.50 / 6.3 ms" in page.text
    assert {"figure-tracking", "figure-zoom-0", "figure-zoom-1", "figure-delays"} <= set(page.ids)


def test_the_report_says_of_a_run_what_the_terminal_does(section, model, tmp_path):
    plant = {"measurements": 100, "missed_commands": 9, "delay_ms_p50": 1.0, "delay_ms_p99": 2.0, "delay_ms_max": 7.0}
    loop = report.closed_loop_section(loop_of(), RIG)
    run = report.RunSummary.of({"plant": plant}, RIG, section=loop)
    path = report.write_report(tmp_path / "report.html", section, loop, report.provenance(model, "demo"), run)
    page = Page(path.read_text(encoding="utf-8")).text
    for name, words in run.lines.items():
        assert f"{name} {words}" in page
    assert "recorded misses" not in page
    assert "TOO SLOW, which spoils these numbers" in page


def test_a_report_begins_with_a_judgement_of_model_and_loop(section):
    lowest = math.floor(1e3 * min(run.scores.r2 for run in section.runs if run.seen is False)) / 1e3
    found = verdict(section, report.RunSummary(missed=0, measurements=9, share=0.02), "The shipped policy drove it.")
    assert f"R² of at least {lowest:.3f}" in found["model"].words
    assert "times the noise of the sensors" in found["model"].words
    assert found["driver"].words.startswith("The shipped policy drove it.")
    assert (found["tracking"].grade, found["driver"].grade) == ("good", "good")
    failed = verdict(section, report.RunSummary(missed=0, measurements=9, share=0.8, failsafe={"resting": 2}), "")
    assert "does NOT follow" in failed["tracking"].words
    assert "resting, 2 times" in failed["driver"].words
    assert (failed["tracking"].grade, failed["driver"].grade) == ("bad", "fair")
    assert verdict(section, None, "").keys() == {"model"}


def test_tracking_is_judged_beside_the_ideal_loop(section, model, tmp_path):
    loop = dataclasses.replace(report.closed_loop_section(loop_of(), RIG), ideal={"steps": 0.05, "sine": 0.09})
    run = report.RunSummary.of({}, RIG, section=loop)
    assert run.ratio == pytest.approx(2.0, rel=1e-3)
    assert "at most 2.00 times that of the ideal loop" in run.lines["tracking"]
    assert "ideal loop" in verdict(section, run, "")["tracking"].words
    path = report.write_report(tmp_path / "report.html", section, loop, report.provenance(model, "demo"), run)
    assert "tracking RMSE, steps / ideal loop 0.100 / 0.050 V" in Page(path.read_text(encoding="utf-8")).text


def test_each_residual_test_is_judged_in_a_sentence(section):
    """The second run is left with an effect of the input three samples before."""
    run, noise = section.runs[0], np.random.default_rng(0).standard_normal(400)
    clean = dataclasses.replace(run, tests={"phi_ee": whiteness(noise)})
    tests = {"phi_ue": independence(0.4 * np.roll(noise, 3) + noise[::-1], noise)}
    left = dataclasses.replace(run, name="swept-sine-2", tests=tests)
    white, missing = patterns(dataclasses.replace(section, runs=[clean, left]))
    assert (white.passed, missing.passed) == (True, False)
    assert "an effect of the input is missing" in missing.words
    assert "Most in swept-sine-2: " in missing.words
    assert f"after {3 * section.model.sampling.period:.2g} s" in missing.words


def test_a_report_shows_the_drawing_of_its_rig(text):
    assert text.index("Drawing of cam_beam") < text.index('id="closed-loop"')


def test_provenance_names_command_versions_and_hashes(text, first):
    page = Page(text).text
    assert "make demo < now" in page
    assert "numpy" in page
    for digest in (first.digest, "ab" * 32, "5ea1" * 16):
        assert digest in page


def test_training_data_is_called_so(model, first):
    runs = report.identification_section(model, [(first, Part(stop=0.4)), (first, Part(start=0.5))]).runs
    assert [run.seen for run in runs] == [True, False]


def test_without_hashes_nothing_is_called_unseen(model, first):
    nameless = dataclasses.replace(first, digest="")
    assert report.identification_section(model, [(nameless, Part(start=0.5))]).runs[0].seen is None


def test_a_perfect_model_leaves_what_passes_the_tests(section):
    for run in section.runs:
        assert set(run.tests) == set(TESTS)
        assert all(run.tests[key].p_value > 1e-3 for key in TESTS if key != "phi_ee"), run.name


def test_a_model_alone_makes_a_report(section, model, tmp_path):
    path = report.write_report(tmp_path / "report.html", section, None, report.provenance(model, "evaluate"))
    page = Page(path.read_text(encoding="utf-8"))
    assert "closed-loop" not in page.ids
    assert all(address[1:] in page.ids for address in page.addresses)


def test_outputs_of_a_record_count_as_one_and_stand_beside_their_panels(section, model, tmp_path):
    """A panel is some twenty characters high."""
    run = section.runs[0]
    outputs = ("bit_speed", "speed_of_the_uppermost_of_its_discs")
    runs = [dataclasses.replace(run, record="long", name=f"{model.rig}_braked_random_steps, {y}") for y in outputs]
    two = dataclasses.replace(section, runs=runs)
    path = report.write_report(tmp_path / "report.html", two, None, report.provenance(model, "evaluate"))
    assert "<p>1 record in free run" in path.read_text(encoding="utf-8")
    figure = residual_tests(two)
    titles = [axis.title.text for axis in figure.select_yaxes(col=1)]
    assert titles[0] == "braked_random_steps<br>bit_speed"
    assert all(len(line) <= 20 for title in titles for line in title.split("<br>"))


def test_a_model_that_diverges_makes_a_report(model, first, tmp_path):
    with np.errstate(all="ignore"):
        run = report.identification_section(model, [(first, Part())]).runs[0]
        wild = dataclasses.replace(
            run,
            simulated=np.full_like(run.simulated, np.inf),
            residuals=np.full_like(run.residuals, -np.inf),
            scores=Scores(r2=-np.inf, rmse=np.inf, fit_percent=-np.inf),
            tests={},
            horizons=dataclasses.replace(run.horizons, rmse=np.full_like(run.horizons.rmse, np.inf)),
            again=None,
            skipped="it diverges",
        )
        broken = report.IdentificationSection(model=model, runs=(wild,))
        path = report.write_report(tmp_path / "report.html", broken, None, report.provenance(model, "evaluate"))
    assert first.name in Page(path.read_text(encoding="utf-8")).text


def test_a_loop_in_simulated_time_shows_its_turnaround(section, model, tmp_path):
    loop = loop_of()
    lockstep = dataclasses.replace(loop, delay=np.full_like(loop.delay, np.nan))
    closed = report.closed_loop_section(lockstep)
    path = report.write_report(tmp_path / "report.html", section, closed, report.provenance(model, "run"))
    assert "Simulated time" in Page(path.read_text(encoding="utf-8")).text


def test_another_reference_is_judged_as_a_whole():
    loop = loop_of()
    other = dataclasses.replace(loop, reference=1.5 * loop.reference)
    assert list(report.closed_loop_section(other).windows) == ["whole run"]
    short = report.closed_loop_section(loop_of(duration=8.0))
    assert list(short.windows) == ["steps"]


def test_the_zoom_shows_the_largest_step():
    zoom = report.closed_loop_section(loop_of()).zooms["steps"]
    levels = RIG.schedule().of(0)(np.arange(29) + 0.5)
    assert zoom.start < 1 + np.argmax(np.abs(np.diff(levels))) < zoom.stop


def structure(name, *r2, **more):
    """A structure of some seeds on two records."""
    seeds = [{"<first> & only": first, "second": second} for first, second in r2]
    return StructureResult(name=name, r2=seeds, seconds=2.5, **more)


PUBLISHED = {"<first> & only": 0.95, "second": 0.5}


@pytest.fixture(scope="module")
def protocol(model, first):
    runs = [(first, Part(start=0.5)), (record("second", 2), Part())]
    weak = dataclasses.replace(model, system=dataclasses.replace(model.system, gain=3.0))
    return protocol_section(
        "two records",
        [
            structure("lost", (-np.inf, -123.0)),
            structure("weak", (0.5, 0.6), published=PUBLISHED, model=weak, runs=runs),
            structure(
                "<hybrid>", (0.9, 0.8), (0.94, 0.7), published=PUBLISHED, model=model, runs=runs, chosen=True,
                cross_validation=0.913,
            ),
        ],
        about="halves & wholes",
        training=[(first, Part(stop=0.5))],
    )  # fmt: skip


@pytest.fixture(scope="module")
def protocol_text(protocol, model, tmp_path_factory):
    path = tmp_path_factory.mktemp("protocol") / "protocol.html"
    assert write_protocol(path, protocol, report.provenance(model, "make protocol")) == path
    return path.read_text(encoding="utf-8")


def test_the_page_of_a_protocol_is_whole_and_needs_no_network(protocol_text):
    page = Page(protocol_text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert all(address.startswith("#") and address[1:] in page.ids for address in page.addresses)
    assert "link" not in page.tags


def test_ours_stand_beside_the_published_with_their_range(protocol_text):
    rows = protocol_text[protocol_text.index('<table class="scores">') :].split("<tr")[1:]
    cells = [Page(f"<tr{row.partition('</tr>')[0]}</tr>").text for row in rows[:7]]
    assert cells[1].startswith("lost diverges \N{MINUS SIGN}123 ")
    assert cells[2].startswith("weak 0.500 0.600 0.550")
    assert cells[4] == "<hybrid> 2 seeds 0.920 0.900 … 0.940 0.750 0.700 … 0.800 0.835 0.913 2.5 s"
    assert cells[5].startswith("published 0.950 0.500 0.725")
    assert ["chosen" in row.partition(">")[0] for row in rows[1:6]] == [False, False, False, True, True]
    assert rows[4].count('class="better"') == 1  # .75 is above .5, .92 is not above .95


def test_the_pick_comes_first_and_in_full(protocol, protocol_text):
    assert list(protocol.details) == ["<hybrid>", "weak"]
    page = Page(protocol_text)
    for number in (0, 1):
        figures = {f"free-run-{run}" for run in (0, 1)} | {"residual-tests", "horizon-curves"}
        assert {f"figure-structure-{number}-{name}" for name in figures} <= set(page.ids)
    assert page.tags.count("details") == 1
    assert {"figure-scores-of-structures", "figure-horizons-of-structures"} <= set(page.ids)


def test_criteria_are_those_of_the_training_data(protocol, model, first):
    assert list(protocol.judgements) == ["weak", "<hybrid>"]
    for name, used in (("weak", protocol.results[1].model), ("<hybrid>", model)):
        found = protocol.judgements[name].plain
        assert np.sqrt(found.mean_square) == pytest.approx(evaluate(used, first, part=Part(stop=0.5)).rmse)
        assert found.parameters == len(model.names)


def test_a_protocol_without_models_shows_its_table(model, tmp_path):
    section = protocol_section("bare", [structure("only", (0.5, 0.6))])
    path = write_protocol(tmp_path / "protocol.html", section, report.provenance(model, "x"))
    assert "only 0.500 0.600 0.550" in Page(path.read_text(encoding="utf-8")).text


@pytest.mark.parametrize(
    ("results", "match"),
    [
        ([], "no structure"),
        ([structure("a", (1, 1)), structure("a", (1, 1))], "two structures are called a"),
        ([structure("a", (1, 1), chosen=True), structure("b", (1, 1), chosen=True)], "more than one"),
        ([structure("a")], "a has no seed"),
        (
            [structure("a", (1, 1)), StructureResult(name="b", r2=[{"other": 1.0}], seconds=1.0)],
            "b has no seed, or other records than a",
        ),
    ],
)
def test_a_protocol_that_makes_no_table_is_refused(results, match):
    with pytest.raises(UserError, match=match):
        protocol_section("wrong", results)


@pytest.mark.parametrize("missing", ["plotly", "jinja2"])
def test_without_the_extra_the_user_is_told_which(section, model, tmp_path, monkeypatch, missing):
    real = builtins.__import__

    def absent(name, *args, **kwargs):
        if name.partition(".")[0] == missing:
            raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)
        return real(name, *args, **kwargs)

    monkeypatch.setitem(sys.modules, missing, None)  # what import takes for missing
    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(UserError, match=rf"{missing} is missing; .*hybrid_sysid_ros\[report\]"):
        report.write_report(tmp_path / "report.html", section, None, report.provenance(model, "evaluate"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [
        (5.025019, 4, "5.025"),
        (-122.74494, 4, "\N{MINUS SIGN}122.7"),
        (0.00038415, 2, "0.00038"),
        (2.3477e-5, 4, "2.348·10⁻⁵"),
        (7282.3, 3, "7282"),
        (0.0, 4, "0.000"),
        (None, 4, "\N{EN DASH}"),
        (float("nan"), 4, "\N{EN DASH}"),
    ],
)
def test_numbers_are_short(value, digits, expected):
    assert significant(value, digits) == expected

"""The report: one whole page that needs no network and shows every record with its scores."""

import builtins
import dataclasses
import math
import sys

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.shared.report.figures import horizons, residual_tests
from hybrid_sysid_ros.extensions.shared.report.loop_views import zooms
from hybrid_sysid_ros.extensions.shared.report.rendering import seconds, significant
from hybrid_sysid_ros.extensions.shared.report.residual_patterns import patterns
from hybrid_sysid_ros.extensions.shared.report.sections import TESTS
from hybrid_sysid_ros.extensions.shared.report.verdict import verdict
from hybrid_sysid_ros.extensions.shared.residual_tests import independence, whiteness
from hybrid_sysid_ros.identification import Part, Scores, evaluate
from hybrid_sysid_ros.report import RunSummary, closed_loop_section
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.support.errors import UserError
from tests.report_bench import RIG, Page, loop_of, model_of, record

pytest.importorskip("plotly")
pytest.importorskip("jinja2")


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
    loop = closed_loop_section(loop_of(), RIG)
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


def luminance(colour: str) -> float:
    """Relative luminance of #rrggbb (WCAG 2.2)."""
    shares = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in shares)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


@pytest.mark.parametrize("name", ["--text: ", "--quiet: ", "--alarm: ", ".good { color: ", ".fair { color: "])
def test_all_words_can_be_read(text, name):
    """WCAG 2.2, 1.4.3."""
    behind, written = (luminance(text.partition(before)[2][:7]) for before in ("body { margin: 0; background: ", name))
    assert (behind + 0.05) / (written + 0.05) >= 4.5


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
        closed = closed_loop_section(dataclasses.replace(loop, rig=rig))
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
    loop = closed_loop_section(loop_of(), RIG)
    run = RunSummary.of({"plant": plant}, RIG, section=loop)
    path = report.write_report(tmp_path / "report.html", section, loop, report.provenance(model, "demo"), run)
    page = Page(path.read_text(encoding="utf-8")).text
    for name, words in run.lines.items():
        assert f"{name} {words}" in page
    assert "recorded misses" not in page
    assert "TOO SLOW, which spoils these numbers" in page


def test_a_report_begins_with_a_judgement_of_model_and_loop(section):
    lowest = math.floor(1e3 * min(run.scores.r2 for run in section.runs if run.seen is False)) / 1e3
    found = verdict(section, RunSummary(missed=0, measurements=9, share=0.02), "The shipped policy drove it.")
    assert f"R² of at least {lowest:.3f}" in found["model"].words
    assert "times the noise of the sensors" in found["model"].words
    assert found["driver"].words.startswith("The shipped policy drove it.")
    assert (found["tracking"].grade, found["driver"].grade) == ("good", "good")
    failed = verdict(section, RunSummary(missed=0, measurements=9, share=0.8, failsafe={"resting": 2}), "")
    assert "does NOT follow" in failed["tracking"].words
    assert "resting, 2 times" in failed["driver"].words
    assert (failed["tracking"].grade, failed["driver"].grade) == ("bad", "fair")
    assert verdict(section, None, "").keys() == {"model"}


def test_a_loop_in_which_the_network_hardly_answered_is_not_called_its_own(section):
    layers, rejections = {"exact": 99, "policy": 1}, {"improved by one step": 0.12}
    run = RunSummary(missed=0, measurements=100, share=0.02, layers=layers, rejections=rejections)
    found = verdict(section, run, "The shipped policy drove it.")["driver"]
    assert found.grade == "fair"
    assert "the exact MPC gave 99 % of the answers" in found.words
    assert "refused 12 %" in found.words


def test_a_disturbed_loop_is_not_bad_because_the_ideal_one_is_not_disturbed(section):
    run = RunSummary(missed=0, measurements=9, share=0.2, ratio=4.0, disturbed=["brake [N m]"])
    found = verdict(section, run, "")["tracking"]
    assert found.grade == "fair"
    assert "brake [N m]" in found.words


def test_tracking_is_judged_beside_the_ideal_loop(section, model, tmp_path):
    loop = dataclasses.replace(closed_loop_section(loop_of(), RIG), ideal={"steps": 0.05, "sine": 0.09})
    run = RunSummary.of({}, RIG, section=loop)
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
    closed = closed_loop_section(lockstep)
    path = report.write_report(tmp_path / "report.html", section, closed, report.provenance(model, "run"))
    assert "Simulated time" in Page(path.read_text(encoding="utf-8")).text


def test_another_reference_is_judged_as_a_whole():
    loop = loop_of()
    other = dataclasses.replace(loop, reference=1.5 * loop.reference)
    assert list(closed_loop_section(other).windows) == ["whole run"]
    short = closed_loop_section(loop_of(duration=8.0))
    assert list(short.windows) == ["steps"]


def test_the_zoom_shows_the_largest_step():
    zoom = zooms(closed_loop_section(loop_of()))["steps"]
    levels = RIG.schedule().of(0)(np.arange(29) + 0.5)
    assert zoom.start < 1 + np.argmax(np.abs(np.diff(levels))) < zoom.stop


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

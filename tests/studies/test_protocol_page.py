"""The page of a protocol: ours beside the published, the pick first and in full."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.identification import Part, evaluate
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.page import write_protocol
from studies.beam_lecture.report import StructureResult, protocol_section
from tests.report_bench import Page, model_of, record

pytest.importorskip("plotly")
pytest.importorskip("jinja2")


@pytest.fixture(scope="module")
def first():
    return record("<first> & only", 1)


@pytest.fixture(scope="module")
def model(first):
    return model_of(first)


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

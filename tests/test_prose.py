"""The pages are short, name their reader, and use the words of the field."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXTENSIONS = ROOT / "hybrid_sysid_ros" / "extensions"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted(EXTENSIONS.glob("*/docs/**/*.md"))]
PAGE_WORDS, LINE, CELL_WORDS = 1500, 160, 15

NOT_AGAIN = {  # words that only this project had, and what a control engineer says
    r"told": "reported, stated, given, known",
    r"leftovers?": "residual",
    r"pilots?|pilot flies": "controller",
    r"whereabouts": "state of the loop",
    r"hears?|heard|hearing": "subscribes, receives",
    r"strangers?(?! packages?)": "others, incompatible peers",
    r"belongings": "provenance",
    r"aside": "beside the loop",
    r"patient": "slow group",
    r"slopes|sloped": "Jacobian, derivatives",
    r"believes?|believed|believing": "accepts",
    r"border": "message validation",
    r"teach(es)?|taught": "determine",
    r"anybody's": "every rig's",
    r"whoever|whatever stands": "the node that",
    r"foretold|foretells?": "predicted",
    r"swings?|swung|swinging": "oscillation, motion",
}
"""Expressions, whole words in any case, outside of code."""
SAID_BY_USERS = {"commander.md": r"swings?", "commands.md": r"swings?"}
"""Words of commands in plain language."""
OF_TARGETS = re.compile(r"\bshots?\b", re.IGNORECASE)
"""Shots are those of the accuracy's paper; loops of a rig are Monte Carlo runs."""


def _is_results(page: Path) -> bool:
    return "results" in page.parts


def _prose(page: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without code, neither in blocks nor within lines."""
    fenced, after_blank, indented = False, True, False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        indented = line.startswith("    ") and not line.lstrip().startswith(("- ", "* ")) and (after_blank or indented)
        after_blank = not line.strip()
        if not (fenced or indented or line.lstrip().startswith("```")):
            yield number, re.sub(r"`[^`]*`", "`code`", re.sub(r"\]\([^)]*\)", "]", line))


@pytest.fixture(params=PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def page(request) -> Path:
    return request.param


def test_a_page_begins_with_whom_it_is_for(page):
    title, audience = [line for line in page.read_text(encoding="utf-8").splitlines() if line.strip()][:2]
    assert title.startswith("# ")
    assert audience.startswith("For ")


def test_a_guide_is_read_in_one_sitting(page):
    """Results and tables that are made of the code may be longer."""
    if not _is_results(page):
        assert sum(len(line.split()) for _, line in _prose(page)) <= PAGE_WORDS


def test_a_line_fits_on_a_screen(page):
    long = [
        number
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > LINE and not line.lstrip().startswith(("|", "![", "    ")) and "](" not in line
    ]
    fenced = {number for number, _ in _prose(page)}
    assert [number for number in long if number in fenced] == []


def test_a_cell_of_a_table_holds_a_phrase(page):
    wide = [
        f"{number}: {cell.strip()}"
        for number, line in _prose(page)
        if line.startswith("|")
        for cell in line.strip("|").split("|")
        if len(cell.split()) > CELL_WORDS
    ]
    assert wide == []


def test_words_that_have_gone_do_not_come_back(page):
    gone = re.compile(rf"(?<![\w-])({'|'.join(NOT_AGAIN)})(?![\w-])", re.IGNORECASE)
    found = [
        f"{number}: {match[0]}: {line.strip()}"
        for number, line in _prose(page)
        for match in gone.finditer(line)
        if not re.fullmatch(SAID_BY_USERS.get(page.name, r"\b\B"), match[0], re.IGNORECASE)
    ]
    assert found == []


def test_runs_of_a_rig_are_not_shots(page):
    if page.parent.parent.name == "accuracy" or page.parent.parent.parent.name == "accuracy":
        pytest.skip("the paper's word")
    assert [f"{number}: {line}" for number, line in _prose(page) if OF_TARGETS.search(line)] == []

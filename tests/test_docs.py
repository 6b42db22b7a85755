"""What the pages say can be typed, and leads somewhere."""

from __future__ import annotations

import io
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

import benchmarks.__main__ as benchmarks
from hybrid_sysid_ros.commands.app import LateCommand
from hybrid_sysid_ros.support import extensions

ROOT = Path(__file__).parents[1]
EXTENSIONS = ROOT / "hybrid_sysid_ros" / "extensions"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted(EXTENSIONS.glob("*/docs/**/*.md"))]
COMMANDS = extensions.commands()
SHIPPED = {
    "accuracy",
    "commander",
    "ensemble",
    "export",
    "friction_atlas",
    "playback",
    "policies",
    "search",
    "trim",
    "tuning",
    "view",
    "vision",
}
"""Extensions whose commands and options the pages speak of."""


def _lines() -> Iterator[tuple[str, str]]:
    """Every command line of ours in a block of code, with its page."""
    for page in PAGES:
        for line in page.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
            if line.startswith("    hybrid-sysid ") and "..." not in line and "[" not in line:
                yield page.name, line.strip()


LINES = sorted(set(_lines()))


def _parse(words: list[str]) -> None:
    name = next((" ".join(words[:count]) for count in (1, 2) if " ".join(words[:count]) in COMMANDS), "")
    assert name, f"no command {' '.join(words[:2])}"
    made = LateCommand(name, *COMMANDS[name]).made()
    made.make_parser(made.context_class(made)).parse_args(args=words[len(name.split()) :])


@pytest.mark.skipif(not {item.name for item in extensions.installed()} >= SHIPPED, reason="needs all extensions")
@pytest.mark.parametrize(("page", "line"), LINES, ids=[f"{page}-{k}" for k, (page, _) in enumerate(LINES)])
def test_a_command_line_has_options_that_there_are(page: str, line: str) -> None:
    _parse(shlex.split(line, comments=True)[1:])


def _groups(entries: list[Any]) -> Iterator[list[Any]]:
    yield entries
    for entry in entries:
        if isinstance(entry, dict) and isinstance(found := next(iter(entry.values())), list):
            yield from _groups(found)


def test_a_benchmark_that_a_page_names_is_there() -> None:
    """``python -m benchmarks NAME...`` runs whole ones; ``python -m benchmarks.NAME`` takes the names of its parts."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for module, names in re.findall(r"python -m benchmarks(\.[a-z_.]+)?((?: [a-z_-]+)*)", text):
            called = [module[1:]] if module else [name for name in names.split() if name != "all-tables"]
            assert {*called} <= {*benchmarks.KNOWN}, f"{page.name}: {called}"


def test_no_group_of_the_site_has_more_than_seven_entries() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    groups = list(_groups(yaml.safe_load(navigation.partition("\n")[2])))
    assert [group for group in groups if len(group) > 7] == []
    pages = {folder.parent.name: len([*folder.rglob("*.md")]) for folder in EXTENSIONS.glob("*/docs")}
    named = [group for group in groups if isinstance(group[0], str)]  # of extensions, by their folders
    assert pages.keys() <= {name for group in named for name in group}
    assert [group for group in named if sum(pages.get(name, 0) for name in group) > 7] == []


def test_the_reference_is_made_of_the_code(monkeypatch) -> None:
    written: dict[str, io.StringIO] = {}

    def opened(name: str, mode: str) -> io.StringIO:
        assert mode == "w"
        written[name] = io.StringIO()
        monkeypatch.setattr(written[name], "close", lambda: None)
        return written[name]

    monkeypatch.setitem(sys.modules, "mkdocs_gen_files", SimpleNamespace(open=opened))
    runpy.run_path(str(ROOT / "docs" / "reference.py"))
    assert "rate_weight" in written["reference/parameters.md"].getvalue()
    assert "## hybrid-sysid identify" in written["reference/commands.md"].getvalue()
    assert written.keys() == {f"reference/{name}.md" for name in ("commands", "parameters", "topics", "library")}


def test_every_command_is_on_some_page() -> None:
    text = " ".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert not [words for words in COMMANDS if f"hybrid-sysid {words}" not in text]


def test_every_extension_is_in_the_table_of_extensions() -> None:
    rows = re.findall(r"^\| (\w+) \|", (ROOT / "docs" / "extensions.md").read_text(encoding="utf-8"), re.M)
    ours = {path.parent.name for path in EXTENSIONS.glob("*/extension.py")}
    assert ours <= {*rows}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_its_heading(page: Path) -> None:
    text = re.sub(r"^    .*$", "", page.read_text(encoding="utf-8"), flags=re.M)
    for target in re.findall(r"\]\(([^)#:]*)(?:#([\w-]+))?\)", text):
        path, heading = (page.parent / target[0]).resolve() if target[0] else page, target[1]
        if EXTENSIONS in path.parents and not (EXTENSIONS / path.relative_to(EXTENSIONS).parts[0]).exists():
            continue  # an extension that was taken away: the built site has its name as text
        assert path.exists(), f"{page.name} links to {target[0]}"
        if heading:
            titles = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.M)
            slugs = [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]
            assert heading in slugs, f"{page.name} links to {target[0]}#{heading}"


@pytest.mark.skipif(not {item.name for item in extensions.installed()} >= SHIPPED, reason="needs all extensions")
def test_a_source_file_that_a_page_names_is_there() -> None:
    """But those that a reader writes, and those of editions before."""
    written, before = ("pendulum/", "axis/", "tanks/"), ("second-edition.md",)
    paths = {f"/{path.relative_to(ROOT).as_posix()}" for path in ROOT.rglob("*.py") if ".venv" not in path.parts}
    named = {
        (page.name, name)
        for page in PAGES
        if page.name not in before
        for name in re.findall(r"`([\w/]+\.py)`", page.read_text(encoding="utf-8"))
        if not name.startswith(written)
    }
    assert [item for item in sorted(named) if not any(path.endswith(f"/{item[1]}") for path in paths)] == []

"""The pages are read where they lie, in a checkout and where a wheel put them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from hybrid_sysid_ros.extensions.pages.commands import docs
from tests.command_line import refused

ROOT = Path(docs.__file__).parents[4]


def test_every_page_has_a_name_of_its_own():
    found = docs.pages()
    assert sorted(found.values()) == sorted(
        [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("hybrid_sysid_ros/extensions/*/docs/**/*.md")]
    )


def test_a_page_is_printed_as_it_is_where_nobody_reads_it(command):
    status, out, _ = command("docs", "concepts")
    assert (status, out) == (0, (ROOT / "docs" / "concepts.md").read_text(encoding="utf-8"))
    assert str(ROOT / "docs" / "concepts.md") in command("docs")[1]
    refused(command("docs", "concpts"), "no page concpts", "concepts")


def test_a_reader_that_has_gone_is_no_error():
    words = [sys.executable, "-m", "hybrid_sysid_ros", "docs"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as found:
        assert found.stdout is not None
        found.stdout.close()
        assert (found.wait(60), found.stderr and found.stderr.read()) == (0, b"")


def test_pages_are_found_where_a_wheel_was_installed(monkeypatch, tmp_path):
    page = tmp_path / "share" / "docs" / "concepts.md"
    page.parent.mkdir(parents=True)
    page.write_text("# Concepts\n")

    class Installed(str):
        def locate(self) -> Path:
            return tmp_path / self

    monkeypatch.setattr(docs, "CHECKOUT", tmp_path / "nowhere")
    monkeypatch.setattr(docs, "files", lambda name: [Installed("share/docs/concepts.md")])
    assert docs.pages() == {"concepts": page}


def test_a_page_is_found_by_the_path_by_which_pages_name_it(command):
    assert command("docs", "tutorials/add-a-rig.md") == command("docs", "add-a-rig")

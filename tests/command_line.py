"""Command lines in this process, for tests."""

from __future__ import annotations

from pathlib import Path

import pytest

Answer = tuple[int, str, str]
"""Status, standard output and standard error."""


def refused(answer: Answer, *words: str | Path) -> None:
    """The command ended with status 2 and one line on standard error that has these words."""
    status, _, error = answer
    assert status == 2, error
    assert error.startswith("error: ")
    assert error.count("\n") == 1, error
    for word in words:
        assert str(word) in error


PLACES = pytest.mark.parametrize("place", ["file/x", "/proc/x", "taken"])
"""Where nothing can be written: below a file, where nobody may, and a folder of something else."""


def refused_place(command, folder: Path, place: str, arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch):
    """A command says that it can't write to PLACE, one of its arguments, before anything else, and leaves no trace."""
    monkeypatch.chdir(folder)
    (folder / "file").touch()
    (folder / "taken").mkdir()
    (folder / "taken" / "thesis.tex").write_text("years of work")
    refused(command(*(place if item == "PLACE" else item for item in arguments)), place)
    assert sorted(str(path.relative_to(folder)) for path in folder.rglob("*")) == ["file", "taken", "taken/thesis.tex"]

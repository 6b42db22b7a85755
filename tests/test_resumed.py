"""A measurement that goes on has results of its own code only."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import resumed


def test_results_of_other_code_are_found_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resumed, "ROOT", tmp_path)
    (tmp_path / "code.py").write_text("1", encoding="utf-8")
    runs = list[int]()

    def task() -> dict[str, int]:
        runs.append(len(runs))
        return {"run": runs[-1]}

    def found() -> object:
        return resumed.resumed(tmp_path / "part.json", [("a", "b", task)], resumed.digest("code.py"))

    assert found() == found() == {"a": {"b": {"run": 0}}}
    (tmp_path / "code.py").write_text("2", encoding="utf-8")
    assert found() == {"a": {"b": {"run": 1}}}


def test_work_that_takes_too_long_is_left_to_the_next_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resumed, "LONGEST", 0.0)
    assert resumed.resumed(tmp_path / "part.json", [("a", "b", dict)], "code") == {"a": {}}

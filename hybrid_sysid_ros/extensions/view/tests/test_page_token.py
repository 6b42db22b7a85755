"""The token of a page: the same for a port over a restart, for a day, and nobody else's."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from hybrid_sysid_ros.extensions.view.page_token import LONGEST_KEPT, folder, page_token


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return folder()


def test_a_port_keeps_its_token_over_a_restart(place: Path) -> None:
    first = page_token(8400)
    assert page_token(8400) == first
    assert page_token(8401) != first
    assert page_token(0) != page_token(0)
    assert len(first) == 22  # 128 bits


def test_others_can_not_read_it(place: Path) -> None:
    before = os.umask(0)
    try:
        page_token(8400)
    finally:
        os.umask(before)
    modes = {path.stat().st_mode & 0o777 for path in (place, place / "view-8400.token")}
    assert modes == {0o700, 0o600}


def test_a_token_ends_with_the_day(place: Path) -> None:
    first = page_token(8400)
    ended = time.time() - LONGEST_KEPT - 1.0
    os.utime(place / "view-8400.token", (ended, ended))
    assert page_token(8400) != first


def test_a_file_that_others_read_or_that_is_none_is_not_believed(place: Path, tmp_path: Path) -> None:
    first, file = page_token(8400), place / "view-8400.token"
    file.chmod(0o644)
    assert page_token(8400) != first
    file.unlink()
    (tmp_path / "elsewhere").write_text(f"{first}\n")
    (tmp_path / "elsewhere").chmod(0o600)
    file.symlink_to(tmp_path / "elsewhere")
    assert page_token(8400) != first
    file.unlink()
    file.write_text("short\n")
    file.chmod(0o600)
    assert page_token(8400) == page_token(8400) != "short"


def test_a_folder_that_others_may_write_keeps_none(place: Path) -> None:
    page_token(8400)
    place.chmod(0o777)
    assert page_token(8400) != page_token(8400)

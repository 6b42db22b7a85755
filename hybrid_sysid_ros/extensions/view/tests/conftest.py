"""Fixtures of the page in a browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hybrid_sysid_ros.rigs.rig import Rig

if TYPE_CHECKING:
    from benchmarks.browser import Chromium
    from hybrid_sysid_ros.extensions.view.tests.shown_rig import ShownRig


@pytest.fixture(autouse=True)
def token_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tokens of tests lie elsewhere than those of this user."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def shown_rig(rig: Rig) -> ShownRig:
    from hybrid_sysid_ros.extensions.view.tests.shown_rig import ShownRig

    return ShownRig(rig)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Chromium]:
    """The browser, whose start takes as long as a page."""
    from benchmarks.browser import Chromium

    with Chromium() as program:
        yield program


@pytest.fixture
def shown(shown_rig: ShownRig, chromium: Chromium) -> Iterator[Callable[..., Any]]:
    """Open the page of the rig; nothing is left behind, and the page had nothing to complain about."""
    from hybrid_sysid_ros.extensions.view.tests.shown_rig import opening

    with opening(shown_rig, chromium) as show:
        yield show

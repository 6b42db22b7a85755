"""Versions: what other packages do not promise is used where it is known to work; without it all works, more slowly."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from hybrid_sysid_ros.core import compilation
from hybrid_sysid_ros.support import versions
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.versions import DAQP_STRUCTURES, FALL_BACK, NUMBA_CACHE, RCLPY_EXECUTOR, WARNED, Guarded
from tests.compiling import twice

ALL = [item for item in vars(versions).values() if isinstance(item, Guarded)]
GUARDED = Guarded(package="numba", part="tests", known=("0.6", "0.70"), cost="tests take longer")


@pytest.fixture(autouse=True)
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is forced, and nobody has warned yet."""
    monkeypatch.delenv(FALL_BACK, raising=False)
    monkeypatch.setenv(WARNED, "")


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch):
    """Install a release of numba, so to speak."""
    return lambda number: monkeypatch.setattr(versions, "installed", lambda package: number)


@pytest.mark.parametrize(
    ("number", "works"),
    [("0.6.0", True), ("0.70.12", True), ("0.70", True), ("0.7.0", False), ("0.61.2", False), ("1.0.6", False)],
)
def test_a_release_is_known_by_its_first_numbers(release, number, works):
    release(number)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        assert GUARDED.usable() is works


def test_one_warning_says_why_and_what_it_costs(release):
    release("0.71.0")
    with pytest.warns(RuntimeWarning) as reported:
        assert not GUARDED.usable()
    assert not GUARDED.usable()
    assert len(reported) == 1
    for words in ("numba 0.71.0", "0.6, 0.70", GUARDED.cost):
        assert words in str(reported[0].message)
    code = "from tests.test_versions import GUARDED, versions; versions.installed = lambda package: '0.71.0'"
    process = subprocess.run(
        [sys.executable, "-c", f"{code}; print(GUARDED.usable())"], capture_output=True, text=True, check=True
    )
    assert (process.stdout, process.stderr) == ("False\n", "")  # the one that started it has warned


def test_a_name_that_is_missing_is_reported_and_so_is_what_is_forced(release, monkeypatch):
    release("0.70.1")
    with pytest.warns(RuntimeWarning, match=r"numba 0\.70\.1 has no _first, _second"):
        assert not GUARDED.usable(["_first", "_second"])
    assert GUARDED.usable()
    monkeypatch.setenv(FALL_BACK, f"rclpy.executor,{GUARDED.name}")
    assert not GUARDED.usable()


def test_where_nothing_can_be_done_without_the_line_says_what_to_install(release):
    release("0.12.0")
    with pytest.raises(UserError, match=r"daqp 0\.12\.0 .*install daqp 0\.11"):
        DAQP_STRUCTURES.usable()


@pytest.mark.parametrize("guarded", ALL, ids=lambda guarded: guarded.name)
def test_what_is_installed_here_is_known(guarded):
    if guarded is RCLPY_EXECUTOR:
        pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
    assert guarded.usable()


@pytest.mark.parametrize("guarded", ALL, ids=lambda guarded: guarded.name)
def test_what_pip_may_install_is_known(guarded):
    """A release beyond the table is beyond the bounds of the package's dependencies, too."""
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text()
    (bounds,) = re.findall(rf'"(?:ros-jazzy-)?{guarded.package}(?:\[\w+\])?(>=[^"]*)"', text)
    if guarded.known:
        *_, minor = guarded.known[-1].split(".")
        major = guarded.known[-1].removesuffix(f".{minor}")
        assert bounds == f">={guarded.known[0]},<{major}.{int(minor) + 1}"


def test_a_kernel_whose_file_cannot_be_locked_is_not_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(compilation, "folder", lambda name, version: tmp_path)
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", property())
    with pytest.warns(RuntimeWarning, match="compiles anew"):
        kernel = compilation.kernel(twice)
    assert kernel(2.0) == 4.0
    assert not list(tmp_path.rglob("*.nb?"))
    assert NUMBA_CACHE.usable()

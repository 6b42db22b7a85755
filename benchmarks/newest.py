"""The newest release of every dependency, bounds or not: install it into a fresh environment and run tests there.

    python -m benchmarks.newest [FOLDER]    # of the environment; a temporary one by default

Exit status: that of the tests. The releases beyond their bounds are listed: where the tests pass, widen the bounds in
pyproject.toml and the table of support/versions.py.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import venv
from importlib.metadata import Distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
EXTRAS = ("ros", "report", "view", "test")
TESTS = (
    *("tests/test_versions.py", "tests/core/test_compilation.py", "tests/core/test_rollout.py"),
    *("tests/control/test_mpc.py", "tests/test_bags.py", "tests/test_identification.py", "tests/test_executors.py"),
    *("tests/test_managed_nodes.py", "tests/test_processes.py"),
)
PROJECT, OF_ROS = "hybrid-sysid-ros", "ros-"
"""Releases of ROS belong to one distribution of it: those are not tried beyond it."""


def requirements(project: Distribution) -> list[Requirement]:
    """What the project needs, with the extras that the tests need."""
    found = [Requirement(line) for line in project.requires or []]
    return [
        item for item in found if item.marker is None or any(item.marker.evaluate({"extra": one}) for one in EXTRAS)
    ]


def _newest(item: Requirement) -> str:
    """What pip is asked for."""
    extras = f"[{','.join(item.extras)}]" if item.extras else ""
    return f"{item.name}{extras}{item.specifier if item.name.startswith(OF_ROS) else ''}"


def _installed(folder: Path) -> dict[str, Distribution]:
    paths = [str(path) for path in folder.glob("lib/python*/site-packages")]
    return {canonicalize_name(item.metadata["Name"]): item for item in distributions(path=paths)}


def main(arguments: list[str]) -> int:
    """Make the environment, list what is beyond its bounds, and run the tests."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(arguments[0]) if arguments else Path(temporary) / "newest"
        venv.create(folder, with_pip=True, clear=True)
        python = str(folder / "bin" / "python")
        pip = [python, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--upgrade"]
        subprocess.run([*pip, "--no-deps", "--editable", str(ROOT)], check=True)
        needed = requirements(_installed(folder)[PROJECT])
        subprocess.run([*pip, *map(_newest, needed)], check=True)
        installed = {name: item.version for name, item in _installed(folder).items()}
        for item in needed:
            release = installed[canonicalize_name(item.name)]
            if not item.specifier.contains(release, prereleases=True):
                print(f"{item.name} {release} is beyond {item.specifier}", flush=True)
        # Beyond its bounds a package falls back, and warns of it: that is no failure here.
        quiet = ["-W", "default::RuntimeWarning", "-p", "no:cacheprovider"]
        return subprocess.run([python, "-m", "pytest", "--quiet", *quiet, *TESTS], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

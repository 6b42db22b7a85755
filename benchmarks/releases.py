"""The oldest or the newest releases of every dependency: install them into a fresh environment and run tests there.

    python -m benchmarks.releases oldest [FOLDER]    # of the environment; a temporary one by default
    python -m benchmarks.releases newest [FOLDER]

The oldest are the lowest that pyproject.toml allows: where the tests fail, raise a bound. The newest are taken whatever
the upper bounds are, and those beyond them are listed: where the tests pass, widen the bounds and the table of
support/versions.py. Exit status: that of the tests.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.metadata import Distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
EXTRAS = ("ros", "report", "view", "test", "export", "video", "mcp", "narx", "search", "notebooks")
"""All that the package can do but training, whose torch is large."""
TESTS = (
    *("tests/test_versions.py", "tests/core/test_compilation.py", "tests/core/test_rollout.py"),
    *("tests/control/test_mpc.py", "tests/test_bags.py", "tests/test_bag_files.py", "tests/test_identification.py"),
    *("tests/test_cli.py", "tests/test_model_folder.py", "tests/test_structures.py"),
    "hybrid_sysid_ros/extensions/report/tests/test_report.py",
    "tests/test_policy_folder.py",
    *("tests/test_executors.py", "tests/test_managed_nodes.py", "tests/test_processes.py", "tests/test_sessions.py"),
    "hybrid_sysid_ros/extensions/export/tests",
    "hybrid_sysid_ros/extensions/commander/tests/test_mcp_server.py",
    "hybrid_sysid_ros/extensions/narx/tests/test_narx.py",
    "hybrid_sysid_ros/extensions/search/tests/test_study.py",
    *(f"hybrid_sysid_ros/extensions/vision/tests/test_{name}.py" for name in ("film", "imager")),
)
PROJECT, OF_ROS = "hybrid-sysid-ros", "ros-"
"""Releases of ROS belong to one distribution of it: those are not tried beyond it."""


def requirements(project: Distribution) -> list[Requirement]:
    """What the project needs, with the extras that the tests need."""
    found = [Requirement(line) for line in project.requires or []]
    return [
        item
        for item in found
        if canonicalize_name(item.name) != PROJECT
        and (item.marker is None or any(item.marker.evaluate({"extra": one}) for one in EXTRAS))
    ]


def _newest(item: Requirement) -> str:
    """What is asked for: no older release than is allowed, as two of the newest may not go together."""
    extras = f"[{','.join(item.extras)}]" if item.extras else ""
    kept = [str(one) for one in item.specifier if item.name.startswith(OF_ROS) or one.operator in (">=", ">", "!=")]
    return f"{item.name}{extras}{','.join(kept)}"


def _installed(folder: Path) -> dict[str, Distribution]:
    paths = [str(path) for path in folder.glob("lib/python*/site-packages")]
    return {canonicalize_name(item.metadata["Name"]): item for item in distributions(path=paths)}


def main(arguments: list[str]) -> int:
    """Make the environment, list what is beyond its bounds, and run the tests."""
    which, *named = arguments or [""]
    if which not in ("oldest", "newest"):
        print("usage: python -m benchmarks.releases oldest|newest [FOLDER]", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(named[0]) if named else Path(temporary) / which
        uv = [sys.executable, "-m", "uv", "--quiet"]
        # pip, which is seeded, brings the sources of DAQP that an export needs.
        subprocess.run([*uv, "venv", "--seed", "--clear", "--python", sys.executable, str(folder)], check=True)
        python = str(folder / "bin" / "python")
        install = [*uv, "pip", "install", "--python", python]
        if which == "oldest":
            subprocess.run(
                [*install, "--resolution", "lowest-direct", "--editable", f"{ROOT}[{','.join(EXTRAS)}]"], check=True
            )
        else:
            subprocess.run([*install, "--no-deps", "--editable", str(ROOT)], check=True)
            needed = requirements(_installed(folder)[PROJECT])
            subprocess.run([*install, "--upgrade", *map(_newest, needed)], check=True)
        installed = _installed(folder)
        for item in requirements(installed[PROJECT]):
            release = installed[canonicalize_name(item.name)].version
            if which == "oldest":
                print(f"{item.name} {release}", flush=True)
            elif not item.specifier.contains(release, prereleases=True):
                print(f"{item.name} {release} is beyond {item.specifier}", flush=True)
        # Beyond its bounds a package falls back, and warns of it: that is no failure here.
        quiet = ["-W", "default::RuntimeWarning", "-p", "no:cacheprovider"]
        return subprocess.run([python, "-m", "pytest", "--quiet", *quiet, *TESTS], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

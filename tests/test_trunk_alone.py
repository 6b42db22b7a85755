"""The trunk works without any of our extensions, and what is left without each one."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
import yaml

from hybrid_sysid_ros.runtime.processes import has_ros
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.extensions import HOME
from hybrid_sysid_ros.support.manifest import Extension
from tests.apart import COMMANDS, ROOT, apart_in

PACKAGE = ROOT / "hybrid_sysid_ros"
OURS = sorted(path.parent.name for path in HOME.glob("*/extension.py"))

ALONE = """
import importlib.util
from hybrid_sysid_ros.rigs import folder, rig
from hybrid_sysid_ros.support import extensions
assert not {away} & {{item.name for item in extensions.installed()}}
for name in {away}:
    assert importlib.util.find_spec(f"hybrid_sysid_ros.extensions.{{name}}") is None
for name in folder.names():
    rig.load(name)
for module in {modules}:
    importlib.import_module(module)
for item in extensions.registry().extensions:  # those that are left need none that is not there
    for target in (target for names in item.provides.values() for target in names.values() if target):
        extensions.loaded(target)
    for module in (*(module for module, _ in item.commands.values()), *({ros} and item.nodes.values() or ())):
        importlib.import_module(module)
assert not extensions.registry().problems
"""


def trunk_modules() -> list[str]:
    """Those of the trunk that need nothing but what any install has; its nodes, too, where there is ROS."""
    files = [path.relative_to(PACKAGE) for path in PACKAGE.glob("*/**/*.py")]
    files += [Path("nodes") / path.name for path in (ROOT / "nodes").glob("*.py")] if has_ros() else []
    kept = [path for path in files if "extensions" not in path.parts]
    return sorted(
        {f"hybrid_sysid_ros.{'.'.join(path.with_suffix('').parts)}".removesuffix(".__init__") for path in kept}
    )


HELP = ("--help", "run --help", "demo --help", "parameters")


@pytest.fixture
def without(tmp_path: Path) -> Callable[..., str]:
    """What command lines print, and code after them, where the folders of some extensions were taken away."""

    def printed(away: list[str], *lines: str, modules: Sequence[str] = ()) -> str:
        package = tmp_path / "site" / "hybrid_sysid_ros"
        shutil.rmtree(package, ignore_errors=True)  # links
        (package / "extensions").mkdir(parents=True)
        for path in PACKAGE.iterdir():
            if path.name not in ("extensions", "__pycache__"):
                (package / path.name).symlink_to(path.resolve() if path.name == "nodes" else path)
        for path in HOME.iterdir():
            if path.name not in (*away, "__pycache__"):
                (package / "extensions" / path.name).symlink_to(path)
        found = apart_in(tmp_path)(
            code=COMMANDS + ALONE.format(away={*away}, modules=modules, ros=has_ros()), lines=lines
        )
        assert (found.returncode, found.stderr) == (0, ""), (away, found.stderr)
        return found.stdout

    return printed


@pytest.mark.slow
def test_the_rest_works_without_each(without: Callable[..., str]) -> None:
    """Each is away in four of eight runs, and no two in the same four: so each is once there without any other."""
    times = dict(zip(OURS, combinations(range(8), 4), strict=False))
    assert times.keys() == {*OURS}
    for run in range(8):
        away = [name for name in OURS if run in times[name]]
        lines = [line for line in HELP if line.split()[0] not in away]
        assert "hybrid-sysid" in without(away, *lines)


def test_the_trunk_works_alone(without: Callable[..., str]) -> None:
    """With what checks a rig, to see what it says of the sections of the others."""
    others = [name for name in OURS if name != "checks"]
    lines = [line for line in HELP if line.split()[0] not in OURS]
    printed = without([*others, "shared"], *lines, "rig check cam_beam", modules=trunk_modules())
    assert "cam_beam: no problems" in printed
    sections = {name: item.name for item in extensions.installed() for name in item.provides.get("sections", ())}
    reported = set(re.findall(r"^note: (\w+): no extension", printed, re.M))
    known = yaml.safe_load((PACKAGE / "rigs" / "cam_beam" / "rig.yaml").read_text(encoding="utf-8"))
    assert reported == {name for name, owner in sections.items() if owner in OURS and name in known}


def test_sections_of_ours_are_known_without_them() -> None:
    from hybrid_sysid_ros.rigs.rig import OF_EXTENSIONS

    ours: dict[str, Any] = {item.name: item for item in extensions.installed() if item.name in OURS}
    found = {name for item in ours.values() for name in item.provides.get("sections", ())}
    assert found <= set(OF_EXTENSIONS)


def test_every_name_in_a_manifest_leads_somewhere() -> None:
    item: Extension
    for item in extensions.registry().extensions:
        for name, target in ((name, target) for names in item.provides.values() for name, target in names.items()):
            assert not target or callable(extensions.loaded(target)), name
        modules = [*(module for module, _ in item.commands.values()), *item.nodes.values()]
        for module in modules:
            assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), module

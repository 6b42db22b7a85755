"""What the package says of itself: its executables and what it depends on, in the places where tools look."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import setuptools  # type: ignore[import-untyped]

from hybrid_sysid_ros.support import extensions, trunk
from hybrid_sysid_ros.support.structured import read_mapping

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli", reason="needs Python 3.11 to read pyproject.toml")

ROOT = Path(__file__).parents[1]
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
DEPENDS = {item.text for item in MANIFEST.findall("exec_depend")}
ROS = "_(msgs|srvs|interfaces)$|^rcl|^launch"
NODES_OF_EXTENSIONS = [str(path.relative_to(ROOT)) for path in extensions.HOME.glob("*/nodes")]
NAMES = {"PyYAML": "yaml"}
"""What apt calls a library otherwise than PyPI does."""


def imported(folder: str) -> set[str]:
    """Packages that are imported anywhere in a folder."""
    found: set[str] = set()
    for path in (ROOT / folder).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {item.name.partition(".")[0] for item in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module.partition(".")[0])
    return found


def requirements(text: str) -> dict[str, str]:
    """Versions by the name of the library."""
    return dict(re.findall(r"^([\w.-]+)\s*(.*)$", text, re.M))


def test_the_manifest_names_every_package_of_ros_that_is_imported() -> None:
    ros = {
        name
        for name in set().union(*(imported(folder) for folder in ("nodes", "launch", *NODES_OF_EXTENSIONS)))
        if re.search("_(msgs|srvs|interfaces)$|^rcl|^launch", name)
    }
    assert ros <= DEPENDS
    assert {"rclpy", "launch", "sensor_msgs"} <= ros


def test_what_pip_brings_to_a_sourced_ros_is_what_the_package_needs() -> None:
    """All but what apt has in a version that will do: of Ubuntu 24.04 these."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    needed = requirements("\n".join([*project["dependencies"], *extras["report"], *extras["view"]]))
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    sourced = page.partition("## On a sourced Jazzy")[2].partition("colcon build")[0]
    reported = requirements("\n".join(re.findall(r"'([^']+)'", sourced)))
    by_apt = {"numpy", "scipy", "PyYAML", "rich"}
    assert reported == {name: version for name, version in needed.items() if name not in by_apt}
    for name in by_apt:
        assert f"python3-{NAMES.get(name, name)}" in DEPENDS


def test_every_node_with_a_main_is_an_executable_wherever_tools_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """setup.py reads the manifests without the package; colcon gives the executables the nodes' own names."""
    given: dict[str, Any] = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", lambda **settings: given.update(settings))
    runpy.run_path("setup.py")
    scripts = dict(line.split(" = ") for line in given["entry_points"]["console_scripts"])
    assert scripts.pop("hybrid-sysid").startswith("hybrid_sysid_ros.")
    assert given["entry_points"]["pipx.run"] == ["hybrid_sysid_ros = hybrid_sysid_ros.__main__:main"]
    nodes = {node for extension in extensions.registry().extensions for node in extension.nodes}
    assert scripts.keys() == nodes >= {"plant", "composed"}
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    for node in nodes:
        assert (ROOT / "resource" / "executables" / node).exists()
        module = extensions.node_module(node).replace(".", "/")
        assert re.search(r"^main = |^def main", (ROOT / f"{module}.py").read_text(encoding="utf-8"), re.M)
        assert f"`{node}`" in page


def test_the_diagnostics_of_every_node_of_a_loop_are_in_one_group_of_the_aggregator() -> None:
    content = read_mapping(ROOT / "msgs_config" / "diagnostic_aggregator.yaml")["analyzers"]["ros__parameters"]
    for group in content.values():
        if isinstance(
            group, dict
        ):  # as diagnostic_aggregator's GenericAnalyzer reads it: an integer would end the node
            kinds = {"type": str, "path": str, "regex": list, "timeout": float}
            assert {key: type(value) for key, value in group.items()} == kinds
    groups = [re.compile(group["regex"][0]) for group in content.values() if isinstance(group, dict)]
    for node in trunk.TRUNK.nodes.keys() - {"composed"}:
        assert sum(bool(group.fullmatch(f"cam_beam/{node}: loop")) for group in groups) == 1, node

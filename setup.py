"""What colcon reads too: the rest is in pyproject.toml, which colcon does not link into a --symlink-install."""

import ast
import sys
from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import Distribution, find_namespace_packages, setup

NAME = "hybrid_sysid_ros"
MANIFESTS = [f"{NAME}/support/trunk.py", *sorted(glob(f"{NAME}/extensions/*/extension.py"))]


def nodes(manifest):
    """Names of the nodes of a manifest, which is read, not run: nothing that it needs is installed yet."""
    words = ast.walk(ast.parse(Path(manifest).read_text(encoding="utf-8")))
    tables = [word.value for word in words if isinstance(word, ast.keyword) and word.arg == "nodes"]
    return [key.value for table in tables for key in table.keys]


def pages():
    """Pages of the documentation and their pictures by folder, laid out as here, so that their links work."""
    folders = {}
    for place in ("docs", f"{NAME}/extensions/*/docs"):
        for page in sorted(glob(f"{place}/**/*.*", recursive=True)):
            if page.endswith((".md", ".svg", ".png")):
                folders.setdefault(str(Path(page).parent), []).append(page)
    return folders


NODES = [node for manifest in MANIFESTS for node in nodes(manifest)]
PIP = not {"bdist_wheel", "dist_info", "editable_wheel", "sdist"}.isdisjoint(sys.argv)

# `ros2 run` looks in lib/hybrid_sysid_ros. colcon installs the console scripts there, under the nodes' own names; pip
# installs them in bin/, where such names would be too general, so there they get a prefix and lib/ a link to each.
scripts = {f"hybrid-sysid-{node}" if PIP else node: f"{NAME}.nodes.executable:main" for node in NODES}
links = [(f"lib/{NAME}", [f"resource/executables/{node}" for node in NODES])] if PIP else []


class DistributionWithData(Distribution):
    """setuptools copies data files into an editable install only where the distribution says that it has data."""

    has_data = Distribution.has_data_files


setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    license="Apache-2.0",
    python_requires=">=3.10,<3.14",
    packages=find_namespace_packages(  # data folders too
        include=[NAME, f"{NAME}.*"], exclude=["*.__pycache__", f"{NAME}.extensions.*.tests"]
    ),
    package_data={
        "": [
            "*.yaml",
            "*.xml",
            "*.json",
            "*.safetensors",
            "*.html",
            "*.js",
            "*.css",
            "*.txt",
            "*.c",
            "*.h",
            "*.hpp",
            "*.cpp",
            "*.ld",
            "Makefile",
            "README.md",
        ]
    },
    entry_points={
        "console_scripts": [
            f"hybrid-sysid = {NAME}.__main__:main",
            *(f"{script} = {main}" for script, main in scripts.items()),
        ],
        "pipx.run": [f"{NAME} = {NAME}.__main__:main"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "CHANGELOG.rst"]),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{NAME}/config", sorted(glob("msgs_config/*.yaml"))),
        *((f"share/{NAME}/{folder}", files) for folder, files in pages().items()),
        *links,
    ],
    distclass=DistributionWithData,
)

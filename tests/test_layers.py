"""Imports run downwards only, ROS stays in nodes/, and heavy libraries stay in the rooms that need them."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from glob import glob
from pathlib import Path

import pytest

PACKAGE = "hybrid_sysid_ros"
FOLDER = Path(__file__).parents[1] / PACKAGE

LAYERS = [  # from the bottom up; a room (folder of the package) imports from the rooms of lower layers
    {"__init__"},
    {"support"},
    {"bags", "core"},
    {"rigs"},
    {"models"},
    {"estimation", "identification"},
    {"control", "structures"},
    {"runtime"},
    {"report"},
    {"library"},
    {"commands", "nodes"},
    {"extensions", "__main__"},
]
DOORS = {("__init__", room) for room in ("library", "bags", "rigs", "support")}
"""What the package offers by its own name, once somebody asks for it."""
ROS = re.compile(r"(rcl\w*|ros2\w*|rosbag2\w*|rosidl\w*|ament_\w+|tf2_\w+|\w+_msgs|\w+_interfaces|std_srvs)")
NODES = re.compile(r"nodes/.*|extensions/\w+/nodes/.*|extensions/native/rig_text\.py")
"""Files that may import ROS. The last prints what the nodes say of their topics, and is imported where it is used."""
LAUNCH = re.compile(r"launch\w*")
KEPT_IN = {  # heavy libraries, and the files that may import them
    "torch": re.compile(r"extensions/(policies/(network|training)|recurrent/training)\.py"),
    "casadi": re.compile(r"(core/\w+|extensions/ipopt/interior_point)\.py"),
    "sysidentpy": re.compile(r"extensions/narx/term_selection\.py"),
    "optuna": re.compile(r"extensions/(search/study|shared/(database|trials)|tuning/front)\.py"),
    "joblib": re.compile(r"extensions/shared/parallel\.py"),
    "dask": re.compile(r"extensions/shared/cluster\.py"),
    "distributed": re.compile(r"extensions/shared/cluster\.py"),
    "onnx": re.compile(r"extensions/export/onnx_graph\.py"),
    **dict.fromkeys(("asammdf", "h5py", "nptdms", "pyulog"), re.compile(r"extensions/importing/readers/\w+\.py")),
    "polars": re.compile(r"extensions/importing/readers/\w+\.py"),
    "plotly": re.compile(r"extensions/\w+/report/.*"),
    "mcp": re.compile(r"extensions/commander/language/server\.py"),
    "websockets": re.compile(r"extensions/view/server\.py"),
    "jinja2": re.compile(r"extensions/shared/report/.*"),
    "av": re.compile(r"extensions/vision/camera/(film|quantisation)\.py"),
    "PIL": re.compile(r"extensions/(vision/camera/jpeg|commander/language/charts)\.py"),
}
AT_THE_TOP = re.compile(
    r"core/casadi_form\.py|extensions/ipopt/interior_point\.py"
    r"|extensions/policies/(network|training)\.py|extensions/\w+/report/(charts|\w*figures)\.py|extensions/(view/server|commander/language/(server|charts))\.py"
)
"""Files that import one of them at once, and are themselves imported late; all others import it where they use it."""


def imports(source: str, file: str) -> Iterator[str]:
    """Full names that a file of the package imports, at any depth of its code."""
    package = [PACKAGE, *Path(file).parent.parts]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            module = ".".join([*base, *filter(None, [node.module])])
            yield from (f"{module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and _called(node).endswith(("import_module", "__import__")):
            yield from (str(name.value) for name in node.args[:1] if isinstance(name, ast.Constant))


def _called(node: ast.Call) -> str:
    return str(getattr(node.func, "attr", getattr(node.func, "id", "")))


def room(path: str) -> str:
    """control/mpc.py is in the room control, __main__.py is a room itself."""
    return Path(path).parts[0].removesuffix(".py")


def layer(room: str) -> int:
    return next((height for height, rooms in enumerate(LAYERS) if room in rooms), -1)


def violations(source: str, file: str) -> list[str]:
    """What is wrong with the imports of a file, given by its path inside the package."""
    here = room(file)
    if layer(here) < 0:
        return [f"{file}: {here} has no layer yet: give it one in {Path(__file__).name}"]
    found = []
    for name in imports(source, file):
        top, _, rest = name.partition(".")
        if ROS.fullmatch(top) and not NODES.fullmatch(file):
            found.append(f"{file}: {name} is ROS, which only nodes/ imports")
        if top == PACKAGE and rest.partition(".")[0] == "extensions" and here != "extensions":
            found.append(f"{file}: {name} is an extension, which may be absent: ask support.extensions for it")
            continue
        if top == PACKAGE and NODES.fullmatch(f"{rest.replace('.', '/')}/") and not NODES.fullmatch(file):
            found.append(f"{file}: {name} is of the nodes, which need ROS")
            continue
        if top == "studies":
            found.append(f"{file}: {name} is a study, which stands on the library")
        if LAUNCH.fullmatch(top):
            found.append(f"{file}: {name} is for launch files only")
        if top in KEPT_IN and not KEPT_IN[top].fullmatch(file):
            found.append(f"{file}: {name} belongs into {KEPT_IN[top].pattern}")
        if top == PACKAGE and rest:
            there = room(rest.replace(".", "/"))
            known = layer(there) >= 0
            if known and there != here and layer(there) >= layer(here) and (here, there) not in DOORS:
                found.append(f"{file}: {here} may not import {there}")
    return found


TESTS = re.compile(r"extensions/\w+/tests/.*|extensions/driver/template/.*")  # copied to a user with ROS
FOUND = glob("**/*.py", root_dir=FOLDER, recursive=True)  # follows the link to nodes/
FILES = sorted(path for path in FOUND if not TESTS.fullmatch(path))


def test_all_rooms_are_looked_at() -> None:
    assert {"core/__init__.py", "support/errors.py", "nodes/__init__.py"} <= set(FILES)


def test_every_room_that_has_a_layer_is_there() -> None:
    assert {room(file) for file in FILES} | {"extensions"} == set().union(*LAYERS)


def test_every_file_that_may_import_a_heavy_library_is_there() -> None:
    """Of the trunk: those of an extension may be absent with it."""
    for pattern in KEPT_IN.values():
        assert pattern.pattern.startswith("extensions/") or any(pattern.fullmatch(file) for file in FILES)


def test_imports_run_downwards() -> None:
    texts = {file: (FOLDER / file).read_text(encoding="utf-8") for file in FILES}
    assert [line for file, text in texts.items() for line in violations(text, file)] == []


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("models/hybrid_system.py", "import rclpy.node"),
        ("models/hybrid_system.py", "def late():\n    from sensor_msgs.msg import JointState"),
        ("bags/bag.py", "import importlib\nimportlib.import_module('rosbag2_py')"),
        ("commands/run.py", "from hybrid_sysid_ros.nodes import plant"),
        ("nodes/plant.py", "from launch import LaunchDescription"),
        ("control/policy/policy.py", "from torch import nn"),
        ("identification/fitting.py", "def late():\n    from torch import nn"),
        ("models/linear.py", "import sysidentpy"),
        ("control/mpc/mpc.py", "from casadi import SX"),
        ("identification/fitting.py", "import optuna"),
        ("identification/fitting.py", "import plotly"),
        ("identification/fitting.py", "from hybrid_sysid_ros.estimation import kalman"),
        ("report/page.py", "from studies.beam_lecture.protocol import table"),
        ("bags/reading.py", "from hybrid_sysid_ros import report"),
        ("rigs/cam_beam/system.py", "from hybrid_sysid_ros import models"),
        ("rigs/rig.py", "from ..models.hybrid import Hybrid"),
        ("rigs/rig.py", "from .. import control"),
        ("bags/record.py", "from ..rigs import rig"),
        ("estimation/kalman.py", "import hybrid_sysid_ros.control.mpc.mpc"),
        ("__init__.py", "from hybrid_sysid_ros.commands.app import main"),
        ("attic/old.py", "import math"),
        ("commands/run.py", "from hybrid_sysid_ros.extensions.view import server"),
        ("nodes/plant.py", "def late():\n    from hybrid_sysid_ros.extensions.vision import scene"),
        ("support/extensions.py", "import importlib\nimportlib.import_module('hybrid_sysid_ros.extensions.view')"),
        ("extensions/view/server.py", "from sensor_msgs.msg import JointState"),
        ("extensions/view/server.py", "from hybrid_sysid_ros.nodes import topics"),
        ("extensions/view/server.py", "import av"),
    ],
)
def test_a_forbidden_import_is_found(file: str, source: str) -> None:
    assert len(violations(source, file)) == 1


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("nodes/plant.py", "import rclpy\nfrom hybrid_sysid_ros.control import mpc"),
        ("extensions/policies/training.py", "import torch\nfrom hybrid_sysid_ros.estimation import kalman"),
        ("control/mpc/mpc.py", "from . import shooting\nfrom .shooting import Shooting\nfrom ...models import hybrid"),
        ("extensions/recurrent/training.py", "def late():\n    import torch"),
        (
            "extensions/view/report/figures.py",
            "import plotly.graph_objects\nfrom hybrid_sysid_ros import identification",
        ),
        ("extensions/view/nodes/view.py", "import rclpy\nfrom hybrid_sysid_ros.nodes import topics"),
        ("extensions/view/server.py", "import websockets\nfrom hybrid_sysid_ros.runtime import parameters"),
        ("bags/bag.py", "import rosbags.rosbag2\nfrom hybrid_sysid_ros.support.errors import UserError"),
    ],
)
def test_an_allowed_import_is_not(file: str, source: str) -> None:
    assert violations(source, file) == []


WITHOUT = """
import importlib, sys
class Absent:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
for name in {names}:
    importlib.import_module(name)
"""


def test_the_library_imports_without_ros_and_without_extras() -> None:
    free = [file for file in FILES if not NODES.fullmatch(file) and not AT_THE_TOP.fullmatch(file)]
    assert "identification/fitting.py" in free
    modules = [file.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for file in free]
    names = [PACKAGE if module == "__init__" else f"{PACKAGE}.{module}" for module in modules]
    absent = [*(set(KEPT_IN) - {"casadi"}), "rclpy", "sensor_msgs"]  # casadi traces every law
    subprocess.run([sys.executable, "-c", WITHOUT.format(absent=absent, names=names)], check=True, timeout=300)

"""Where the headers and libraries of ROS 2 are: of a sourced installation, or of the wheels of this Python."""

from __future__ import annotations

import os
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

MESSAGES = (
    "builtin_interfaces", "diagnostic_msgs", "lifecycle_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs",
    "std_msgs", "std_srvs", "trajectory_msgs",
)  # fmt: skip
LIBRARIES = ("rcl", "rcl_lifecycle", "rcl_yaml_param_parser", "rcutils", "rmw", "rosidl_runtime_c")
HEADER = Path("rcl/rcl/rcl.h")


@dataclass(frozen=True, kw_only=True)
class RosLibraries:
    """Flags of the C compiler for a program that uses rcl."""

    include: tuple[str, ...]
    link: tuple[str, ...]
    where: str


def ros_libraries() -> RosLibraries:
    """Those of the sourced ROS 2, else of the wheels. Raises UserError where there are no headers of rcl."""
    sourced = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    prefixes = [prefix for prefix in (*sourced, Path(sys.prefix)) if (prefix / "include" / HEADER).is_file()]
    if not prefixes:
        raise UserError(
            f"--native: there are no headers of ROS 2 ({HEADER}) in {sys.prefix} or a sourced ROS 2: install "
            "hybrid_sysid_ros[ros], or source a ROS 2 Jazzy; without --native the loop runs in Python"
        )
    home = prefixes[0]
    include = [f"-I{path}" for prefix in dict.fromkeys((*prefixes, *sourced)) for path in _folders(prefix / "include")]
    places = [home / "lib", *(prefix / "lib" for prefix in sourced)]
    names = [*LIBRARIES, *(f"{item}__rosidl_{part}" for item in MESSAGES for part in ("typesupport_c", "generator_c"))]
    link = [f"-L{place}" for place in dict.fromkeys(places)]
    if home not in sourced:  # the middleware of the wheels needs libpython, and libraries beside the packages
        python = sysconfig.get_config_var("LIBDIR")
        places += [Path(python), *sorted(Path(sysconfig.get_path("platlib")).glob("ros_*.libs"))]
        link += [f"-L{python}", "-Wl,--no-as-needed", f"-lpython{sysconfig.get_config_var('LDVERSION')}"]
    link += [f"-l{name}" for name in names]
    link += ["-Wl,--allow-shlib-undefined", "-Wl,--disable-new-dtags"]
    link += [f"-Wl,-rpath,{place}" for place in dict.fromkeys(places)]
    return RosLibraries(include=tuple(include), link=tuple(link), where=str(home))


def _folders(place: Path) -> list[Path]:
    """Folders of headers, one for each package of ROS."""
    return [path for path in sorted(place.glob("*")) if path.is_dir() and not path.name.startswith("python")]

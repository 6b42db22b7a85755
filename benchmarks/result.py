"""Results: what a benchmark measured, with the machine and the versions that it was measured on, as JSON."""

from __future__ import annotations

import json
import math
import os
import platform
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_file

RESULTS = Path(__file__).parent / "results"
PACKAGES = (
    "hybrid_sysid_ros",
    "numpy",
    "scipy",
    "numba",
    "casadi",
    "torch",
    "filterpy",
    "mcap",
    "rosbags",
    "ros-jazzy-rclpy",
)


def machine() -> dict[str, Any]:
    """Processor, cores, memory and system, and how busy they are with other things (load over the last minute)."""
    names = [line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else math.nan
    return {
        "processor": names[0] if names else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "memory_gb": round(pages / 1e9, 1),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "load_before": round(os.getloadavg()[0], 2),
    }


def versions() -> dict[str, str]:
    """Versions of the packages that matter, of those that are installed."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def percentiles(values: ArrayLike) -> dict[str, float]:
    """p50, p99 and max of values."""
    array = np.asarray(values, dtype=float)
    return {"p50": float(np.percentile(array, 50)), "p99": float(np.percentile(array, 99)), "max": float(array.max())}


def spread(values: ArrayLike) -> dict[str, float]:
    """Mean, min and max of values, one of each seed."""
    array = np.asarray(values, dtype=float)
    return {"mean": float(array.mean()), "min": float(array.min()), "max": float(array.max())}


def write(name: str, results: Mapping[str, Any], *, on: Mapping[str, Any] | None = None) -> Path:
    """Write benchmarks/results/NAME.json; on: machine() as it was before the benchmark."""
    content = {"benchmark": name, "machine": dict(on or machine()), "versions": versions(), "results": results}
    path = RESULTS / f"{name}.json"
    with written_file(path) as partial:
        partial.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path


def run(main: Callable[[], int]) -> NoReturn:
    """Run a benchmark's main() and exit with its status, or with 2 and one line for what a user can cause."""
    try:
        sys.exit(main())
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []

"""Long measurements in runs of a quarter of an hour: the next run goes on from what the last one left."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import hybrid_sysid_ros
from hybrid_sysid_ros.support.files import written_file

LONGEST = 14 * 60.0
"""Seconds after which a run stops, and the next one goes on."""
Results = dict[str, dict[str, dict[str, float]]]
"""By group and key, numbers by name."""


def resumed(part: Path, tasks: Iterable[tuple[str, str, Callable[[], dict[str, float]]]]) -> Results:
    """Results of tasks, each with its group and key: those in the file ``part``, unless the package has changed since,
    and those that can be had before LONGEST.
    """
    begun, version = time.perf_counter(), _version()
    try:
        content = json.loads(part.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        content = {}
    found: Results = content["done"] if content.get("version") == version else {}
    for group, key, task in tasks:
        done = found.setdefault(group, {})
        if key not in done and time.perf_counter() - begun < LONGEST:
            done[key] = task()
            with written_file(part) as partial:
                partial.write_text(json.dumps({"version": version, "done": found}), encoding="utf-8")
    return found


def _version() -> str:
    """What identifies the package's code."""
    folder, digest = Path(hybrid_sysid_ros.__file__).parent, hashlib.sha256()
    for room in ("core", "models", "identification", "structures", "rigs", "extensions/experiment_design"):
        for file in sorted((folder / room).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()

"""Long measurements in runs of a quarter of an hour: the next run goes on from what the last one left."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.support.files import written_file

ROOT = Path(__file__).parents[1]
LONGEST = 14 * 60.0
"""Seconds after which a run stops, and the next one goes on."""
Task = tuple[str, str, Callable[[], Mapping[str, Any]]]
"""Its group and key, and what finds its result."""
Results = dict[str, dict[str, dict[str, Any]]]
"""By group and key, what was found by name."""


def resumed(part: Path, tasks: Iterable[Task], code: str) -> Results:
    """Results of tasks: those in the file ``part``, where they are of the same code (:func:`digest`), and those that
    can be had before LONGEST.
    """
    begun = time.perf_counter()
    try:
        content = json.loads(part.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        content = {}
    found: Results = content["done"] if content.get("version") == code else {}
    for group, key, task in tasks:
        done = found.setdefault(group, {})
        if key not in done and time.perf_counter() - begun < LONGEST:
            done[key] = dict(task())
            print(f"  {group}, {key}: {done[key]}", flush=True)
            part.parent.mkdir(parents=True, exist_ok=True)
            with written_file(part) as partial:
                partial.write_text(json.dumps({"version": code, "done": found}, indent=1), encoding="utf-8")
    return found


def digest(*places: str) -> str:
    """What identifies the code in files and folders of the repository."""
    found = hashlib.sha256()
    for place in places:
        path = ROOT / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            found.update(file.read_bytes())
    return found.hexdigest()

"""Every published table, made again: python -m benchmarks all-tables [--again].

Commands run one after the other on a machine that does nothing else. What is finished is kept in out/all_tables.json,
so that the same command goes on after an interruption; a change of the sources or of a library begins from the first.
Benchmarks of real records need HYBRID_SYSID_DATA, see docs/guides/bags.md.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import result
from hybrid_sysid_ros.support.files import written_file

ROOT = Path(__file__).parents[1]
DONE = ROOT / "out" / "all_tables.json"
DATA = "HYBRID_SYSID_DATA"
TABLES: dict[str, tuple[str, ...]] = {
    **{f"benchmarks.{name}": () for name in (
        "identification", "protocols", "public", "trust", "input_sampling", "drill_string", "flexible_joint",
        "wheel_motor", "winged_cone", "fuzzy", "estimators", "mpc_speed", "mpc_gallery", "mpc_batch", "tune",
        "tune_bound", "closed_loop", "policy", "certificates", "accuracy", "meaning", "commander", "camera",
        "loop_timing", "message_cost", "live_view", "start", "bag_reading", "bodies", "exports", "generated", "native",
        "composed", "fuzz", "loop_fuzz", "false_alarms", "fault_rehearsal", "faults", "soak",
    )},
    "studies.drill_string": ("record", DATA),
}  # fmt: skip
"""Modules with their arguments, in the order in which they run: identification first, since others use its models. DATA
stands for the folder of the real records.
"""
OF_RECORDS = {f"benchmarks.{name}" for name in ("identification", "protocols", "public", "input_sampling")}
"""Benchmarks that end without an error where that folder is missing: then they are not finished."""


def main(arguments: Sequence[str]) -> int:
    """Run what is not finished; return 1 if something failed, 2 for another argument than --again."""
    if unknown := set(arguments) - {"--again"}:
        print(f"error: all-tables takes --again, not {min(unknown)}", file=sys.stderr)
        return 2
    key, folder, failed = digest(), os.environ.get(DATA), list[str]()
    done = {} if arguments else finished(key)
    for module, given in TABLES.items():
        if module in done:
            print(f"== {module}: done before", flush=True)
            continue
        if not folder and (DATA in given or module in OF_RECORDS):
            print(f"== {module}: skipped, {DATA} is not set", flush=True)
            continue
        print(f"== {module}", flush=True)
        command = [sys.executable, "-m", module, *(folder or "" if item == DATA else item for item in given)]
        began = time.monotonic()
        if subprocess.run(command, check=False, cwd=ROOT).returncode:
            failed.append(module)
            continue
        done[module] = round(time.monotonic() - began, 1)
        DONE.parent.mkdir(exist_ok=True)
        with written_file(DONE) as partial:
            partial.write_text(json.dumps({"key": key, "seconds": done}, indent=1) + "\n", encoding="utf-8")
    for module in failed:
        print(f"error: failed: {module}", file=sys.stderr)
    return 1 if failed else 0


def finished(key: str) -> dict[str, float]:
    """Seconds of the finished commands by module; none where they are of other sources."""
    try:
        content = json.loads(DONE.read_text(encoding="utf-8"))
        return dict(content["seconds"]) if content["key"] == key else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def digest() -> str:
    """Digest of the package's sources and of the versions of what it needs."""
    found = hashlib.sha256(json.dumps(result.versions()).encode())
    for folder in ("hybrid_sysid_ros", "benchmarks", "studies"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()[:16]

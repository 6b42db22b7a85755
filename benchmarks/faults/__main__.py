"""Faults on a loop of real processes: python -m benchmarks.faults [NAME...].

Of each: whether all inputs stayed within their bounds and the rig within its travel, how long the diagnostics took to
name it in its own words, how long the loop needed to come back after its end, and whether no node ended or showed a
traceback. Asked: a name within 1 s, back within 1 s of its end.
"""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Sequence
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.faults.faults import CLOCKED, FAULTS
from benchmarks.faults.stage import PATIENCE, Said, Stage
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

RIG, NAME, DOMAIN = "cam_beam", "faults", 91
EVERY = {**FAULTS, **CLOCKED}
LOST: dict[str, Any] = {
    **dict.fromkeys(("bounded", "inside_travel"), False),
    **dict.fromkeys(("named_after_s", "recovered_after_s"), math.inf),
    "grown_mb": 0.0,
    "usual": [],
}
"""What is said of a fault after which the loop was not there any more."""
CALM = 2.0
"""Without a word in the diagnostics, before each fault; what they say then all the same doesn't name it [s]."""
SOON = 1.0
"""Asked of names and of recovery [s]."""


def tried(stage: Stage, name: str) -> dict[str, Any]:
    """One fault, and what was seen."""
    stage.calm(CALM)
    stage.started = calm = time.monotonic()
    lines, memory = len(stage.lines), stage.memory()
    fault, words = EVERY[name]
    fault(stage)
    before, over = stage.started, time.monotonic()
    recovered = stage.wait_until_back(over)
    time.sleep(0.6)  # the diagnostics of the last moments
    usual = {phrase for said in stage.said if calm - CALM <= said.time < calm for phrase in phrases(said)}
    later = [said for said in stage.said if before <= said.time]
    named = [(said, phrase) for said in later for phrase in phrases(said) - usual if re.search(words, phrase)]
    traces = [line for line in stage.lines[lines:] if "Traceback" in line]
    return {
        "bounded": stage.bounded(before),
        "inside_travel": stage.inside(before),
        "named_after_s": named[0][0].time - before if named else math.inf,
        "named": named[0][1] if named else "",
        "recovered_after_s": max(recovered, 0.0),
        "lasted_s": over - before,
        "grown_mb": max(found - memory.get(process, found) for process, found in stage.memory().items()),
        "held": not traces and math.isfinite(recovered),
        "usual": sorted(usual),
    }


def phrases(said: Said) -> set[str]:
    """What a status says, without its numbers."""
    parts = re.sub(r"[\d.]+ ?", "", said.message).split(",")
    return {f"{said.name.rpartition('/')[2]}: {part.strip()}" for part in parts}


def falls_short(name: str, found: dict[str, Any]) -> bool:
    """Whether something that is asked was not so."""
    named = not EVERY[name][1] or found["named_after_s"] <= SOON
    sound = found["bounded"] and found["inside_travel"] and found["held"]
    return not (sound and named and found["recovered_after_s"] <= SOON)


def played(names: Sequence[str], *, clocked: bool) -> dict[str, dict[str, Any]]:
    """Some faults, one after the other, on one loop while that holds."""
    found: dict[str, dict[str, Any]] = {}
    waiting = list(names)
    while waiting:
        with Stage(load(RIG), domain=DOMAIN, clocked=clocked) as stage:
            while waiting:
                name = waiting.pop(0)
                status.print(name)
                try:
                    found[name] = tried(stage, name)
                    for phrase in found[name]["usual"]:
                        status.print(f"{name}: said before, for {PATIENCE:g} s: {phrase}")
                    stage.alive()
                except UserError as error:
                    found[name] = {**LOST, **found.get(name, {}), "held": False, "named": str(error)}
                if not found[name]["held"]:
                    break  # the next one finds a loop that runs
    return found


def main() -> int:
    """Try those that are named, or all; print the table and write the JSON."""
    chosen = sys.argv[1:] or list(EVERY)
    for name in chosen:
        if name not in EVERY:
            raise UserError(f"no fault {name!r}: known are {', '.join(EVERY)}")
    machine = result.machine()
    found: dict[str, dict[str, Any]] = {}
    for clocked in (False, True):
        found |= played([name for name in chosen if (name in CLOCKED) == clocked], clocked=clocked)
    table = Table(
        "fault", "bounded", "inside", "named [s]", "back [s]", "held", "grown [MB]", "in words", title="faults"
    )
    for name, row in found.items():
        marks = ["yes" if row[key] else "NO" for key in ("bounded", "inside_travel", "held")]
        times = [f"{row[key]:.2f}" for key in ("named_after_s", "recovered_after_s")]
        shown = name if not falls_short(name, row) else f"{name}  <- short"
        table.add_row(shown, *marks[:2], *times, marks[2], f"{row['grown_mb']:.1f}", row["named"])
    print_table(table)
    short = sum(falls_short(name, row) for name, row in found.items())
    print(f"{short} of {len(found)} fall short")
    if chosen == list(EVERY):
        print(result.write(NAME, {**found, "short": short, "patience_s": PATIENCE}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)

"""Faults on a loop of real processes: python -m benchmarks.faults [NAME...].

Of each: whether all inputs stayed within their bounds and the rig within its travel, how long the diagnostics took to
name it, how long the loop needed to come back after its end, and whether no node ended or showed a traceback. Asked: a
name within 1 s, back within 1 s of its end.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.faults.faults import FAULTS, QUIET
from benchmarks.faults.stage import PATIENCE, Said, Stage
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

RIG, NAME, DOMAIN = "cam_beam", "faults", 91
CALM = 2.0
"""Before each fault: what the diagnostics say then of a busy machine doesn't name it [s]."""
SOON = 1.0
"""Asked of names and of recovery [s]."""


def tried(stage: Stage, name: str) -> dict[str, Any]:
    """One fault, and what was seen."""
    time.sleep(CALM)
    stage.begun, lines = time.monotonic(), len(stage.lines)
    FAULTS[name](stage)
    before, over = stage.begun, time.monotonic()
    recovered = stage.wait_until_back(over)
    time.sleep(0.6)  # the diagnostics of the last moments
    usual = {phrase for said in stage.said if before - CALM <= said.time < before for phrase in phrases(said)}
    named = [said for said in stage.said if before <= said.time and phrases(said) - usual]
    traces = [line for line in stage.lines[lines:] if "Traceback" in line]
    return {
        "bounded": stage.bounded(before),
        "inside_travel": stage.inside(before),
        "named_after_s": named[0].time - before if named else math.inf,
        "named": f"{named[0].name}: {named[0].message}" if named else "",
        "recovered_after_s": max(recovered, 0.0),
        "lasted_s": over - before,
        "held": not traces and math.isfinite(recovered),
    }


def phrases(said: Said) -> set[str]:
    """What a status says, without its numbers."""
    return {said.name + "".join(letter for letter in part if letter.isalpha()) for part in said.message.split(",")}


def falls_short(name: str, found: dict[str, Any]) -> bool:
    """Whether something that is asked was not so."""
    named = name in QUIET or found["named_after_s"] <= SOON
    sound = found["bounded"] and found["inside_travel"] and found["held"]
    return not (sound and named and found["recovered_after_s"] <= SOON)


def main() -> int:
    """Try those that are named, or all; print the table and write the JSON."""
    chosen = sys.argv[1:] or list(FAULTS)
    for name in chosen:
        if name not in FAULTS:
            raise UserError(f"no fault {name!r}: known are {', '.join(FAULTS)}")
    machine, found = result.machine(), {}
    stage = Stage(load(RIG), domain=DOMAIN)
    stage.__enter__()
    try:
        for name in chosen:
            status.print(name)
            try:
                found[name] = tried(stage, name)
                stage.alive()
            except UserError as error:
                found[name] = {**found.get(name, {"bounded": False, "inside_travel": False}), "held": False}
                found[name] |= {"named": str(error), "named_after_s": math.inf, "recovered_after_s": math.inf}
            if not found[name]["held"]:  # the next one finds a loop that runs
                stage.__exit__()
                stage = Stage(load(RIG), domain=DOMAIN)
                stage.__enter__()
    finally:
        stage.__exit__()
    table = Table("fault", "bounded", "inside", "named [s]", "back [s]", "held", "in words", title="faults")
    for name, row in found.items():
        marks = ["yes" if row[key] else "NO" for key in ("bounded", "inside_travel", "held")]
        times = [f"{row[key]:.2f}" for key in ("named_after_s", "recovered_after_s")]
        shown = name if not falls_short(name, row) else f"{name}  <- short"
        table.add_row(shown, *marks[:2], *times, marks[2], row["named"])
    print_table(table)
    short = sum(falls_short(name, row) for name, row in found.items())
    print(f"{short} of {len(found)} fall short")
    if chosen == list(FAULTS):
        print(result.write(NAME, {**found, "short": short, "patience_s": PATIENCE}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)

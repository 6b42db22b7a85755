"""Faults of sensors and actuators in loops without a clock: python -m benchmarks.fault_rehearsal [RIG or FAULT...].

Estimator, guard and controller as the nodes use them, on the simulated rig, which follows a moving reference. It
repeats bit by bit, so that rules and thresholds can be tried; python -m benchmarks.faults asks real processes. Of each
fault, beside those of that benchmark some more: the first state that is not driving, and after how long; the strongest
evidence; whether travel and validity were kept until the loop was held or at rest; the largest tracking error during
the fault, and that of the second which begins a second after its end, both in tolerances. --start SECONDS: faults of
sensors alone, from the first sample on for so long. --known: what a loop does that knows each fault from its first
sample on. --best: of each fault of an actuator that falls short, the best that any inputs could do from its beginning
on, whose end is known, too.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from rich.table import Table

from benchmarks import result
from benchmarks.fault_rehearsal.rehearsal import Rehearsal
from benchmarks.fault_rehearsal.signal_faults import Fault, actuator_faults, sensor_faults
from benchmarks.faults.distrust import sizes_of
from benchmarks.faults.observation import MOVING
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

NAME = "fault_rehearsal"
SILENT = ("no number", "comes and goes", "comes and goes at 1 Hz", "show nothing")
"""Kinds that show nothing at the start, without which no loop begins."""


def main() -> int:
    """Try all, or those that are named."""
    asked, tables = sys.argv[1:], dict[str, dict[str, dict[str, Any]]]()
    seconds = 0.0
    if "--start" in asked:
        at = asked.index("--start")
        try:
            seconds = float(asked[at + 1])
        except (IndexError, ValueError):
            raise UserError("--start: for how long? Such as --start 8") from None
        del asked[at : at + 2]
    informed, optimal = "--known" in asked, "--best" in asked
    asked = [word for word in asked if word not in ("--known", "--best")]
    known: dict[str, dict[str, Fault]] = {}
    for name in MOVING:
        rig = load(name)
        known[name] = sensor_faults(rig, sizes_of(rig, dict(MOVING[name])))
        known[name] |= {} if seconds else actuator_faults(rig)
    names = {fault for faults in known.values() for fault in faults}
    for word in asked:
        if word not in names and word not in known:
            raise UserError(f"no rig or fault {word!r}: rigs are {', '.join(known)}, faults {', '.join(sorted(names))}")
    for name, faults in known.items():
        wanted = {fault: each for fault, each in faults.items() if not asked or name in asked or fault in asked}
        if not wanted or (set(asked) & known.keys() and name not in asked):
            continue
        rehearsal, tables[name] = Rehearsal(load(name), known=informed), {}
        for fault, each in wanted.items():
            status.print(f"{name}: {fault}")
            if not seconds:
                tables[name][fault] = row = rehearsal.tried(each)
                if optimal and row["short"] and each.acts is not None:
                    row["best"], row["holdable"] = rehearsal.best(each)
            elif not fault.endswith(SILENT):
                row = rehearsal.wrong_from_the_start(each, seconds)
                print(f"{name}: {fault}: after {row['after']:.2f} s, kept {row['kept']}, error {row['error']:.2f}")
        if not seconds:
            print_table(_table(name, tables[name]))
    if seconds:
        return 0
    every = [row for rows in tables.values() for row in rows.values()]
    short = sum(row["short"] for row in every)
    print(f"{short} of {len(every)} fall short")
    if not asked and not informed:
        print(result.write(NAME, {**tables, "short": short, "faults": len(every)}))
    return 0


def _table(rig: str, rows: Mapping[str, Mapping[str, Any]]) -> Table:
    table = Table(
        "fault",
        "state",
        "after [s]",
        "evidence",
        "kept",
        "during",
        "after",
        "best",
        "because",
        title=f"faults on {rig}, without a clock",
    )
    for name, row in rows.items():
        kept = "yes" if row["kept"] else "NO"
        times = [f"{row[key]:.2f}" for key in ("after", "most")]
        errors = [f"{row[key]:.2f}" for key in ("during", "error")]
        best = f"{row['best']:.2f}{'' if row['holdable'] else ', leaves its range'}" if "best" in row else ""
        table.add_row(
            f"{name}{'  <- short' if row['short'] else ''}", row["state"], *times, kept, *errors, best, row["reason"]
        )
    return table


if __name__ == "__main__":
    result.run(main)

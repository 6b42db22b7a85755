"""Faults on loops of real processes: python -m benchmarks.faults [--ordinary] [--native] [--resume] [RIG or NAME...].

The beam follows a sine under faults of all kinds; beam, joint, vehicle and drill string under faults of each sensor and
actuator. Of each fault: whether all inputs stayed numbers within their bounds, and the rig within its travel and
validity, or was held or at rest before it left them; how long the diagnostics took to name it in its own words, and
after what time it could be told from noise; how long the loop needed to answer again, and whether it tracks as usual a
second after the end (three after a start); and whether no node ended or showed a traceback.

--ordinary: without real-time priority. --native: estimator and controller are one process in C, and faults of sensors,
actuators and clock alone are tried, unless others are named. --resume: go on where a run was interrupted. --markdown:
only print the tables of the last whole run as the documentation has them.
Two runs at once disturb each other on a machine of few cores; where there are enough, ROS_DOMAIN_ID keeps them apart.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from benchmarks.faults.distrust import actuators, sensors, sizes_of
from benchmarks.faults.faults import CLOCKED, FAULTS
from benchmarks.faults.observation import MOVING, PATIENCE, WINDOW, Said
from benchmarks.faults.stage import NATIVE, ORDINARY, Fault, Stage
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_file

RIG, NAME = "cam_beam", "faults"
DOMAIN = int(os.environ.get("ROS_DOMAIN_ID") or 91)
OPTIONS = {"--ordinary", "--native", "--resume", "--markdown"}
GENERAL, SENSORS, ACTUATORS, TIMED = "general", "sensors", "actuators", "clock"
"""Kinds of faults, each on a stage of its own."""
LOST: dict[str, Any] = {
    **dict.fromkeys(("bounded", "kept", "tracks"), False),
    **dict.fromkeys(("named_after_s", "recovered_after_s", "error"), math.inf),
    "grown_mb": 0.0,
    "usual": [],
}
"""What is said of a fault after which the loop was not there any more."""
CALM = 2.0
"""Without a word in the diagnostics, before each fault; what they say then all the same doesn't name it [s]."""
SOON, AFTER_START = 1.0, 3.0
"""Asked of names, of recovery and of tracking, which has longer where nodes have started [s]."""


def faults_of(rig: Rig) -> dict[str, dict[str, tuple[Fault, str]]]:
    """By kind and name."""
    found = {
        SENSORS: sensors(rig, SignalLayout(rig, rig.system).outputs, sizes_of(rig, dict(MOVING[rig.name]))),
        ACTUATORS: actuators(rig),
    }
    return {GENERAL: FAULTS, **found, TIMED: CLOCKED} if rig.name == RIG else found


def tried(stage: Stage, fault: Fault, words: str) -> dict[str, Any]:
    """One fault, and what was seen."""
    stage.calm(CALM)
    stage.started = calm = time.monotonic()
    lines, memory = len(stage.lines), stage.memory()
    processes = {child.process.pid for child in stage.session.children.values()}
    for relay in stage.relays:
        relay.shown = math.nan
    fault(stage)
    before, over = stage.started, time.monotonic()
    recovered = stage.wait_until_back(over)
    allowed = AFTER_START if processes != {child.process.pid for child in stage.session.children.values()} else SOON
    time.sleep(max(over + allowed + WINDOW + 0.1 - time.monotonic(), 0.6))
    error = float(np.nanmax((stage.tracking(over + allowed) / stage.tolerance)[stage.tracked]))
    usual = {phrase for said in stage.said if calm - CALM <= said.time < calm for phrase in phrases(said)}
    later = [said for said in stage.said if before <= said.time]
    named = [(said, phrase) for said in later for phrase in phrases(said) - usual if re.search(words, phrase)]
    traces = [line for line in stage.lines[lines:] if "Traceback" in line]
    return {
        "bounded": stage.bounded(before),
        "kept": min(stage.restrained(before), over + SOON) <= stage.left(before),
        "tracks": error <= 1.0,
        "error": error,
        "named_after_s": named[0][0].time - before if named else math.inf,
        "named": named[0][1] if named else "",
        "shown_after_s": min((relay.shown - before for relay in stage.relays if relay.shown > 0.0), default=0.0),
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


def falls_short(words: str, found: dict[str, Any]) -> bool:
    """Whether something that is asked was not so."""
    named = not words or found["named_after_s"] <= SOON
    sound = all(found[key] for key in ("bounded", "kept", "held", "tracks"))
    return not (sound and named and found["recovered_after_s"] <= SOON)


class Progress:
    """What was found so far, in a file beside the results, so that an interrupted run can go on."""

    def __init__(self, name: str, *, resume: bool) -> None:
        """Raises UserError where there is nothing to go on with."""
        self.path = result.RESULTS / f"{name}.part.json"
        if resume and not self.path.is_file():
            raise UserError(f"--resume: there is no {self.path}, so no run was interrupted: leave the option away")
        self.found: dict[str, dict[str, dict[str, Any]]] = json.loads(self.path.read_text()) if resume else {}

    def of(self, rig: str) -> dict[str, dict[str, Any]]:
        """By fault of a rig."""
        return self.found.setdefault(rig, {})

    def keep(self) -> None:
        """Write the file."""
        with written_file(self.path) as partial:
            partial.write_text(json.dumps(self.found))


def play(rig: Rig, kind: str, faults: Mapping[str, tuple[Fault, str]], progress: Progress) -> None:
    """Play some faults, one after the other, on one loop while that holds; those that progress has are left out."""
    found = progress.of(rig.name)
    waiting = [name for name in faults if name not in found]
    while waiting:
        with Stage(rig, domain=DOMAIN, clocked=kind == TIMED, actuated=kind == ACTUATORS) as stage:
            while waiting:
                name = waiting.pop(0)
                status.print(f"{rig.name}: {name}")
                try:
                    found[name] = tried(stage, *faults[name])
                    for phrase in found[name]["usual"]:
                        status.print(f"{name}: said before, for {PATIENCE:g} s: {phrase}")
                    stage.alive()
                except UserError as error:
                    found[name] = {**LOST, **found.get(name, {}), "held": False, "named": str(error)}
                found[name]["short"] = falls_short(faults[name][1], found[name])
                progress.keep()
                if not (found[name]["held"] and found[name]["tracks"]):
                    break  # the next one finds a loop that runs and tracks


def main() -> int:
    """Try those that are named, or all; print the tables and write the JSON."""
    options = {word for word in sys.argv[1:] if word.startswith("-")}
    asked = [word for word in sys.argv[1:] if word not in options]
    if options - OPTIONS:
        raise UserError(f"no option {', '.join(sorted(options - OPTIONS))}: known are {', '.join(sorted(OPTIONS))}")
    ordinary = "--ordinary" in options
    if ordinary:
        os.environ[ORDINARY] = "1"
    native = "--native" in options
    if native:
        os.environ[NATIVE] = "1"
    name = NAME + "_native" * native + "_ordinary" * ordinary
    if "--markdown" in options:
        print(markdown(name))
        return 0
    machine, known = result.machine(), {name: faults_of(load(name)) for name in MOVING}
    names = {fault for kinds in known.values() for faults in kinds.values() for fault in faults}
    for word in asked:
        if word not in names and word not in known:
            raise UserError(f"no rig or fault {word!r}: rigs are {', '.join(known)}, faults {', '.join(sorted(names))}")
    progress = Progress(name, resume="--resume" in options)
    whole = False
    try:
        for rig, kinds in known.items():
            for kind, faults in kinds.items():
                meant = (not asked or rig in asked) and (not native or kind != GENERAL)
                wanted = {name: each for name, each in faults.items() if meant or name in asked}
                play(load(rig), kind, wanted, progress)
        whole = not asked
    except KeyboardInterrupt:
        print(f"interrupted: --resume goes on; {progress.path} has what was found", file=sys.stderr)
    found = {rig: rows for rig, rows in progress.found.items() if rows}
    for rig, rows in found.items():
        print_table(_table(rig, rows))
    every = [row for rows in found.values() for row in rows.values()]
    short = sum(row["short"] for row in every)
    print(f"{short} of {len(every)} fall short")
    if whole:
        results = {**found, "short": short, "faults": len(every), "patience_s": PATIENCE}
        print(result.write(name, results, on=machine))
        progress.path.unlink(missing_ok=True)
    return 0


def markdown(name: str) -> str:
    """Tables of a run's results, a row for each fault."""
    path = result.RESULTS / f"{name}.json"
    if not path.is_file():
        raise UserError(f"--markdown: there is no {path}: run all faults first")
    results = json.loads(path.read_text())["results"]
    if "faults" not in results:
        raise UserError(f"--markdown: {path} has no rigs, so it is of an older benchmark: run all faults again")
    rigs = {rig: rows for rig, rows in results.items() if isinstance(rows, dict)}
    lines = list[str]()
    for rig, rows in rigs.items():
        lines += [f"### {rig}", "", "| fault | kept | tracks | named [s] | back [s] |", "|---|---|---|---|---|"]
        for fault, row in rows.items():
            kept = "yes" if row["bounded"] and row["kept"] and row["held"] else "**no**"
            named = "-" if math.isinf(row["named_after_s"]) else f"{row['named_after_s']:.2f}"
            if row["named_after_s"] > SOON and row.get("shown_after_s", 0.0) > 0.1:
                named += f" (hidden for {row['shown_after_s']:.2f})"
            words = f"**{fault}**" if row["short"] else fault
            lines.append(f"| {words} | {kept} | {row['error']:.2f} | {named} | {row['recovered_after_s']:.2f} |")
        lines.append("")
    return "\n".join(lines)


def _table(rig: str, rows: Mapping[str, Mapping[str, Any]]) -> Table:
    heads = ("fault", "bounded", "kept", "tracks", "named [s]", "back [s]", "held", "in words")
    table = Table(*heads, title=f"faults on {rig}")
    for name, row in rows.items():
        bounded, kept, held = ("yes" if row[key] else "NO" for key in ("bounded", "kept", "held"))
        tracks = f"{row['error']:.2f}"
        times = [f"{row[key]:.2f}" for key in ("named_after_s", "recovered_after_s")]
        table.add_row(f"{name}  <- short" if row["short"] else name, bounded, kept, tracks, *times, held, row["named"])
    return table


if __name__ == "__main__":
    result.run(main)

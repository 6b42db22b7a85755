"""Half an hour of the loop: python -m benchmarks.soak [--minutes M] [--busy N] [--composed] [--rate R].

Plant, estimator, controller (supervised), reference and recorder as processes of their own, at 200 Hz and at real-time
priority where that is permitted, as ``hybrid-sysid run --bag`` starts them; alone, or beside N processes that do
nothing but count; or, composed, all but the recorder in one process. Asked: memory, file descriptors, threads, shared
memory and delays that do not grow, delays below 4 ms in 99 %, and no command missed beyond what a bare sleeper would
have missed.

A command is missed where it has not come to the plant by its next measurement (``missed_commands``). The sleeper is a
process of the loop's priority that sleeps to absolute deadlines at the loop's rate, at the same time on the same
machine. A tick that is late by L leaves the period less L for a turn of the loop, which takes D (the loop's own median
delay). So a sleeper would have missed a command wherever it woke later than the period less D, and what it counts is
what a loop misses on this machine that never takes longer than its median. That is in the sleeper's favour, who is
open to stalls of the machine at its deadlines alone, where whoever works is for D longer. What such a one misses is
set beside it: a worker computes for D, always the same, in each period, alone in the loop's place, right behind it and
for a quarter of its time. A stall of several periods is as many missed commands for all.

Delays over time are those of the plant's windows of half a second, out of /diagnostics in the bag; those of the whole
run are the plant's histogram.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from benchmarks import result
from benchmarks.picture import Panel, draw
from benchmarks.soak.trend import excess, too_late, trend
from benchmarks.soak.watch import Watch
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.progress import progress_bars

NAME, RIG, DOMAIN = "soak", "cam_beam", 94
MINUTES, RATE = 30.0, 200.0
DELAY_LIMIT = 4.0  # ms, asked of 99 %, and a period, where that is shorter
SAMPLING = 5.0  # s, between two looks at the processes
ALLOWED = {"memory_mb": 1.0, "files": 0.5, "threads": 0.5, "segments": 0.5, "delay": 0.1}
"""What a quantity may rise by without growing: MB, numbers, and the share of a delay."""
CHANCE = 0.01
"""Commands are missed beyond the sleeper where chance alone would do that more rarely."""
PICTURE = Path(__file__).parents[2] / "docs" / "results" / "soak.svg"
Windows = dict[str, NDArray[np.float64]]


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Beside so many processes that do nothing but count, until their standard input ends."""
    code = (
        "import os, threading\nthreading.Thread(target=lambda: os._exit(len(os.read(0, 1)))).start()\nwhile True: pass"
    )
    command = [sys.executable, "-c", code]
    others = [subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.communicate()


class Sleeper:
    """The bare sleeper's process, as a context; its latenesses are there behind it."""

    def __init__(self, rate: float, priority: int, longest: float, working: float = 0.0) -> None:
        """rate: [Hz]; longest: time that it may run [s]; working: that it works in each period [s]."""
        self.rate = rate
        arguments = (str(value) for value in (rate, priority, longest, working))
        self.command = [sys.executable, "-m", "benchmarks.soak.sleeper", *arguments]

    def __enter__(self) -> Sleeper:
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(self.command, stdin=pipe, stdout=pipe, start_new_session=True)
        return self

    def __exit__(self, *error: object) -> None:
        values = np.frombuffer(self.process.communicate()[0])
        self.late = values[1:]
        self.deadlines = values[0] + np.arange(len(self.late)) / self.rate

    def between(self, begin: float, end: float) -> NDArray[np.float64]:
        """Latenesses [s] of the deadlines between two moments of the monotonic clock [s]."""
        return self.late[(self.deadlines >= begin) & (self.deadlines <= end)]


def reported(bag: Path, node: str) -> Windows:
    """What a node reported of its loop every half second, by key (reports,); "time" [s] from the first report on."""
    reports: list[dict[str, float]] = []
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [item for item in reader.connections if item.topic == "/diagnostics"]
        for connection, stamp, data in reader.messages(connections=connections):
            message: Any = reader.deserialize(data, connection.msgtype)
            for said in message.status:
                values = {entry.key: _number(entry.value) for entry in said.values}
                if said.name.endswith(f"{node}: loop") and values:
                    reports.append({**values, "time": 1e-9 * stamp})
    found = {key: np.array([report.get(key, np.nan) for report in reports]) for key in (reports or [{}])[-1]}
    return {**found, "time": found["time"] - found["time"][0]} if found else {"time": np.empty(0)}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def measure(minutes: float, others: int, *, composed: bool, rate: float) -> tuple[dict[str, Any], bool]:
    """Run the loop; what was seen, and whether it was interrupted."""
    priority, seconds = processes.permitted_priority(), 60.0 * minutes
    watch = Watch(period=SAMPLING)
    with tempfile.TemporaryDirectory() as place:
        bag = Path(place) / "bag"
        with progress_bars(status) as update, busy(others):

            def progress(done: float, expected: float) -> None:
                watch.look()
                update("seconds", int(done), int(expected))

            with Sleeper(rate, priority, seconds + 300.0) as sleeper:
                outcome = Run(
                    rig=RIG,
                    rate=rate,
                    reference="steps",
                    duration=seconds,
                    bag=bag,
                    domain=DOMAIN,
                    priority=priority,
                    composed=composed,
                    tell=status.print,
                    progress=progress,
                ).go()
            working = 1e-3 * outcome.diagnostics.get("plant", {}).get("delay_ms_p50", 0.0)
            with Sleeper(rate, priority, seconds, working) as worker:
                sleep(seconds / 4.0)
        reports = reported(bag, "plant")
    if len(watch.times) < 2 or "delay_ms_p50" not in outcome.diagnostics.get("plant", {}):
        raise UserError("too short to see anything")
    late = sleeper.between(watch.times[0], watch.latest)
    return found(outcome.diagnostics, watch, reports, late, rate) | {
        "worker": {
            "works_ms": 1e3 * working,
            "periods": len(worker.late),
            "too_late": too_late(worker.late, 1.0 / rate),
            "late_ms": result.percentiles(1e3 * worker.late),
        },
        "priority": priority,
        "busy": others,
        "composed": composed,
    }, outcome.interrupted


def found(
    diagnostics: Mapping[str, Mapping[str, Any]],
    watch: Watch,
    reports: Windows,
    late: NDArray[np.float64],
    rate: float,
) -> dict[str, Any]:
    """What a run showed, as it is written; late: the sleeper's [s]."""
    plant = diagnostics["plant"]
    limit = 1.0 / rate - 1e-3 * plant["delay_ms_p50"]
    missed, theirs = plant["missed_commands"], too_late(late, limit)
    trends = {
        f"{name}, {quantity}": trend(
            watch.times, [sample[name][quantity] for sample in watch.samples], allowed=ALLOWED[quantity]
        )
        for name in watch.samples[0]
        for quantity in ALLOWED.keys() - {"delay"}
    }
    for key in ("p50", "p99"):
        values = reports[f"delay_ms_window_{key}"][1:]  # the first report is of the start
        trends[f"delay_ms, {key}"] = trend(
            reports["time"][1:], values, allowed=ALLOWED["delay"] * plant[f"delay_ms_{key}"]
        )
    chance = excess(missed, theirs)
    growing = [name for name, line in trends.items() if line["grows"]]
    short = [*growing, *(["missed commands"] if chance < CHANCE else [])]
    short += ["delay p99"] if plant["delay_ms_p99"] >= delay_limit(rate) else []
    return {
        "rate_hz": rate,
        "seconds": plant["measurements"] / rate,
        "measurements": plant["measurements"],
        "missed_commands": missed,
        "sleeper": {
            "limit_ms": 1e3 * limit,
            "wake_ups": len(late),
            "too_late": theirs,
            "late_ms": result.percentiles(1e3 * late),
        },
        "chance_of_as_many": chance,
        "overruns": plant["overruns"],
        "command_timeouts": plant["command_timeouts"],
        "delay_ms": {key: plant[f"delay_ms_{key}"] for key in ("p50", "p99", "max")},
        "timer_lateness_ms": {key: plant[f"timer_lateness_ms_{key}"] for key in ("p50", "p99", "max")},
        "recorder_lost": diagnostics["recorder"]["lost"],
        "page_faults": {
            name: watch.samples[-1][name]["page_faults"] - watch.samples[0][name]["page_faults"]
            for name in watch.samples[0]
        },
        "memory_mb": {name: values["memory_mb"] for name, values in watch.samples[-1].items()},
        "trends": trends,
        "minutes": by_minute(watch, reports),
        "short": short,
    }


def delay_limit(rate: float) -> float:
    """What is asked of 99 % of the delays [ms]."""
    return min(DELAY_LIMIT, 1e3 / rate)


def by_minute(watch: Watch, reports: Windows) -> dict[str, Any]:
    """Of each minute: delays of the windows (their mean; the longest), missed commands, and memory by node."""
    minute = (reports["time"] // 60.0).astype(int)
    counts = np.maximum.accumulate(np.nan_to_num(reports["missed_commands"]))
    ends = [counts[minute <= k][-1] for k in np.unique(minute)]
    looked = (np.array(watch.times) - watch.times[0]) // 60.0
    return {
        **{
            f"delay_ms_{key}": [float(pick(reports[f"delay_ms_window_{key}"][minute == k])) for k in np.unique(minute)]
            for key, pick in (("p50", np.nanmean), ("p99", np.nanmean), ("max", np.nanmax))
        },
        "missed_commands": np.diff([0.0, *ends]).tolist(),
        "memory_mb": {
            name: [
                float(np.mean([watch.samples[i][name]["memory_mb"] for i in np.flatnonzero(looked == k)]))
                for k in np.unique(looked)
            ]
            for name in watch.samples[0]
        },
    }


def table(seen: Mapping[str, Any]) -> Table:
    """A row for each thing that is asked, and for what explains it."""
    shown = Table("what", "measured", "asked", title=f"{seen['seconds'] / 60:.1f} minutes beside {seen['busy']} busy")
    sleeper, delay, short = seen["sleeper"], seen["delay_ms"], set(seen["short"])

    def row(what: str, measured: str, asked: str = "") -> None:
        shown.add_row(what, measured, f"{asked}  <- short" if what in short else asked)

    of = f"of {seen['measurements']}"
    row(
        "missed commands", f"{seen['missed_commands']} {of}", f"sleeper: {sleeper['too_late']} of {sleeper['wake_ups']}"
    )
    worker = seen["worker"]
    row(f"one process that computes for {worker['works_ms']:.2f} ms", f"{worker['too_late']} of {worker['periods']}")
    row("chance of as many at the sleeper's rate", f"{seen['chance_of_as_many']:.2g}", f"{CHANCE:g} at least")
    limit = delay_limit(seen["rate_hz"])
    row("delay p99", f"{delay['p50']:.2f} / {delay['p99']:.2f} / {delay['max']:.1f} ms", f"p99 below {limit:g} ms")
    row("sleeper late", " / ".join(f"{sleeper['late_ms'][key]:.2f}" for key in ("p50", "p99", "max")) + " ms")
    row("ticks left out", str(seen["overruns"]))
    for name, line in seen["trends"].items():
        if line["rose"] is None:
            continue  # too short
        slope = f"{line['slope_per_hour']:+.2g} +- {line['error_per_hour']:.1g} an hour"
        row(name, f"{slope}; last third {line['rose']:+.2g}", "does not grow")
    return shown


def picture(seen: Mapping[str, Any]) -> Path:
    """Delays and memory by minute."""
    minutes = seen["minutes"]
    delays = {f"delay {key}": np.array(minutes[f"delay_ms_{key}"]) for key in ("p50", "p99")}
    count = min(len(next(iter(delays.values()))), *(len(values) for values in minutes["memory_mb"].values()))
    panels = [
        Panel(label="ms", lines={name: values[:count] for name, values in delays.items()}, height=180),
        Panel(
            label="MB",
            lines={name: np.array(values[:count]) for name, values in minutes["memory_mb"].items()},
            height=180,
        ),
    ]
    return draw(
        PICTURE, 60.0 * np.arange(count, dtype=np.float64), panels, title="delay and memory of the loop, by minute"
    )


def main() -> int:
    """Run, print the table and write the results, those of the other kind kept."""
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks.{NAME}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=MINUTES)
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="processes that do nothing but count")
    parser.add_argument("--composed", action="store_true", help="all but the recorder in one process")
    parser.add_argument("--rate", type=float, default=RATE, help="measurements per second [Hz]")
    options = parser.parse_args()
    if not 0.2 <= options.minutes <= 50.0:
        raise UserError(f"--minutes {options.minutes:g}: it must be within 0.2 and 50")
    if not 50.0 <= options.rate <= 1000.0:
        raise UserError(f"--rate {options.rate:g}: it must be within 50 and 1000")
    machine = result.machine()
    seen, interrupted = measure(options.minutes, options.busy, composed=options.composed, rate=options.rate)
    print_table(table(seen))
    if interrupted:
        print("interrupted: not written")
        return 130
    path = result.RESULTS / f"{NAME}.json"
    before = json.loads(path.read_text(encoding="utf-8"))["results"] if path.exists() else {}
    kind = f"{'composed ' if options.composed else ''}{'busy' if options.busy else 'plain'}"
    kind += f" {options.rate:g} Hz" if options.rate != RATE else ""
    print(f"written to {result.write(NAME, {**before, kind: {**seen, 'machine': machine}}, on=machine)}")
    if kind == "plain" and len(seen["minutes"]["missed_commands"]) > 2:
        print(picture(seen))
    return 0


if __name__ == "__main__":
    result.run(main)

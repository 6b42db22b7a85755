"""Timing of the whole loop: plant, estimator, controller and reference, each a process or all in one.

The delay runs from the moment a measurement is published to the moment its command has come back to the plant's code;
a command is missed when it has not come by the next measurement.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, sleep
from typing import Any

from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.runtime import processes
from hybrid_sysid_ros.runtime.run import Run

NAME = "loop_timing"
RATE = 200.0  # Hz, what the rig runs at
OTHERS = (100.0, 500.0, 1000.0)  # Hz, for information
COMPOSED = (200.0, 500.0)  # Hz, all in one process
NODES = ("plant", "estimator", "controller")


def measure(rate: float, seconds: float, *, recorded: bool = False, **options: Any) -> dict[str, Any]:
    """Run the loop and return what its nodes counted; recorded: by a recorder beside it; options: of a Run."""
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "bag" if recorded else None
        outcome = Run(rate=rate, duration=seconds, reference="steps", tell=lambda line: None, bag=bag, **options).go()
    if outcome.interrupted:
        raise KeyboardInterrupt
    plant = outcome.diagnostics["plant"]
    return {
        "rate_hz": rate,
        "composed": options.get("composed", False),
        "recorded": recorded,
        "seconds": seconds,
        "measurements": plant["measurements"],
        "missed_commands": plant["missed_commands"],
        "overruns": plant["overruns"],
        "delay_ms": {key: plant[f"delay_ms_{key}"] for key in ("p50", "p99", "max")},
        "execution_ms": {
            node: {key: outcome.diagnostics[node][f"execution_ms_{key}"] for key in ("p50", "p99", "max")}
            for node in NODES[1:]
        },
        "memory_mb": {node: values["memory_mb"] for node, values in outcome.diagnostics.items()},
    }


def floor(rate: float, seconds: float, priority: int) -> dict[str, float]:
    """Lateness [ms] of a process that only sleeps from tick to tick: what this machine does to any loop."""
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    late = []
    tick = perf_counter()
    for _ in range(round(rate * seconds)):
        tick += 1.0 / rate
        sleep(max(tick - perf_counter(), 0.0))
        late.append(1e3 * (perf_counter() - tick))
    if priority:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return result.percentiles(late)


def table(runs: list[dict[str, Any]]) -> Table:
    """A row for each rate."""
    columns = (
        "rate",
        "processes",
        "time",
        "missed",
        "plant late",
        "delay p50",
        "p99",
        "max",
        *(f"{node} memory" for node in NODES),
    )
    shown = Table(*columns, title="plant, estimator, controller and reference")
    for run in runs:
        delay = run["delay_ms"]
        shown.add_row(
            f"{run['rate_hz']:g} Hz",
            ("one" if run["composed"] else "four") + (" and a recorder" if run["recorded"] else ""),
            f"{run['seconds']:g} s",
            f"{run['missed_commands']} of {run['measurements']}",
            str(run["overruns"]),
            *(f"{delay[key]:.2f} ms" for key in ("p50", "p99", "max")),
            *(f"{run['memory_mb'][node]:.0f} MB" for node in NODES),
        )
    return shown


def main() -> int:
    """Measure, print the table and write the results."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{NAME}", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help=f"at {RATE:g} Hz; a quarter at the other rates")
    parser.add_argument("--model", default="", help="model folder; the shipped one by default")
    parser.add_argument("--priority", type=int, help="real-time priority, 0 for none; by default where permitted")
    parser.add_argument("--policy-path", default="", help="policy folder; the shipped one by default")
    options = parser.parse_args()
    on = result.machine()
    runs = []
    priority = processes.permitted_priority() if options.priority is None else options.priority
    given = {"model": options.model, "policy_path": options.policy_path, "priority": priority}
    for rate in (RATE, *OTHERS):
        seconds = options.seconds if rate == RATE else options.seconds / 4
        runs.append(measure(rate, seconds, **given))
    runs.insert(1, measure(RATE, options.seconds / 2, recorded=True, **given))
    for rate in COMPOSED:
        runs.append(measure(rate, options.seconds / 2, composed=True, **given))
    idle = floor(RATE, options.seconds, priority)
    sleeping = {rate: floor(rate, options.seconds / 4, priority) for rate in COMPOSED}
    print_table(table(runs))
    print(f"a process that only sleeps wakes late by {idle['p50']:.2f} / {idle['p99']:.2f} / {idle['max']:.2f} ms")
    results = {"priority": priority, "runs": runs, "sleeper_lateness_ms": idle, "sleepers_ms": sleeping}
    print(f"written to {result.write(NAME, results, on=on)}")
    return 0


if __name__ == "__main__":
    result.run(main)

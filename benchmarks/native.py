"""The native loop beside a bare ping-pong of rcl with as many hops, in turns, at 200 Hz and 1 kHz.

The simulated beam asks from a process of its own; the same one asks a relay that answers with the same bytes. What the
loop takes beyond the relay is its own work. All have a real-time priority where that is permitted, which
other work on the machine disturbs little. SECONDS of each rate can be given: python -m benchmarks.native 1800.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.extensions.export.unit.folder import unit_name
from hybrid_sysid_ros.extensions.native.build import MANIFEST, TEMPLATES, check_tools, native_loop
from hybrid_sysid_ros.extensions.native.rig_parameters import NODES
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.configuration import settings
from hybrid_sysid_ros.support.arrays import Array

NAME = "native"
RATES = (200.0, 1000.0)
SECONDS = 60.0
TURNS = 4
"""Turns of loop and relay, so that both see the same minutes."""
ASKED = {"beyond": 1e-4, "memory": 30.0, "ready": 0.3, "build": 10.0}
"""p50 and p99 beyond the relay's [s], resident memory [MB], time from start to ready and of the build [s]."""
PRIORITY = 20
"""Of the processes, where it is permitted."""
DRIVEN = 0.99
"""Share of the commands that the exact MPC must have found: a loop that rests is quick."""


def built_probe(folder: Path, rig: Rig) -> Path:
    """The executable of ping_pong.c, with the simulated rig of one sensor and one actuator in it."""
    (by, libraries), name, sensor = check_tools(), unit_name(rig.name), rig.sensors[0]
    plant = Simulation(name=f"{name}_plant", rig=rig, bias=(0.0,))
    for file, text in plant.texts(about="the plant").items():
        (folder / file).write_text(text, encoding="utf-8")
    sources = [
        str(path) for path in (*folder.glob("*.c"), Path(__file__).with_name("ping_pong.c"), TEMPLATES / "cdr.c")
    ]
    flags = ["-std=gnu11", "-O2", f"-I{folder}", f"-I{TEMPLATES}", *libraries.include]
    flags += [f'-DPLANT_HEADER="{name}_plant.h"', f"-DPLANT(what)={name}_plant_##what", f"-DSTEP={rig.step}"]
    flags += [f'-DJOINT="{next(iter(rig.joints.joints))}"', f"-DWHITE={sensor.white_noise * sensor.scale}"]
    subprocess.run([by, *flags, *sources, "-o", str(folder / "probe"), *libraries.link, "-lm"], check=True)
    return folder / "probe"


def prioritise() -> bool:
    """Give this process, and what it starts, a real-time priority; whether that is permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    return True


def processor_time(process: int) -> float:
    """That all threads of a process have had [s]: other work on the machine changes it little."""
    lines = [path.read_text(encoding="ascii") for path in Path(f"/proc/{process}/task").glob("*/schedstat")]
    return sum(1e-9 * int(line.split()[0]) for line in lines)


def asked(probe: Path, other: list[str], rate: float, seconds: float) -> tuple[Array, int, dict[str, Any]]:
    """Delays [s] of the answers of another process, how many were missed, and what that process reports."""
    environment = {**os.environ, "ROS_DOMAIN_ID": "97", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    began = perf_counter()
    process = subprocess.Popen(other, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "ready"
    ready, before = perf_counter() - began, processor_time(process.pid)
    words = [str(probe), "probe", f"{rate}", f"{seconds}"]
    lines = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.splitlines()
    taken = processor_time(process.pid) - before
    process.send_signal(signal.SIGINT)
    said = [json.loads(line) for line in process.communicate()[0].splitlines() if line.startswith("{")]
    delays = np.array([float(line) for line in lines if line[0].isdigit()])
    count = int(lines[-1].split()[1])
    return delays, count - len(delays), {"ready": ready, "said": said, "processor": taken / count}


def main() -> int:
    """Run, print the table, write the results."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    machine, rig, found = result.machine(), load("cam_beam"), dict[str, Any]()
    shown = Table(
        "rate [Hz]", "who", "p50 [us]", "p99 [us]", "longest [ms]", "processor [us]", "missed",
        title="Answers of the native loop",
    )  # fmt: skip
    with TemporaryDirectory() as scratch:
        probe = built_probe(Path(scratch), rig)
        for rate in RATES:
            given: dict[str, dict[str, Any]] = {
                "estimator": {"rate": rate},
                "controller": {"policy": "exact", "real_time": True},
            }
            every = {node: settings(rig, node, given[node])[0] or {} for node in NODES}
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            binary = native_loop(rig, every)
            first = prioritise()
            loop = [str(binary), "--ros-args", "-r", "__ns:=/cam_beam"]
            delays: dict[str, list[Array]] = {"relay": [], "loop": []}
            missed, processor = dict.fromkeys(delays, 0), dict.fromkeys(delays, 0.0)
            for _ in range(TURNS):
                for who, other in (("relay", [str(probe), "relay"]), ("loop", loop)):
                    times, lost, more = asked(probe, other, rate, seconds / TURNS)
                    delays[who].append(times)
                    missed[who] += lost
                    processor[who] += more["processor"] / TURNS
            row: dict[str, Any] = {"ready": more["ready"], "memory": more["said"][0]["memory_mb"]}
            said = {key: value for part in more["said"] for key, value in part.items()}
            row["driven"] = said.get("layer_exact", 0) / max(said["commands"], 1)
            row["build"] = json.loads((binary.parent / MANIFEST).read_text(encoding="utf-8"))["seconds"]
            for who, parts in delays.items():
                times = np.concatenate(parts)
                p50, p99 = np.percentile(times, (50, 99)).tolist()
                row[who] = {"p50": p50, "p99": p99, "longest": float(times.max()), "missed": missed[who]}
                row[who]["processor"] = processor[who]
                shown.add_row(
                    f"{rate:g}",
                    who,
                    f"{1e6 * p50:.0f}",
                    f"{1e6 * p99:.0f}",
                    f"{1e3 * times.max():.2f}",
                    f"{1e6 * processor[who]:.0f}",
                    str(missed[who]),
                )
            found[f"{rate:g}"] = row
    print_table(shown)
    short = []
    for rate_name, row in found.items():
        for part in ("p50", "p99"):
            if not row["loop"][part] - row["relay"][part] <= ASKED["beyond"]:
                short.append(f"{part} at {rate_name} Hz")
        short += [f"driven at {rate_name} Hz"] if not row["driven"] >= DRIVEN else []
        short += [f"{key} at {rate_name} Hz" for key in ("memory", "ready", "build") if not row[key] <= ASKED[key]]
        print(
            f"{rate_name} Hz: ready in {row['ready']:.2f} s, {row['memory']:.1f} MB, built in {row['build']:.1f} s, "
            f"{row['loop']['missed'] - row['relay']['missed']} more missed than by the relay, "
            f"{row['driven']:.1%} of its commands by the exact MPC"
        )
    print(f"short: {', '.join(short) or 'none'}")
    print(
        result.write(
            NAME,
            {"rates": found, "asked": ASKED, "priority": first, "seconds": seconds, "short": len(short)},
            on=machine,
        )
    )
    return 0


if __name__ == "__main__":
    result.run(main)

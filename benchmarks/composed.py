"""The beam's loop and its simulated plant in one process in C at 1 kHz, without a middleware between them.

    python -m benchmarks.composed [SECONDS]

A command's delay is counted from the moment at which its period began, waking up included; the next linearisation is
prepared behind the command. At real-time priority and with cores kept awake (/dev/cpu_dma_latency) where that is
permitted.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.c_source import Text
from hybrid_sysid_ros.extensions.export.simulation.simulation import Simulation
from hybrid_sysid_ros.extensions.export.unit import unit
from hybrid_sysid_ros.extensions.export.unit.built import FLAGS, renamed
from hybrid_sysid_ros.extensions.export.unit.daqp_source import copy_to, daqp
from hybrid_sysid_ros.extensions.export.unit.folder import unit_name
from hybrid_sysid_ros.extensions.export.unit.python_loop import loop_in_python
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError

NAME, RIG = "composed", "cam_beam"
RATE, SECONDS = 1000.0, 60.0
DRIVERS = ("exact", "supervised")
SINE = {"amplitude": 0.05, "frequency": 0.5}
"""Of the reference of the beam's angle [rad, Hz]."""
ASKED = 100e-6
"""p99 of a command's delay [s]."""


def program(policy: str, place: Path) -> Path:
    """Print and build plant and loop; return the executable. Raises UserError without a C compiler."""
    by = compiler.found()
    if by is None:
        raise UserError("composed: there is no C compiler: install one (apt install gcc)")
    rig, model, name = load(RIG), load_model(shipped(RIG, "model")), unit_name(RIG)
    python = loop_in_python(rig, model, {"real_time": True, "policy": policy}, estimation={"rate": RATE})
    loop = unit.loop_of(rig, python)
    printer, soft = unit.translated(loop, python.estimator._arrays, name, single=False), python.mpc.shooting.memory[-1]
    texts = unit.texts(printer, loop, title="A loop", about={}, seal="", soft=soft)
    plant = Simulation(name=f"{name}_plant", rig=rig, bias=(0.0,) * len(rig.actuators))
    period, sensor, hum = python.estimator.period, rig.sensors[0], rig.sensors[0].hum
    assert hum is not None
    values: dict[str, Any] = {
        "name": name, "NAME": name.upper(), "period": repr(period), "period_ns": round(1e9 * period),
        "interval": repr(python.mpc.period), "steps": round(period / rig.step),
        "white": sensor.white_noise * sensor.scale, "hum": hum.rms * sensor.scale, "hertz": hum.hertz, **SINE,
    }  # fmt: skip
    own = Text(Path(__file__).with_suffix(".c").read_text(encoding="utf-8")).substitute(values)
    for file, text in (texts | plant.texts(about="the plant") | {"composed.c": own}).items():
        (place / file).write_text(text, encoding="utf-8")
    copy_to(daqp(None), place / "daqp")
    common = [by, *FLAGS, "-w", "-I", str(place)]
    objects = []
    for path in sorted((place / "daqp").glob("*.c")):
        objects.append(str(place / f"daqp_{path.stem}.o"))
        subprocess.run([*common, *renamed(name), "-c", str(path), "-o", objects[-1]], check=True)
    sources = [str(path) for path in sorted(place.glob("*.c")) if not path.name.endswith("_test.c")]
    subprocess.run([*common, "-std=gnu11", *sources, *objects, "-o", str(place / "composed"), "-lm"], check=True)
    return place / "composed"


def main(arguments: list[str]) -> int:
    """Run, print the table, write the results."""
    seconds, machine, found = float(arguments[0]) if arguments else SECONDS, result.machine(), dict[str, Any]()
    shown = Table("controller", "p50 [us]", "p99 [us]", "longest [us]", "error [rad]", title="Plant and loop at 1 kHz")
    for policy in DRIVERS:
        with TemporaryDirectory() as scratch:
            made = program(policy, Path(scratch))
            ran = subprocess.run([str(made), str(round(seconds * RATE))], capture_output=True, text=True, check=True)
        error, *late = map(float, ran.stdout.split())
        p50, p99, longest = (1e-9 * np.percentile(late, (50, 99, 100))).tolist()
        found[policy] = {"p50": p50, "p99": p99, "longest": longest, "error": error, "said": ran.stderr.strip()}
        shown.add_row(policy, *(f"{1e6 * value:.0f}" for value in (p50, p99, longest)), f"{error:.4f}")
    print_table(shown)
    short = [policy for policy, row in found.items() if not row["p99"] <= ASKED]
    print(f"short: {', '.join(short) or 'none'}")
    print(result.write(NAME, {"loops": found, "seconds": seconds, "asked": ASKED, "short": len(short)}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(lambda: main(sys.argv[1:]))

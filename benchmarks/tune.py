"""Tuned gains of three rigs beside what ships, on unseen loops. An interrupted run goes on from its file.

A rig falls short where its gain is certain but below ASKED; where no trial is certainly better, what ships is at the
bound of what these parameters can do.
"""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.tuning import tuning
from hybrid_sysid_ros.extensions.tuning.front import opened_trials
from hybrid_sysid_ros.extensions.tuning.loops import Loops
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped

NAME = "tune"
RIGS, AIM, ASKED = ("cam_beam", "wheel_motor", "flexible_joint"), "settling", 0.1
TRIALS, LOOPS, HORIZONS = 120, 24, 5.0
STUDY = Path(__file__).parents[1] / "out" / "benchmark_tune.db"


def main() -> int:
    """Run, print a table, write the results."""
    machine, found = result.machine(), {}
    for name in RIGS:
        rig = load_rig(name)
        loops = Loops(rig=rig, model=load_model(shipped(name, "model")), seed=0, count=LOOPS, horizons=HORIZONS)
        problem = {"model": loops.model.seal, "loops": LOOPS, "horizons": HORIZONS}
        with opened_trials(str(STUDY), name, problem, loops.space, 0) as trials:
            tuned = tuning.tune(loops, trials, AIM, TRIALS, workers=0, progress=lambda done, all_of_them: None)
        found[name] = tuning.content(loops, tuned)
    shown = Table("rig", "gain", "+-", "settling", "shipped", "effort", "shipped", title="on unseen loops")
    for name, item in found.items():
        after, before = item["tuned_unseen"], item["shipped_unseen"]
        measures = (part[key] for key in ("settling", "effort") for part in (after, before))
        shown.add_row(name, f"{item['gain']:.1%}", f"{item['error']:.1%}", *(f"{value:.4f}" for value in measures))
    print_table(shown)
    short = [name for name, item in found.items() if item["better"] and item["gain"] < ASKED]
    print(f"short: {', '.join(short) or 'none'}")
    print(result.write(NAME, {"rigs": found, "asked": ASKED, "short": len(short)}, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)

"""hybrid-sysid demo, the whole way once round: bags, a model, the loop as ROS 2 processes, a report."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros import bags, report
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import console, print_table
from hybrid_sysid_ros.control import Controller, ExactMpc
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, simulate_loop
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.identification import Part, evaluate, identify
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.excitation import Reference
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration, session
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.training import train_policy
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import beside, check_file, check_folder, written_file
from hybrid_sysid_ros.support.progress import progress_bars

Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
Train = Annotated[bool, typer.Option("--train", help="Train model and policy afresh.")]
OUT = Path("out/demo")
RIG = "cam_beam"
SHIPPED_BAGS = Path(__file__).resolve().parents[2] / "bags"


@dataclass(frozen=True, kw_only=True, eq=False)
class Records:
    """What a demo learns from and is scored on."""

    training: Sequence[Record]
    part: Part
    """Of each training record."""
    tests: Sequence[tuple[Record, Part]]
    names: Mapping[str, str] = field(default_factory=dict)
    """What the summary calls a record, where that is another name than its own."""
    source: str = "simulated"
    """simulated or real."""


def command(out: Out = OUT, train: Train = False) -> None:
    """From bags to a controlled beam: identify, run the loop, report."""
    demo(out, train=train)


def demo(out: Path, records: Records | None = None, *, train: bool = False) -> dict[str, Any]:
    """Identify the beam from bags, run it under the approximate MPC as ROS 2 processes, and report.

    Leaves report.html, summary.json, the model and the bag of the loop in ``out``. records: those that
    ship by default, the first halves of which are learnt from. train: the loop uses the
    model identified here and a policy trained for it, instead of the shipped ones.

    Raises UserError for missing records or extras, and where a node fails.
    """
    rig = load_rig(RIG)
    report.check_available()
    make_folder(out)
    for file in ("report.html", "summary.json"):
        check_file(out / file)
    folders = {"model": "model.yaml", "loop": bags.METADATA, **({"policy": "policy.yaml"} if train else {})}
    for folder, marker in folders.items():
        check_folder(out / folder, marker=marker)
    records = records or shipped_records()
    console.print(f"1 identifying the beam from {len(records.training)} bags")
    model = identify(records.training, rig, "hybrid", sampling=Sampling(), part=records.part)
    model.save(out / "model")
    model = load_model(out / "model")
    scores = {
        records.names.get(record.name, record.name): evaluate(model, record, part=part)
        for record, part in records.tests
    }
    model_folder, policy_folder = configuration.shipped(RIG, "model"), configuration.shipped(RIG, "policy")
    if train:
        model_folder, policy_folder = out / "model", out / "policy"
        _train(model, policy_folder)
    used = load_model(model_folder)
    imitation = policy.load(policy_folder, model=used)
    console.print("2 running plant, estimator, controller and reference as ROS 2 processes")
    bag, plant = _run(out / "loop", model_folder, policy_folder)
    loop = LoopRecord.from_bag(bag, rig)
    console.print("3 comparing with the exact MPC on the same plant")
    approximate = simulated_loop(rig, used, imitation)
    exact = simulated_loop(rig, used, ExactMpc(used.system, imitation.problem))
    summary = {
        "identification": {
            "records": records.source,
            "free_run_r2": {name: round(value.r2, 4) for name, value in scores.items()},
            "fit_seconds": model.fit["seconds"],
        },
        "closed_loop": {
            "tracking_rmse_volts": {
                name: round(loop.tracking_rmse(*window), 4) for name, window in rig.schedule().windows.items()
            },
            "cost_ratio_to_exact": round(approximate.cost(imitation.problem) / exact.cost(imitation.problem), 4),
        },
        "timing": {  # as the plant saw it; the report shows what the recorder saw, its own delays included
            "delay_ms": {key: round(plant[f"delay_ms_{key}"], 4) for key in ("p50", "p99", "max")},
            "missed_commands": plant["missed_commands"],
        },
    }
    _write(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    command = "make demo TRAIN=1" if train else "make demo"
    sections = report.identification_section(model, records.tests), report.closed_loop_section(loop, rig)
    report.write(out / "report.html", *sections, report.provenance(model, command))
    print_table(_table(summary))
    console.print(f"report: {out / 'report.html'}   numbers: {out / 'summary.json'}   bag: {bag}")
    return summary


def make_folder(path: Path) -> None:
    """Make a folder, or raise UserError before any work is done for it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: can't be made a folder ({error.strerror}); choose another --out") from error


def shipped_records() -> Records:
    """The bags that ship: the first halves of all but the swept sine are learnt from, the rest is kept for scores."""
    paths = sorted(path for path in SHIPPED_BAGS.glob("beam_*") if path.is_dir())
    if not paths:
        raise UserError(f"{SHIPPED_BAGS}: no bags there; run the demo from a checkout")
    signals = load_rig(RIG).signals
    read = [bags.read(path, signals) for path in paths]
    halved = [record for record in read if "swept" not in record.name]
    whole = [record for record in read if "swept" in record.name]
    tests = [*((record, Part(start=0.5)) for record in halved), *((record, Part()) for record in whole)]
    return Records(training=halved, part=Part(stop=0.5), tests=tests)


def simulated_loop(
    rig: Rig,
    model: Model,
    controller: Controller,
    *,
    seed: int = 0,
    reference: Reference | None = None,
    duration: float = 0.0,
) -> ClosedLoop:
    """A loop under a controller at its own period, in one process, without delays of computation.

    reference: times (samples,) [s] in, the outputs as they are shown (samples, p) out; by default the rig's first.
    """
    schedule = rig.schedule()
    followed, duration = reference or schedule, duration or schedule.duration
    values = configuration.defaults(rig.name, "estimator")
    estimator = ExtendedKalmanFilter(
        model.system, configuration.estimator_tuning(values, rig, model.system), period=controller.period, latency=0.0
    )
    plant = Plant(rig, seed=seed, bias=configuration.defaults(rig.name, "plant")["bias"])
    controller.reset()
    scales = np.array([display.scale for display in rig.display])
    return simulate_loop(
        plant,
        estimator,
        controller,
        lambda t: scales * followed(t),
        inputs=len(rig.system.inputs),
        duration=duration,
        period=controller.period,
        lead=model.system.delay,
    )


def _train(model: Model, folder: Path) -> None:
    with progress_bars(console) as update:
        train_policy(model, samples=beside(folder, ".samples"), progress=update).save(folder)


def _run(bag: Path, model: Path, policy_folder: Path) -> tuple[Path, Mapping[str, Any]]:
    """The bag of the loop, and the last diagnostics of its plant."""
    with progress_bars(console) as update:
        outcome = session.run(
            rig=RIG,
            model=model,
            policy_path=policy_folder,
            bag=bag,
            overwrite=True,
            domain=None if "ROS_DOMAIN_ID" in os.environ else 1 + os.getpid() % 100,  # beside no rig that may be on
            tell=console.print,
            progress=lambda seconds, duration: update("reference, seconds", int(seconds), int(duration)),
        )
    if outcome.interrupted or outcome.bag is None:
        raise KeyboardInterrupt
    return outcome.bag, outcome.diagnostics["plant"]


def _write(path: Path, text: str) -> None:
    with written_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _table(summary: dict[str, Any]) -> Table:
    table = Table("quantity", "value", title="demo")
    for record, r2 in summary["identification"]["free_run_r2"].items():
        table.add_row(f"free run R2 {record}", f"{r2:.3f}")
    table.add_row("fit", f"{summary['identification']['fit_seconds']:.1f} s")
    for segment, rmse in summary["closed_loop"]["tracking_rmse_volts"].items():
        table.add_row(f"tracking RMSE {segment}", f"{rmse:.3f} V")
    table.add_row("cost, approximate to exact MPC", f"{summary['closed_loop']['cost_ratio_to_exact']:.3f}")
    delay = summary["timing"]["delay_ms"]
    table.add_row("loop delay p50 / p99 / max", f"{delay['p50']:.2f} / {delay['p99']:.2f} / {delay['max']:.2f} ms")
    table.add_row("missed commands", str(summary["timing"]["missed_commands"]))
    return table

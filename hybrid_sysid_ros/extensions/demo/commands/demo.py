"""hybrid-sysid demo: bags, a model, the loop as ROS 2 processes, and a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import options, terminal
from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.shared.demo_loop import OUT, ideal_errors, run_loop, tracked
from hybrid_sysid_ros.extensions.shared.demo_recipe import DemoRecipe, RecordSplit
from hybrid_sysid_ros.identification import Part, Scores, evaluate, identify
from hybrid_sysid_ros.identification.identify import experiment_of, scores_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.report import RunSummary, closed_loop_section
from hybrid_sysid_ros.rigs.rig import Rig, default
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration, processes
from hybrid_sysid_ros.runtime.configuration import controller_model, wrap_for_rig
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.simulated_loop import simulated_loop
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError, counted
from hybrid_sysid_ros.support.files import beside, check_file, check_folder, make_folder, write_text
from hybrid_sysid_ros.support.progress import progress_bars

Out = Annotated[
    Path | None,
    typer.Option("--out", help="Folder for the results; by default out/demo, out/demo_RIG or out/demo_camera."),
]
Train = Annotated[bool, typer.Option("--train", help="Train a new model and policy instead of using the shipped ones.")]
EXTENDED_BY = "demos"


def command(
    rig: options.RigName = "",
    out: Out = None,
    train: Train = False,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
    demos: Sequence[Callable[[], dict[str, Any]]] = (),
) -> None:
    """From bags to a controlled rig: identify, run the loop, report."""
    if demos:
        if len(demos) > 1 or train:
            raise UserError("these are several demos: leave all but one of --train and the others out")
        summary = demos[0]()
    else:
        chosen = load_rig(rig or default())
        place = out or (OUT if chosen.name == default() else OUT.with_name(f"demo_{chosen.name}"))
        summary = demo(place, rig=chosen.source, train=train, seed=seed, overwrite=overwrite, quiet=as_json)
    if as_json:
        terminal.console.print(json.dumps(summary, indent=2))


def demo(
    out: Path,
    records: RecordSplit | None = None,
    *,
    rig: str = "",
    train: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    quiet: bool = False,
) -> dict[str, Any]:
    """Identify a rig from bags, run it under the approximate MPC as ROS 2 processes, and report.

    It writes report.html, summary.json, the model and the bag of the loop to ``out``. records: by default those that
    the rig's file names. rig: name or path, by default the default rig. train: the loop uses the model identified here
    and a policy trained for it, instead of the shipped ones. seed: of the fit, the training and the sensors' noise.
    overwrite: whether the results of another demo are replaced. quiet: whether none are printed.

    Raises UserError for missing records or extras, for results that may not be replaced, and where a node fails.
    """
    described = load_rig(rig or default())
    plan = DemoRecipe.of(described)
    report.check_available()
    processes.check_ros()
    make_folder(out)
    for file in ("report.html", "summary.json"):
        check_file(out / file, replace=overwrite)
    folders = {"model": "model.yaml", "loop": bags.METADATA, **({"policy": "policy.yaml"} if train else {})}
    for folder, marker in folders.items():
        check_folder(out / folder, marker=marker, replace=overwrite)
    records = records or plan.records(described, out / "bags")
    terminal.status.print(f"1 identifying {described.name} from {counted(len(records.training), 'bag')}")
    given: dict[str, Any] = {"sampling": plan.sampling, "part": records.part, "options": plan.options, "seed": seed}
    model = identify(records.training, described, plan.structure, **given)
    model.save(out / "model")
    model = load_model(out / "model")
    model_folder, policy_folder = configuration.shipped(described.name, "model"), out / "policy"
    if train:
        model_folder = out / "model"
        _train(model, policy_folder, seed)
    else:
        policy_folder = configuration.shipped(described.name, "policy")
    used = load_model(model_folder)
    imitation = policy.load(policy_folder, model=used)
    terminal.status.print("2 running plant, estimator, controller and reference as ROS 2 processes")
    bag, diagnostics = run_loop(
        out / "loop", described, plan.reference, model=model_folder, policy_path=policy_folder, seed=seed
    )
    loop = LoopRecord.from_bag(bag, described)
    terminal.status.print("3 comparing with the exact MPC on the same plant")
    ratio = _cost_ratio(described, used, imitation, plan.reference, seed)
    section = closed_loop_section(loop, described)
    section = replace(section, ideal=ideal_errors(section, used, imitation.problem))
    run = RunSummary.of(
        diagnostics, described, bag=bag, section=section, folders={"model": model_folder, "policy": policy_folder}
    )
    summary = {
        "identification": _identified(model, records, described),
        "closed_loop": tracked(section, plan) | {"cost_ratio_to_exact": round(ratio, 4)},
        "run": run.content,
    }
    write_text(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    driver = "A policy of this model drove it." if train else "The shipped policy drove it, on the shipped model."
    called = terminal.typed()
    sections = report.identification_section(model, records.tests), section
    report.write_report(out / "report.html", *sections, report.provenance(model, called), run, driver)
    if not quiet:
        terminal.print_table(_table(summary))
        terminal.print_lines(
            run.lines | {"report": str(out / "report.html"), "numbers": str(out / "summary.json")}, run.alarms
        )
    return summary


def _cost_ratio(rig: Rig, model: Model, imitation: policy.Policy, reference: str, seed: int) -> float:
    """Cost of a simulated loop under a policy over that under the exact MPC."""
    schedule, system = rig.schedule(reference), controller_model(rig, model.system)
    approximate, exact = (
        simulated_loop(
            rig, model, wrap_for_rig(rig, system, controller), schedule, duration=schedule.duration, seed=seed
        ).cost_by(imitation.problem, system)
        for controller in (imitation, ExactMpc(system, imitation.problem))
    )
    return approximate / exact


def _identified(model: Model, records: RecordSplit, rig: Rig) -> dict[str, Any]:
    """The summary of the model, which runs under the stabiliser where its rig has one; R2 is the mean over outputs."""
    held = rig.experiments.stabiliser is not None

    def score(record: Record, part: Part) -> Scores:
        if held:
            return scores_of(model.system, experiment_of(model, record, part=part), rig)
        return evaluate(model, record, part=part)

    scores = {records.names.get(record.name, record.name): score(record, part) for record, part in records.tests}
    return {
        "records": records.source,
        "stabilised_run_r2" if held else "free_run_r2": {name: round(value.r2, 4) for name, value in scores.items()},
        "fit_seconds": model.fit["seconds"],
    }


def _train(model: Model, folder: Path, seed: int) -> None:
    with progress_bars(terminal.status) as update:
        extensions.one("policies", "train")(model, seed=seed, samples=beside(folder, ".samples"), progress=update).save(
            folder
        )


def _table(summary: dict[str, Any]) -> Table:
    table = Table("quantity", "value", title="demo")
    identified = summary["identification"]
    for run in ("free_run", "stabilised_run"):
        for record, r2 in identified.get(f"{run}_r2", {}).items():
            table.add_row(f"{run.replace('_', ' ')} R2 {record}", f"{r2:.3f}")
    table.add_row("time of the fit", f"{identified['fit_seconds']:.2g} s")
    table.add_row(
        "cost of a simulated loop, the network alone to the exact MPC",
        f"{summary['closed_loop']['cost_ratio_to_exact']:.3f}",
    )
    return table

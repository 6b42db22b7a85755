"""The command line."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros import report as reports
from hybrid_sysid_ros.commands.model import app as model_commands
from hybrid_sysid_ros.commands.policy import policy_commands
from hybrid_sysid_ros.commands.policy_certify import policy_certify_command
from hybrid_sysid_ros.commands.policy_export import policy_export_command
from hybrid_sysid_ros.commands.program import new_app, run_app
from hybrid_sysid_ros.commands.search import search_command
from hybrid_sysid_ros.commands.terminal import (
    InputHandling,
    PartText,
    Period,
    ReadPeriod,
    Recover,
    RigName,
    Seed,
    SignalsFile,
    Step,
    console,
    read_records,
    sampling_of,
    status,
)
from hybrid_sysid_ros.identification import Part, evaluate, identify
from hybrid_sysid_ros.identification.validation.identifiability import doubts
from hybrid_sysid_ros.identification.validation.resimulation import resimulations
from hybrid_sysid_ros.models import STRUCTURES, Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.options import parse
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import Interrupted
from hybrid_sysid_ros.support.files import check_file, check_folder
from hybrid_sysid_ros.support.progress import progress_bars

STRUCTURES_HELP = " | ".join((*STRUCTURES, "a further gray box of the rig", "hybrid_NAME on a gray box"))

app = new_app()
app.add_typer(policy_commands, name="policy")


@app.command("simulate")
def simulate_command(
    kind: Annotated[str, typer.Argument(help="multisine, random_steps or swept_sine.")],
    out: Annotated[Path, typer.Argument(help="Bag to write.")],
    rig: RigName = "cam_beam",
    seed: Seed = 0,
    duration: Annotated[float, typer.Option(help="Seconds.", min=1.0, max=3600.0)] = 40.0,
    rate: Annotated[float, typer.Option(help="Samples per second.", min=1.0)] = 200.0,
) -> None:
    """Simulate an experiment on a rig, driven as the real one is, and write its bag."""
    from hybrid_sysid_ros.rigs.experiments import simulate

    console.print(str(simulate(load_rig(rig), kind, out, seed=seed, duration=duration, rate=rate)))


@app.command("identify")
def identify_command(
    bag: Annotated[list[Path], typer.Argument(help="Bags to learn from.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the model.")],
    rig: RigName = "cam_beam",
    structure: Annotated[str, typer.Option(help=STRUCTURES_HELP)] = "hybrid",
    option: Annotated[
        list[str] | None, typer.Option("--option", help="NAME=VALUE of the structure, such as units=8 or creep=1.")
    ] = None,
    input_handling: InputHandling = "averaged",
    step: Step = 0.005,
    period: Period = 0.05,
    part: PartText = "0:1",
    seed: Seed = 0,
    signals: SignalsFile = None,
    recover: Recover = False,
    read_period: ReadPeriod = 0.0,
) -> None:
    """Identify a model from bags."""
    check_folder(out, marker="model.yaml")
    sampling = sampling_of(step, period, input_handling)
    described = load_rig(rig)
    records = read_records(bag, rig, signals, recover, read_period, sampling)
    with status.status("compiling") as spinner:

        def progress(stage: str, evaluations: int, error: float) -> None:
            status.print(f"  {stage}: error {100 * error:.1f} % of the output's deviation, {evaluations} simulations")
            spinner.update("fitting")

        model = identify(
            records,
            described,
            structure,
            sampling=sampling,
            part=Part.parse(part),
            options=parse(option or []),
            seed=seed,
            progress=progress,
        )
    model.save(out)
    console.print(parameter_table(model))
    for doubt in doubts(model):
        console.print(f"doubt: {doubt}")
    console.print(score_table({name: dict(scores) for name, scores in model.scores.items()}, described, "training"))
    console.print(f"{out}: {structure} from {len(records)} records in {model.fit['seconds']:.1f} s")


@app.command("evaluate")
def evaluate_command(
    model: Annotated[Path, typer.Argument(help="Model folder.")],
    bag: Annotated[list[Path], typer.Argument(help="Bags to score it on.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    part: PartText = "0:1",
    report: Annotated[Path | None, typer.Option(help="Write an HTML report with plots.")] = None,
    rig: Annotated[
        str, typer.Option("--rig", help="Folder of the model's rig, where it is no rig known by name.")
    ] = "",
    signals: SignalsFile = None,
    recover: Recover = False,
    read_period: ReadPeriod = 0.0,
) -> None:
    """Score a model by strict free run: one initial state, never corrected. Where a bag has the reference, the whole
    closed loop is simulated again from it as well.
    """
    if report is not None:
        reports.check_available()
        check_file(report)
    loaded = load_model(model, rig=rig)
    described = load_rig(loaded.rig)
    chosen = Part.parse(part)
    records = read_records(bag, loaded.rig, signals, recover, read_period, loaded.sampling)
    scores = {record.name: evaluate(loaded, record, part=chosen).content for record in records}
    again, skipped = resimulations(
        loaded.system, [(record, chosen) for record in records], described, sampling=loaded.sampling
    )
    loops = {name: item.output.content for name, item in again.items()}
    for reason in skipped.values():
        status.print(f"no closed loop: {reason}")
    if report is not None:
        section = reports.identification_section(loaded, [(record, chosen) for record in records])
        reports.write(report, section, None, reports.provenance(loaded, " ".join(sys.argv)))
        status.print(str(report))
    if as_json:
        content = {name: {**values, "closed_loop": loops.get(name)} for name, values in scores.items()}
        console.print_json(json.dumps({"model": str(model), "part": part, "records": content}))
    else:
        console.print(score_table(scores, described, "free run", loops))


app.add_typer(model_commands, name="model")
policy_commands.command("certify")(policy_certify_command)
policy_commands.command("export")(policy_export_command)
app.command("search")(search_command)


@app.command("run")
def run_command(
    rig: RigName = "cam_beam",
    policy: Annotated[str, typer.Option(help="supervised, network or exact.")] = "supervised",
    model: Annotated[Path | None, typer.Option(help="Model folder; the shipped one by default.")] = None,
    policy_path: Annotated[Path | None, typer.Option(help="Policy folder; the shipped one by default.")] = None,
    rate: Annotated[float, typer.Option(help="Measurements per second.")] = 200.0,
    duration: Annotated[float, typer.Option(help="Seconds; 0 as long as the reference.")] = 0.0,
    reference: Annotated[str, typer.Option(help="hardware, constant, steps, sine or multisine.")] = "hardware",
    bag: Annotated[Path | None, typer.Option(help="Record into this bag.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a bag that is there.")] = False,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="As fast as the nodes answer, repeatable.")] = False,
) -> None:
    """Run plant, estimator, controller and reference as ROS 2 processes."""
    from hybrid_sysid_ros.runtime.session import run

    with progress_bars(status) as update:

        def progress(seconds: float, expected: float) -> None:
            if expected:
                update(f"{reference} reference, seconds", int(seconds), int(expected))

        outcome = run(
            rig=rig,
            policy=policy,
            model=model or "",
            policy_path=policy_path or "",
            rate=rate,
            duration=duration,
            reference=reference,
            bag=bag,
            overwrite=overwrite,
            lockstep=lockstep,
            tell=status.print,
            progress=progress,
        )
    table = Table("node", "quantity", "value", title="last diagnostics", title_justify="left")
    for node, values in outcome.diagnostics.items():
        for key, value in values.items():
            table.add_row(node, key, f"{value:.4g}" if isinstance(value, float) else str(value))
    if outcome.diagnostics:
        console.print(table)
    if outcome.interrupted:
        kept = outcome.bag is not None and outcome.bag.exists()
        raise Interrupted(f"{outcome.bag} holds what was recorded" if kept else "")
    if outcome.bag is not None:
        console.print(str(outcome.bag))


@app.command("demo")
def demo_command(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("out/demo"),
    train: Annotated[bool, typer.Option("--train", help="Train model and policy afresh.")] = False,
) -> None:
    """From bags to a controlled beam: identify, run the loop, report."""
    from hybrid_sysid_ros.commands.demo import demo

    demo(out, train=train)


def parameter_table(model: Model) -> Table:
    """Parameters with standard errors and units."""
    table = Table("parameter", "value", "standard error", "unit", title=f"{model.structure} {model.rig}")
    table.title_justify = "left"
    errors = model.standard_errors
    for item, value in zip(model.system.parameters, model.system.values, strict=True):
        error = errors.get(item.name)
        table.add_row(item.name, f"{value:.4g}", "set" if error is None else f"{error:.2g}", item.unit)
    return table


def score_table(
    scores: dict[str, dict[str, Any]], rig: Rig, title: str, loops: dict[str, dict[str, Any]] | None = None
) -> Table:
    """Scores of records, a row for each output, errors in the unit in which it is shown; beside them those of their
    re-simulated loops.
    """
    names = [item.name for item in rig.system.outputs]
    several = len(names) > 1
    unit = "" if several else f" [{rig.display[0].unit}]"
    table = Table("record", *(["output"] if several else []), "R2", f"RMSE{unit}", "fit [%]", title=title)
    table.title_justify = "left"
    for heading in ("closed loop R2", f"RMSE{unit}") if loops else ():
        table.add_column(heading)
    for record, values in scores.items():
        for index, name in enumerate(names):
            own, shown = values.get("outputs", {}).get(name, values), rig.display[index]
            rmse = f"{own['rmse'] / shown.scale:.3f}{f' {shown.unit}' if several else ''}"
            cells = [record, *([name] if several else []), f"{own['r2']:.4f}", rmse, f"{own['fit_percent']:.1f}"]
            if loops:
                loop = loops.get(record)
                cells += [f"{loop['r2']:.4f}", f"{loop['rmse'] / shown.scale:.3f}"] if loop else ["", ""]
            table.add_row(*cells)
    return table


def main() -> None:
    """Run a command of the command line."""
    run_app(app, "hybrid-sysid")

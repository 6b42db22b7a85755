"""hybrid-sysid identify: a model from bags."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import fit_options, options
from hybrid_sysid_ros.commands.inspections import Inspect, inspected, print_inspections
from hybrid_sysid_ros.commands.records import check_records, read_records
from hybrid_sysid_ros.commands.score_table import score_table
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.parameter_groups import ParameterGroup
from hybrid_sysid_ros.identification.shooting import fastest_growth
from hybrid_sysid_ros.identification.validation.identifiability import doubts, unexplained
from hybrid_sysid_ros.identification.validation.run_quality import run_quality
from hybrid_sysid_ros.library.models import identify
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.model import FAILED, error_text, finite
from hybrid_sysid_ros.models.structure import parse
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import counted
from hybrid_sysid_ros.support.files import check_folder

EXTENDED_BY = "comparisons"
AWAY = 10.0  # error of a simulation, in the output's deviation, that says no more than that it runs away


def command(
    bag: Annotated[list[Path], typer.Argument(help="Bags to train on.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the model.")],
    rig: options.RigName = "",
    structure: fit_options.StructureName = "hybrid",
    option: fit_options.StructureOptions = None,
    input_handling: fit_options.InputHandlingOption = "auto",
    step: fit_options.StepOption = None,
    period: fit_options.Period = None,
    part: options.PartText = "0:1",
    seed: options.Seed = 0,
    criterion: Annotated[
        str,
        typer.Option(
            metavar="simulation|prediction",
            help="What the physics is fitted by: errors of free runs, or of a filter whose input offset walks.",
        ),
    ] = "simulation",
    initial: fit_options.Initial = None,
    initial_samples: fit_options.InitialSamples = None,
    warm_up: fit_options.WarmUp = None,
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    report: Annotated[Path | None, typer.Option(help="Write an HTML report with plots.")] = None,
    overwrite: options.Overwrite = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Fit also to records from which nothing can be learned.")
    ] = False,
    as_json: options.Json = False,
    comparisons: Sequence[Inspect] = (),
) -> None:
    """Identify a model from bags."""
    check_folder(out, marker="model.yaml", replace=overwrite)
    page = None if report is None else extensions.one("pages", "model", "--report needs the extension report")(report)
    described = load_rig(rig)
    start = {"initial": initial, "initial_samples": initial_samples, "warm_up": warm_up}
    records = read_records(bag, rig, signals, recover, read_period, input_handling)
    sampling = fit_options.sampling_of(described, step, period, input_handling, start, records)
    check_records(records, described, anyway=anyway)
    fitted = Part.parse(part)
    model = _identified(
        records,
        described,
        structure,
        sampling=sampling,
        part=fitted,
        options=parse(option or []),
        seed=seed,
        refine=step is None,
        criterion=criterion,
    )
    model.save(out)
    parts = [(record, fitted) for record in records]
    if as_json:
        console.print(json.dumps(_content(model), indent=2))
    else:
        _show(model, described, parts)
    further = inspected(comparisons, model, parts, described)
    print_inspections([] if as_json else further)
    tell = status if as_json else console
    if page is not None:
        page.write(load_model(out, rig=rig), parts, further)
        tell.print(f"report: {report}")
    tell.print(f"{out}: {structure} from {counted(len(records), 'record')} in {model.fit['seconds']:.1f} s")


def _identified(records: Sequence[Record], rig: Rig, structure: str, **settings: Any) -> Model:
    """The model of records, while the terminal shows how the fit goes; settings: further ones of :func:`identify`."""
    with status.status("compiling") as spinner:

        def progress(stage: str, evaluations: int, error: float) -> None:
            words = f"error {100 * error:.1f} % of the output's deviation" if error < AWAY else "simulations run away"
            status.print(f"  {stage}: {words}, {evaluations} simulations")
            spinner.update("fitting")

        return identify(records, rig, structure, progress=progress, **settings)


def _show(model: Model, rig: Rig, records: Sequence[tuple[Record, Part]]) -> None:
    """Print what was found, and what to doubt of it."""
    console.print(f"{model.structure}: {model.kind.summary}")
    print_table(parameter_table(model))
    console.print(f"inputs: {model.inputs_sentence}")
    for name, item in model.fit.get("prediction", {}).items():
        if isinstance(item, Mapping):
            console.print(f"{name}: {item['value']:.3g} (standard error {item['standard_error']:.2g})")
    for line in model.kind.lines(model.system):
        console.print(line)
    for doubt in doubts(model):
        console.print(f"doubt: {doubt}")
    for group in model.fit.get("groups", ()):
        console.print(f"known together: {ParameterGroup(**group)}")
    for name, output, r2 in unexplained(model):
        reason = _reason(model, name, records)
        console.print(f"doubt: over {name}, which it was fitted to, R2 of its run is {r2:.2f} for {output}{reason}")
    title = "training" if rig.experiments.stabiliser is None else "training, closed by the stabiliser"
    if rig.experiments.stabiliser is None and "chi_squared" in model.fit:
        growth = fastest_growth(model.system)
        grows = f"the law is unstable (an error grows by e in {1.0 / growth:.3g} s)" if growth else "free runs part"
        title = "training, by predictions while an error grows by e" if growth else "training, by predictions"
        console.print(
            f"{grows}, so it was fitted over short windows, and is scored by predictions; in closed loop, if rig.yaml "
            "names the loop's gains (experiments.stabiliser)"
        )
    print_table(score_table(model.scores, rig, title))


def _reason(model: Model, name: str, records: Sequence[tuple[Record, Part]]) -> str:
    """Why a model does not explain a training record, as the end of a sentence; "" where it is not known."""
    for record, part in records:
        if record.name == name and model.system.outputs:
            quality = run_quality(model.system, experiment_of(model, record, part=part))
            sentence = FAILED if model.failed and quality.kind not in ("sign", "unit") else quality.sentence
            return f": {sentence.removeprefix(f'{name}: ')}" if sentence else ""
    return ""


def _content(model: Model) -> dict[str, Any]:
    """What was found, as JSON has it."""
    errors, system = model.standard_errors, model.system
    return {
        "structure": model.structure,
        "rig": model.rig,
        "parameters": {
            item.name: {"value": value, "standard_error": finite(errors.get(item.name)), "unit": item.unit}
            for item, value in zip(system.parameters, system.values.tolist(), strict=True)
            if not item.learned
        },
        "scores": {name: dict(scores) for name, scores in model.scores.items()},
        "doubts": [str(doubt) for doubt in doubts(model)],
        "seconds": model.fit["seconds"],
    }


def parameter_table(model: Model) -> Table:
    """Table of parameters with standard errors and units."""
    errors, spread = model.standard_errors, model.fit.get("block_spread", {})
    columns = ["parameter", "value", "standard error", *(["of blocks apart"] if spread else []), "unit"]
    table = Table(*columns, title=f"{model.structure} {model.rig}")
    for item, value in zip(model.system.parameters, model.system.values, strict=True):
        error = errors.get(item.name)
        if item.learned:
            continue
        apart = [error_text(spread[item.name]) if item.name in spread else ""] if spread else []
        table.add_row(item.name, f"{value:.4g}", error_text(error), *apart, item.unit)
    return table

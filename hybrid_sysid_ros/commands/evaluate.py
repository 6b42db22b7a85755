"""hybrid-sysid evaluate: how well a model predicts bags."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros import report as reports
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands import terminal
from hybrid_sysid_ros.commands.inspections import Inspect, print_inspections
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.shooting import unstable_settings
from hybrid_sysid_ros.identification.validation import unstable
from hybrid_sysid_ros.identification.validation.bands import bands_of
from hybrid_sysid_ros.identification.validation.feedback_resimulation import follow_again
from hybrid_sysid_ros.identification.validation.judgement import judgement
from hybrid_sysid_ros.identification.validation.resimulation import resimulations
from hybrid_sysid_ros.identification.validation.run_quality import RunQuality, run_quality
from hybrid_sysid_ros.identification.validation.scores import free_run, scores_of_run
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import provided
from hybrid_sysid_ros.support.files import check_file

EXTENDED_BY = "inspections"


def command(
    model: terminal.ModelFolder,
    bag: Annotated[list[Path], typer.Argument(help="Bags to score the model on.")],
    as_json: terminal.Json = False,
    part: terminal.PartText = "0:1",
    report: Annotated[Path | None, typer.Option(help="Write an HTML report with plots.")] = None,
    initial: terminal.Initial = None,
    initial_samples: terminal.InitialSamples = None,
    warm_up: terminal.WarmUp = None,
    signals: terminal.SignalsFile = None,
    recover: terminal.Recover = False,
    read_period: terminal.ReadPeriod = 0.0,
    rig: terminal.OwnRig = "",
    inspections: Sequence[Inspect] = (),
) -> None:
    """Score a model by strict free run: one initial state, never corrected; it is found as in the model's fit, unless
    options say otherwise. Where a bag has the reference, the whole closed loop is re-simulated from it as well.
    """
    if report is not None:
        reports.check_available()
        check_file(report, suffix=".html")
    loaded = load_model(model, rig=rig).started(initial=initial, initial_samples=initial_samples, warm_up=warm_up)
    described = load_rig(loaded.rig)
    chosen = Part.parse(part)
    records = read_records(bag, loaded.rig, signals, recover, read_period, loaded.sampling, model=loaded)
    parts = [(record, chosen) for record in records]
    further = [inspect(loaded, parts, described) for inspect in inspections]
    found = _found(loaded, records, chosen, described)
    for reason in found.skipped.values():
        status.print(f"no closed loop: {reason}")
    if report is not None:
        section = reports.identification_section(loaded, parts)
        reports.write_report(report, section, None, reports.provenance(loaded, typed()), inspections=further)
        status.print(str(report))
    if as_json:
        content = {record.name: found.content(record.name) for record in records}
        for item in further:
            for name, own in item.content.items():
                content[name][item.name] = own
        console.print_json(json.dumps({"model": str(model), "part": part, "records": content}))
    else:
        _show(found, described)
        print_inspections(further)


@dataclass(frozen=True, kw_only=True)
class _Evaluation:
    """What an evaluation found, by the records' names."""

    scores: Mapping[str, Mapping[str, Any]]
    """Of the free run, where it has a meaning."""
    ahead: Mapping[str, Sequence[unstable.PredictionErrors]]
    """Errors of predictions, where it has none or says little."""
    qualities: Mapping[str, RunQuality]
    """What is wrong with the free run, where something is."""
    bands: Mapping[str, Mapping[str, Any]]
    """What the bands of the free run hold, by level."""
    judgements: Mapping[str, Mapping[str, str]]
    """Of the free run by output: good, fair or useless, and why."""
    loops: Mapping[str, Mapping[str, Any]]
    """Scores of the closed loop that is done again."""
    skipped: Mapping[str, str]
    """Why it was not."""
    uses: Mapping[str, Mapping[str, Mapping[str, Any]]]
    """What extensions say of the use before the measurement is seen, each with its sentence."""

    def content(self, name: str) -> dict[str, Any]:
        """Of one record, as plain data."""
        return {
            **self.scores.get(name, {}),
            **self.uses.get(name, {}),
            **({"ahead": [_row(item) for item in self.ahead[name]]} if name in self.ahead else {}),
            **({"bands": self.bands[name]} if name in self.bands else {}),
            **({"doubt": vars(self.qualities[name])} if name in self.qualities else {}),
            **({"judgement": self.judgements[name]} if name in self.judgements else {}),
            "closed_loop": self.loops.get(name),
        }


def _found(model: Model, records: Sequence[Record], part: Part, rig: Rig) -> _Evaluation:
    experiments = {record.name: experiment_of(model, record, part=part) for record in records}
    ahead, runs = dict[str, Sequence[unstable.PredictionErrors]](), dict[str, Array]()
    for name, experiment in experiments.items():
        try:
            unstable.check_free_run(model.system, experiment)
            runs[name] = free_run(model.system, experiment)
        except unstable.UnstableError as error:
            ahead[name] = _ahead(model, experiment, rig, error)
    scores = {name: scores_of_run(model.system, experiments[name], run).content for name, run in runs.items()}
    qualities = {name: run_quality(model.system, experiments[name]) for name in runs}
    for name, quality in qualities.items():
        if not quality.judged:
            ahead[name] = unstable.predictions(model.system, experiments[name], None)
    bands = _bands(model, {name: experiments[name] for name in runs})
    loops, skipped = _loops(model, records, part, rig)
    return _Evaluation(
        scores=scores,
        ahead=ahead,
        qualities={name: quality for name, quality in qualities.items() if quality.kind},
        bands=bands,
        judgements={
            name: judgement(found, rig, bands.get(name, {})) for name, found in scores.items() if qualities[name].judged
        },
        loops=loops,
        skipped=skipped,
        uses={name: _uses(model, experiments[name], run) for name, run in runs.items()},
    )


def _uses(model: Model, experiment: PreparedRecord, run: Array) -> dict[str, Mapping[str, Any]]:
    """What extensions say of a use of the model, by name."""
    made = {name: check(model, experiment, run) for name, check in provided("use_checks").items()}
    return {name: found for name, found in made.items() if found}


def _show(found: _Evaluation, rig: Rig) -> None:
    """Print what was found, what counts most first."""
    for use in (item for uses in found.uses.values() for item in uses.values()):
        console.print(use["sentence"])
    for quality in found.qualities.values():
        console.print(f"doubt: {quality.sentence}")
    if followed := {name: found.loops[name] for name in found.ahead if name in found.loops}:
        print_table(terminal.score_table(followed, rig, "closed loop, from the commands alone"))
    if found.ahead:
        print_table(_ahead_table(found.ahead, rig))
    if found.scores:
        print_table(terminal.score_table(found.scores, rig, "free run", found.loops))
        for name, judged in found.judgements.items():
            for output, words in judged.items():
                console.print(f"{name}{f', {output}' if len(judged) > 1 else ''}: {words}")
    if found.bands:
        print_table(_band_table(found.bands, rig))


def _ahead(
    model: Model, experiment: PreparedRecord, rig: Rig, why: unstable.UnstableError
) -> list[unstable.PredictionErrors]:
    """Errors of predictions where the free run is meaningless."""
    windows = unstable_settings(rig)
    if windows is None:
        advice = f"for that declare the rig's stabiliser, experiments.stabiliser in {rig.file}"
        raise UserError(f"{why}: {advice}") from why
    status.print(f"no free run: {why}")
    return unstable.predictions(model.system, experiment, windows)


def _bands(model: Model, experiments: Mapping[str, PreparedRecord]) -> dict[str, dict[str, Any]]:
    """By record and level, what the bands of its free run hold."""
    found = {}
    for name, experiment in experiments.items():
        if bands := bands_of(model, experiment):
            found[name] = {f"{band.level:g}": band.content(model.system, experiment) for band in bands}
    return found


def _band_table(bands: Mapping[str, Mapping[str, Any]], rig: Rig) -> Table:
    """Table of what bands hold, and of their widths in the outputs' display units."""
    levels = list(next(iter(bands.values())))
    columns = [text for level in levels for text in (f"{float(level):.0%} band holds", "half width")]
    table = Table(
        "record", "output", *columns, title="bands of the free run, by parameters, inputs and training errors"
    )
    for record, found in bands.items():
        for item, display in zip(rig.system.outputs, rig.display, strict=True):
            cells = []
            for level in levels:
                own = found[level][item.name]
                cells += [f"{own['held']:.0%}", f"{float(display.shown(own['half'])):.3g} {display.unit}"]
            table.add_row(record, item.name, *cells)
    return table


def _loops(
    model: Model, records: Sequence[Record], part: Part, rig: Rig
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """By record the scores of the re-simulated closed loop, and the reasons for other records."""
    given: dict[str, Any] = {"sampling": model.sampling}
    if rig.experiments.feedback is None:
        again, skipped = resimulations(model.system, [(record, part) for record in records], rig, **given)
        return {name: item.output.content for name, item in again.items()}, skipped
    found, skipped = {}, {}
    for record in records:
        try:
            found[record.name] = follow_again(model.system, record, rig, **given, part=part).scores.content
        except UserError as error:
            skipped[record.name] = str(error)
    return found, skipped


def _row(item: unstable.PredictionErrors) -> dict[str, Any]:
    return {"seconds": item.seconds, "closed": item.closed, "beginnings": item.count, **item.scores.content}


def _ahead_table(ahead: Mapping[str, Sequence[unstable.PredictionErrors]], rig: Rig) -> Table:
    """Table of prediction errors by horizon, for each output in its display unit."""
    headings = (f"{item.name} [{display.unit}]" for item, display in zip(rig.system.outputs, rig.display, strict=True))
    table = Table("record", "ahead", "", *headings, title="RMSE of predictions, from states estimated just before")
    for record, rows in ahead.items():
        for row in rows:
            held = "closed by the stabiliser" if row.closed else "open"
            each = (row.scores.outputs or {rig.system.outputs[0].name: row.scores}).values()
            errors = (f"{float(display.shown(one.rmse)):.4g}" for one, display in zip(each, rig.display, strict=True))
            table.add_row(record, f"{row.seconds:.3g} s", held, *errors)
    return table

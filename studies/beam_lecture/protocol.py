"""The command that reproduces the lecture's tables of free runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands.fit_options import InputHandlingOption
from hybrid_sysid_ros.commands.terminal import console, print_table, status, typed
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.models import Sampling, structure_names
from hybrid_sysid_ros.models.structure import complete, options_of, parse
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import beside, check_file, check_folder, write_text
from hybrid_sysid_ros.support.progress import progress_bars
from studies.beam_lecture import lecture
from studies.beam_lecture.candidate import Candidate, CandidateStore
from studies.beam_lecture.comparison import RULE, Comparison, compare
from studies.beam_lecture.lecture import Protocol, table_name
from studies.beam_lecture.page import r2_text, write_protocol
from studies.beam_lecture.report import StructureResult, protocol_section

INTERRUPTED = 130
"""The exit code."""


def command(
    number: Annotated[
        int,
        typer.Argument(help="1: train on multisines; 2: on first halves; 3: and the slow ramp (docs/results)."),
    ],
    folder: Annotated[Path, typer.Argument(help="Folder with the author's .mat files, or with bags of them.")],
    input_handling: InputHandlingOption = "averaged",
    structure: Annotated[
        list[str] | None, typer.Option("--structure", help="Structure to fit; the option may be repeated.")
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option("--option", help="Option of all these structures, as NAME=VALUE, such as starts=4."),
    ] = None,
    seeds: Annotated[int, typer.Option(help="Seeds of each learned structure.", min=1, max=20)] = 3,
    as_json: Annotated[Path | None, typer.Option("--json", help="Write the results as JSON.")] = None,
    page: Annotated[Path | None, typer.Option("--report", help="Write an HTML page with the plots.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the model that is chosen.")] = None,
    jobs: Annotated[int, typer.Option(help="Number of processes; 0: one on each processor.", min=0)] = 0,
    step: Annotated[float, typer.Option(help="Integration step [s].")] = 0.005,
    period: Annotated[float, typer.Option(help="Time between fitted samples [s].")] = 0.05,
) -> None:
    """Reproduce the lecture's table of free runs with every structure, and choose one by its training data.

    Ctrl-C prints and writes what is finished; the same command then goes on from there.
    """
    if number not in lecture.NUMBERS:
        raise UserError(f"protocol {number}: there are protocols 1 and 2, the lecture's, and 3, with the slow ramp")
    files = ResultFiles(as_json, page, out)
    files.check()
    rig = load_rig(lecture.RIG)
    # The rig's further gray boxes are of the third protocol: the tables of the first two stay what they were.
    known = [*structure_names(), *rig.structures]
    structures = list(dict.fromkeys(structure or (known if number == 3 else list(structure_names()))))
    options = parse(option or [])
    for name in structures:
        complete(options, options_of(name, rig.system, rig.structures), name)
    protocol = lecture.arrange(lecture.read_folder(folder, slow=number == 3), number)
    store = None if files.place is None else CandidateStore(beside(files.place, ".fits"))
    sampling = Sampling(step=step, period=period, input=input_handling)
    comparison = _compared(
        protocol, rig, structures, store, sampling=sampling, options=options, seeds=range(seeds), jobs=jobs
    )
    if not any(candidate.models for candidate in comparison.candidates):
        raise UserError(f"no structure could be fitted; the last one: {comparison.candidates[-1].error}")
    print_table(table(protocol, comparison, input_handling))
    if comparison.chosen:
        console.print(f"chosen by training data only: {comparison.chosen} ({RULE})")
    files.write(protocol, comparison, input_handling)
    if comparison.missing:
        raise typer.Exit(INTERRUPTED)
    if store is not None and not any(candidate.error for candidate in comparison.candidates):
        store.remove()


@dataclass(frozen=True)
class ResultFiles:
    """Where results go; what is None is not written."""

    as_json: Path | None
    page: Path | None
    model: Path | None

    @property
    def place(self) -> Path | None:
        """Beside which finished fits are kept."""
        return self.model or self.as_json or self.page

    def check(self) -> None:
        """Raise UserError for what may not be written, before anything is fitted."""
        if self.model is not None:
            check_folder(self.model, marker="model.yaml")
        for file, suffix in ((self.as_json, ".json"), (self.page, ".html")):
            if file is not None:
                check_file(file, suffix=suffix)
        if self.page is not None:
            report.check_available()

    def write(self, protocol: Protocol, comparison: Comparison, handling: str) -> None:
        """Write what is asked for, and say where it is."""
        if self.as_json is not None:
            text = json.dumps(results(protocol, comparison, handling), indent=1)
            write_text(self.as_json, text + "\n")
            console.print(str(self.as_json))
        if self.model is not None and comparison.chosen:
            comparison.model().save(self.model)
            console.print(f"{self.model}: {comparison.chosen}")
        if self.page is not None:
            with status.status("simulating for the page"):
                write_page(self.page, protocol, comparison, handling)
            console.print(str(self.page))


def _compared(
    protocol: Protocol, rig: Rig, structures: Sequence[str], store: CandidateStore | None, **settings: Any
) -> Comparison:
    """The comparison of structures, a line for each as it is finished; of an interrupted one, what there is of it.

    settings: further arguments of :func:`~studies.beam_lecture.comparison.compare`.
    """
    done: list[Candidate] = []
    try:
        with progress_bars(status) as update:
            update("structures", 0, len(structures))

            def tell_candidate(candidate: Candidate) -> None:
                done.append(candidate)
                status.print(f"  {candidate.structure}: {described(candidate)}")
                update("structures", len(done), len(structures))

            return compare(
                protocol.training,
                protocol.tests,
                rig,
                structures,
                part=protocol.parts,
                alike=protocol.alike,
                store=store,
                report=tell_candidate,
                **settings,
            )
    except KeyboardInterrupt:
        comparison = finished(done, structures)
        status.print(_interrupted(comparison, store))
        if not done:
            raise typer.Exit(INTERRUPTED) from None
        return comparison


def finished(candidates: Sequence[Candidate], structures: Sequence[str]) -> Comparison:
    """What there is of an interrupted comparison. Nothing is chosen: a structure that is missing may be better."""
    found = {candidate.structure: candidate for candidate in candidates}
    return Comparison(
        candidates=[found[name] for name in structures if name in found],
        chosen="",
        seconds=sum(candidate.seconds for candidate in candidates),
        missing=[name for name in structures if name not in found],
    )


def _interrupted(comparison: Comparison, store: Store[Candidate] | None) -> str:
    """What an interrupt left, in one line."""
    number = len(comparison.candidates)
    text = f"interrupted: {number} of {number + len(comparison.missing)} structures are finished"
    if store is None:
        return f"{text}; give --json, --out or --report to have them kept"
    return f"{text}, in {store.folder}; the same command goes on from there"


def described(candidate: Candidate) -> str:
    """One line on a candidate."""
    if candidate.validation is None:
        return f"failed: {candidate.error}"
    test = float(np.mean([list(seed.values()) for seed in candidate.r2]))
    held = f"R2 {r2_text(candidate.validation.value)} +- {candidate.validation.standard_error:.4f} held out"
    when = "of an earlier run" if candidate.kept else "in all"
    return f"{held}, {r2_text(test)} on the test, {candidate.seconds:.0f} s {when}"


def table(protocol: Protocol, comparison: Comparison, handling: str) -> Table:
    """Free-run R2, mean and range over the seeds, each structure beside its published row."""
    names = [table_name(record.name) for record, _ in protocol.tests]
    title = f"free-run R2, protocol {protocol.number}, {handling} input{_without(comparison)}"
    shown = Table("structure", *names, "held out", "fit", title=title)
    for candidate in comparison.candidates:
        row = lecture.published(protocol.number, candidate.structure)
        if row is not None and any(name in row for name in names):
            cells = (f"{row[name]:.3f}" if name in row else "" for name in names)
            shown.add_row(f"{candidate.structure}, published", *cells, "", "", style="dim")
        if candidate.validation is None:
            shown.add_row(candidate.structure, *("failed" for _ in names), "", "")
            continue
        cells = (_cell([seed[record.name] for seed in candidate.r2]) for record, _ in protocol.tests)
        seconds = max(model.fit["seconds"] for model in candidate.models)
        chosen = candidate.structure == comparison.chosen
        shown.add_row(
            candidate.structure + (", chosen" if chosen else ""),
            *cells,
            r2_text(candidate.validation.value),
            f"{seconds:.1f} s",
            style="bold" if chosen else "",
        )
    return shown


def _cell(values: list[float]) -> str:
    mean = r2_text(float(np.mean(values)))
    return mean if len(values) == 1 else f"{mean}\n{r2_text(min(values))} to {r2_text(max(values))}"


def results(protocol: Protocol, comparison: Comparison, handling: str) -> dict[str, Any]:
    """What the JSON file holds: structure -> record -> mean, min, max; chosen; seconds; partial, and the structures
    that are missing then; kept, those of an earlier run, which seconds leaves out; and how it came about.
    """
    content: dict[str, Any] = {
        candidate.structure: {
            table_name(record.name): _spread([seed[record.name] for seed in candidate.r2])
            for record, _ in protocol.tests
        }
        for candidate in comparison.candidates
        if candidate.r2
    }
    validated = [item for item in comparison.candidates if item.validation is not None]
    return {
        **content,
        "chosen": comparison.chosen,
        "seconds": round(comparison.seconds, 1),
        "partial": bool(comparison.missing),
        "missing": list(comparison.missing),
        "kept": [item.structure for item in comparison.candidates if item.kept],
        "protocol": protocol.number,
        "input": handling,
        "rule": RULE,
        "validation": {
            item.structure: {
                "r2": _finite(item.validation.value),
                "standard_error": _finite(item.validation.standard_error),
                "parameters": item.parameters,
                "fit_seconds": [model.fit["seconds"] for model in item.models],
            }
            for item in validated
            if item.validation is not None
        },
        "failed": {item.structure: item.error for item in comparison.candidates if item.error},
    }


def _without(comparison: Comparison) -> str:
    """What a title says of an interrupted comparison."""
    return f" (interrupted: without {', '.join(comparison.missing)})" if comparison.missing else ""


def _spread(values: list[float]) -> dict[str, float | None]:
    return {"mean": _finite(float(np.mean(values))), "min": _finite(min(values)), "max": _finite(max(values))}


def _finite(value: float) -> float | None:
    """JSON has no infinity: a diverged simulation is null."""
    return round(value, 5) if np.isfinite(value) else None


def write_page(path: Path, protocol: Protocol, comparison: Comparison, handling: str) -> None:
    """The HTML page: the table; free runs, residuals, horizons and parameters of the pick and of two for reference."""
    records = {record.name: record for record, _ in protocol.tests}
    runs = [(records[record.name], part) for record, part in protocol.tests]
    fitted = [item.structure for item in comparison.candidates if item.models]
    shown = {comparison.chosen, "linear", "hybrid"}.intersection(fitted) or fitted[:1]
    found = [
        StructureResult(
            name=item.structure,
            r2=[{table_name(name): value for name, value in seed.items()} for seed in item.r2],
            seconds=max(model.fit["seconds"] for model in item.models),
            published=lecture.published(protocol.number, item.structure),
            chosen=item.structure == comparison.chosen,
            cross_validation=None if item.validation is None else item.validation.value,
            model=item.models[0] if item.structure in shown else None,
            runs=runs if item.structure in shown else (),
        )
        for item in comparison.candidates
        if item.r2
    ]
    title = f"Protocol {protocol.number}, {handling} input{_without(comparison)}"
    pick = f"The pick has {RULE}: no test record had a say in it."
    about = f"{protocol.about} {pick if comparison.chosen else 'Nothing is chosen: structures are missing.'}"
    section = protocol_section(
        title, found, about=about, training=list(zip(protocol.training, protocol.parts, strict=True))
    )
    model = next(item for item in comparison.candidates if item.structure in shown).models[0]
    write_protocol(path, section, report.provenance(model, typed()))

"""hybrid-sysid search: the options of a structure."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros.commands import fit_options, options
from hybrid_sysid_ros.commands.records import read_records
from hybrid_sysid_ros.commands.terminal import console, print_table, status
from hybrid_sysid_ros.extensions.search.search import Evaluate, Objective, search, trial_name
from hybrid_sysid_ros.extensions.search.study import Evaluation, Study, TrialResult, opened_study
from hybrid_sysid_ros.extensions.shared.cluster import Cluster
from hybrid_sysid_ros.extensions.shared.parallel import Processes
from hybrid_sysid_ros.extensions.shared.workers import Workers
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Options
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError, counted
from hybrid_sysid_ros.support.files import check_folder
from hybrid_sysid_ros.support.progress import progress_bars

SHOWN = 5


def command(
    bag: Annotated[list[Path], typer.Argument(help="Bags to train on.")],
    study: Annotated[
        str, typer.Option(help="SQLite file that keeps the trials, or a database's URL.")
    ] = "out/search.db",
    name: Annotated[str, typer.Option(help="Name of the study in the file; the structure's name by default.")] = "",
    structure: fit_options.StructureName = "hybrid",
    trials: Annotated[int, typer.Option(help="Total number of trials, including those of earlier runs.", min=1)] = 40,
    timeout: Annotated[
        float, typer.Option(help="Time after which no further trial begins [s]; 0: no limit.", min=0.0)
    ] = 0.0,
    jobs: Annotated[int, typer.Option(help="Number of processes; -1: one on each processor.")] = -1,
    cluster: Annotated[
        str,
        typer.Option(
            help="Address of a Dask scheduler, such as tcp://host:8786; local starts one with --jobs workers."
        ),
    ] = "",
    folds: Annotated[int, typer.Option(help="Groups in which parts of the bags are held out in turn.", min=2)] = 3,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for a model with the best options.")] = None,
    rig: options.RigName = "",
    input_handling: fit_options.InputHandlingOption = "averaged",
    step: fit_options.StepOption = None,
    period: fit_options.Period = None,
    part: options.PartText = "0:1",
    seed: options.Seed = 0,
    signals: options.SignalsFile = None,
    recover: options.Recover = False,
    read_period: options.ReadPeriod = 0.0,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Search the options of a structure for the best free run over data held out (needs the extra [search]).

    Finished trials are kept in the study: an interrupted search goes on when the same command is given again.
    """
    if out is not None:
        check_folder(out, marker="model.yaml", replace=overwrite)
    described = load_rig(rig)
    records = read_records(bag, rig, signals, recover, read_period, input_handling)
    sampling = fit_options.sampling_of(described, step, period, input_handling, {}, records)
    objective = Objective(
        records=records,
        rig=described,
        structure=structure,
        sampling=sampling,
        part=Part.parse(part),
        seed=seed,
        folds=folds,
    )
    with opened_study(study, name or structure, problem=objective.problem, space=objective.space, seed=seed) as kept:
        try:
            with workers(objective, cluster, jobs) as found:
                run(kept, found, trials, timeout or None)
        except KeyboardInterrupt:
            done = len(kept.finished)
            status.print(f"interrupted: {done} of {trials} trials are in {study}; the same command goes on from there")
            raise typer.Exit(130) from None
        except UserError as error:
            raise UserError(f"{error}; {len(kept.finished)} of {trials} trials are in {study}") from error
        title = f"study {name or structure} in {study}"
        check_ranking(kept, title)
        if as_json:
            console.print(json.dumps(content(kept), indent=2))
        else:
            show(kept, objective, title)
        best = kept.ranking[0]
    if out is not None:
        with status.status("fitting"):
            objective.fit(best.options).save(out)
        (status if as_json else console).print(
            f"{out}: {structure} with the options of trial {best.number}, from {counted(len(bag), 'record')}"
        )


def workers(objective: Objective, cluster: str, jobs: int) -> Workers[tuple[int, Options], TrialResult]:
    """Those that the command line asks for."""
    work = Evaluate(objective=objective)
    if cluster:
        return Cluster(work, cluster, jobs=jobs, tell=status.print, name=trial_name)
    return Processes(work, jobs=jobs, tell=status.print, name=trial_name)


def run(study: Study, found: Workers[tuple[int, Options], TrialResult], trials: int, timeout: float | None) -> None:
    """Search with a progress bar, and a line for each trial that is better than all before it or fails."""
    with progress_bars(status) as update:
        best = max((trial.outcome.score for trial in study.ranking), default=-math.inf)
        update("trials", len(study.finished), trials)

        def report(trial: Evaluation) -> None:
            nonlocal best
            outcome = trial.outcome
            if outcome.error:
                status.print(f"  trial {trial.number} failed: {outcome.error}")
            elif outcome.score > best:
                best = outcome.score
                status.print(f"  trial {trial.number}: R2 {best:.4f} with {written(trial)}")
            update("trials", len(study.finished), trials)

        search(study, found, trials=trials, timeout=timeout, report=report)


def check_ranking(study: Study, title: str) -> None:
    """Raise UserError where no trial is good."""
    finished = study.finished
    if not finished:
        raise UserError(f"{title}: no trial is finished; give a longer --timeout")
    if not study.ranking:
        last = finished[-1].outcome.error or "its free runs diverged"
        raise UserError(f"{title}: none of its {len(finished)} trials gave a model; the last one: {last}")


def content(study: Study) -> dict[str, Any]:
    """The trials, the best first, and which options matter, as plain data."""
    trials = [
        {"trial": trial.number, "r2": trial.outcome.score, "seconds": trial.outcome.seconds, "options": trial.options}
        for trial in study.ranking
    ]
    failed = {trial.number: trial.outcome.error for trial in study.finished if trial.outcome.error}
    return {"trials": trials, "failed": failed, "importance": study.importance()}


def show(study: Study, objective: Objective, title: str) -> None:
    """Print the best trials, the one at the defaults, and which options matter."""
    ranking, finished = study.ranking, study.finished
    shown = ranking[:SHOWN] + [trial for trial in ranking[SHOWN:] if trial.number == 0]
    names = [f"{trial.number}, defaults" if trial.number == 0 else str(trial.number) for trial in shown]
    table = Table("trial", *names, title=title)
    table.add_row("held-out R2", *(f"{trial.outcome.score:.4f}" for trial in shown))
    table.add_row("seconds", *(f"{trial.outcome.seconds:.1f}" for trial in shown), end_section=True)
    for name in objective.space:
        table.add_row(name, *(f"{trial.options[name]:.4g}" for trial in shown))
    print_table(table)
    if importance := study.importance():
        shares = ", ".join(f"{option} {100 * share:.0f} %" for option, share in importance.items() if share >= 0.01)
        console.print(f"what makes trials good: {shares}")
    failed = sum(bool(trial.outcome.error) for trial in finished)
    console.print(
        f"{len(finished)} trials{f', {failed} of them failed' if failed else ''}; best: {written(ranking[0])}"
    )


def written(trial: Evaluation) -> str:
    """Its options, as a command takes them."""
    return " ".join(f"{name}={value:.6g}" for name, value in trial.options.items())

"""hybrid-sysid tune: weights, horizon and filter noises of a rig's loop."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from hybrid_sysid_ros.commands import options
from hybrid_sysid_ros.commands.terminal import console, status, typed
from hybrid_sysid_ros.extensions.shared.report.rendering import check_available
from hybrid_sysid_ros.extensions.shared.report.sections import provenance
from hybrid_sysid_ros.extensions.tuning import tuning
from hybrid_sysid_ros.extensions.tuning.front import opened_trials
from hybrid_sysid_ros.extensions.tuning.loops import Loops
from hybrid_sysid_ros.extensions.tuning.report.front_page import write_front
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.files import check_folder
from hybrid_sysid_ros.support.progress import progress_bars


def command(
    rig: options.RigPlace,
    model: Annotated[Path | None, typer.Option(help="Model folder; the shipped one by default.")] = None,
    aim: Annotated[
        Literal["settling", "effort", "bounds"],
        typer.Option(
            help="What the best trial has: the least settling without more effort than what ships, the least effort "
            "that settles as fast, or the most loops within the rig's travel and validity."
        ),
    ] = "settling",
    trials: Annotated[int, typer.Option(help="Total number of trials, including those of earlier runs.", min=2)] = 60,
    loops: Annotated[int, typer.Option(help="Closed loops of each trial.", min=2)] = 24,
    horizons: Annotated[float, typer.Option(help="Length of a loop, in horizons of the shipped MPC.", min=1.0)] = 5.0,
    study: Annotated[str, typer.Option(help="SQLite file that keeps the trials, or a database's URL.")] = "out/tune.db",
    out: Annotated[Path, typer.Option("--out", help="Folder for the parameter file, the result and the page.")] = Path(
        "out/tuned"
    ),
    jobs: Annotated[int, typer.Option(help="Number of processes; 0: one on each processor.", min=0)] = 0,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Tune weights, horizon and filter noises on simulated loops of the certificate's kinds (extras [search, report]).

    Finished trials are kept in the study: an interrupted tuning goes on when the same command is given again. The best
    trial is measured on loops that no trial has seen; only what is better there is written as a parameter file.
    """
    check_available()
    check_folder(out, marker=tuning.RESULT, replace=overwrite)
    described = load_rig(rig)
    loaded = load_model(model or shipped(described.name, "model"), rig=described.source)
    bench = Loops(rig=described, model=loaded, seed=seed, count=loops, horizons=horizons)
    problem = {
        "rig": described.name,
        "model": loaded.seal,
        "loops": loops,
        "horizons": horizons,
        "seed": seed,
        "space": {name: [option.low, option.high] for name, option in bench.space.items()},
    }
    with opened_trials(study, f"{described.name} {aim}", problem, bench.space, seed) as kept:
        try:
            with progress_bars(status) as update:
                found = tuning.tune(bench, kept, aim, trials, workers=jobs, progress=partial(update, "trials"))
        except KeyboardInterrupt:
            done = len(kept.finished)
            status.print(f"interrupted: {done} of {trials} trials are in {study}; the same command goes on from there")
            raise typer.Exit(130) from None
    content = tuning.content(bench, found)
    source = provenance(loaded, typed())
    tuning.save(out, bench, found, lambda place: write_front(place, bench, found, source))
    if as_json:
        console.print(json.dumps(content, indent=2, default=list))
        return
    console.print(f"{described.name}: {found.sentence}")
    if found.better:
        console.print(f"{out}: {', '.join(f'{name}={value:.4g}' for name, value in found.best.options.items())}")
        console.print(f"  hybrid-sysid run --rig {rig} --policy exact --params-file {out / tuning.PARAMETERS}")
    console.print(f"{out / 'front.html'}: {len(found.trials)} trials and their front")

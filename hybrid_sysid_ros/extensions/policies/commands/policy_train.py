"""hybrid-sysid policy train: a network that imitates the exact MPC."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from hybrid_sysid_ros.commands import options, terminal
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.library.models import load_model
from hybrid_sysid_ros.library.policies import DEFAULT, train_policy
from hybrid_sysid_ros.models.structure import parse
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.files import beside, check_folder
from hybrid_sysid_ros.support.progress import progress_bars


def command(
    model: options.ModelFolder,
    out: Annotated[Path, typer.Option("--out", help="Folder for the policy.")],
    seed: options.Seed = 0,
    episodes: Annotated[
        int, typer.Option(help="Number of closed loops of 20 horizons in each round.", min=2)
    ] = DEFAULT.episodes[0],
    rounds: Annotated[
        int, typer.Option(help="Number of rounds; from the second on the policy drives (DAgger).", min=1)
    ] = len(DEFAULT.episodes),
    epochs: Annotated[
        int, typer.Option(help="Epochs of training in the last round; the earlier rounds take a third.", min=1)
    ] = DEFAULT.epochs,
    hidden: Annotated[str, typer.Option(help="Widths of the tanh layers.")] = ",".join(map(str, DEFAULT.hidden)),
    plan: Annotated[
        bool,
        typer.Option(
            "--plan/--first-input",
            help="Answer with a whole plan, which can be checked and certified, or with one input.",
        ),
    ] = DEFAULT.sequence,
    follow: Annotated[
        list[str] | None,
        typer.Option(
            "--follow", metavar="NAME=SPREAD", help="Parameter of the model that the policy adapts to, in its unit."
        ),
    ] = None,
    margin: Annotated[
        float,
        typer.Option(
            help="Share of a state's range by which the imitated MPC has its bounds tighter.", min=0.0, max=0.49
        ),
    ] = DEFAULT.margin,
    workers: options.WorkerCount = 0,
    cluster: options.ClusterAddress = "",
    rig: options.OwnRig = "",
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Sample the exact MPC in closed loop and train a network that imitates it (needs the extra [train]).

    An interrupted training goes on from the closed loops in OUT.samples when it is started again.
    """
    check_folder(out, marker="policy.yaml", replace=overwrite)
    widths, followed = _widths(hidden), parse(follow or [])
    loaded = load_model(model)
    samples = beside(out, ".samples")
    try:
        with progress_bars(terminal.status) as update:
            policy = train_policy(
                loaded.rig,
                loaded,
                episodes=episodes,
                rounds=rounds,
                epochs=epochs,
                hidden=widths,
                plan=plan,
                follow=followed,
                margin=margin,
                seed=seed,
                workers=workers,
                cluster=cluster,
                samples=samples,
                progress=update,
            )
    except KeyboardInterrupt:
        kept = Store(samples).kept
        text = f"{kept} closed loops are kept in {samples}; the same command goes on from there"
        raise Interrupted(text if kept else "") from None
    policy.save(out)
    if as_json:
        terminal.console.print(json.dumps(policy.training, indent=2))
    else:
        terminal.print_table(_table(policy.training, f"policy {out}"))


def _table(training: Mapping[str, Any], title: str) -> Table:
    """How a policy was trained."""
    table = Table("quantity", "value", title=title)
    for key, value in training.items():
        table.add_row(key.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value))
    return table


def _widths(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(width) for width in text.split(","))
    except ValueError as error:
        raise UserError(f"--hidden {text}: widths are whole numbers with commas between, as in 64,64") from error

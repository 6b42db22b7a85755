"""hybrid-sysid simulate: an experiment on a simulated rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid_sysid_ros.commands.options import Overwrite, RigName, Seed
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.rigs.experiments import duration_of, simulate_experiment
from hybrid_sysid_ros.rigs.rig import load as load_rig

RATE = 200.0
"""Samples per second of a rig whose step they fit [Hz]."""


def command(
    kind: Annotated[
        str, typer.Argument(help="One of the rig's experiments, such as multisine, or a file of signals (.csv).")
    ],
    out: Annotated[Path, typer.Argument(help="Bag to write.")],
    rig: RigName = "",
    seed: Seed = 0,
    duration: Annotated[
        float | None,
        typer.Option(help="Length of the experiment [s]; 40, or that of a file of signals.", min=1.0, max=3600.0),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Samples per second; 200, or what is next to it by the rig's step.", min=1e-6)
    ] = None,
    undisturbed: Annotated[bool, typer.Option("--undisturbed", help="Leave out the rig's disturbances.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Simulate an experiment on a rig, driven as the real one is, and write its bag."""
    chosen = load_rig(rig)
    seconds = duration_of(chosen, kind) if duration is None else duration
    whole = 1.0 / (max(1, round(1.0 / (RATE * chosen.step))) * chosen.step)
    options: dict[str, Any] = {"seed": seed, "duration": seconds, "rate": whole if rate is None else rate}
    console.print(
        str(simulate_experiment(chosen, kind, out, **options, overwrite=overwrite, disturbed=not undisturbed))
    )

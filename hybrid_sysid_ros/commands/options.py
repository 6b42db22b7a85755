"""Options that commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer


def _names() -> list[str]:
    from hybrid_sysid_ros.rigs.folder import names  # which reads rigs' equations

    return [*names()]


RigName = Annotated[
    str,
    typer.Option("--rig", help="Rig, by its name or by the path of its folder (./my_rig).", autocompletion=_names),
]
RigPlace = Annotated[str, typer.Argument(help="Rig, by its name or by the path of its folder.", autocompletion=_names)]
ModelFolder = Annotated[Path, typer.Argument(help="Model folder.")]


def _meet(rig: str) -> str:
    """Load a rig by its path, so that it is then known by the name in models and policies."""
    if rig:
        from hybrid_sysid_ros.rigs.rig import load

        load(rig)
    return rig


OwnRig = Annotated[
    str,
    typer.Option("--rig", help="Folder of the rig, if it is not known by name.", callback=_meet, autocompletion=_names),
]
"""Option of commands that get their rig from a model or a policy."""
SignalsFile = Annotated[Path | None, typer.Option("--signals", help="YAML with the topics and fields of your own bag.")]
Recover = Annotated[bool, typer.Option("--recover", help="Read what can be read of a truncated bag.")]
ReadPeriod = Annotated[
    float,
    typer.Option(
        "--read-period",
        help="Keep one sample in so many seconds, with the mean input between them, of a bag that is larger than the "
        "memory; 0 keeps all.",
        min=0.0,
    ),
]
PartText = Annotated[str, typer.Option("--part", help="Part of each bag that is used, as fractions START:STOP.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
DriverChoice = Literal["supervised", "network", "exact"]
"""Choices of the controller's parameter policy."""
WorkerCount = Annotated[int, typer.Option("--workers", help="Number of processes; 0: one on each processor.", min=0)]
ClusterAddress = Annotated[
    str,
    typer.Option("--cluster", help="Address of a Dask scheduler, such as tcp://host:8786; local starts one."),
]
Seed = Annotated[int, typer.Option("--seed", help="Random seed.", min=0)]

"""Options of commands that fit or score models: structures, samplings and starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.library.arguments import given_sampling
from hybrid_sysid_ros.models import InputHandling, Sampling, structure_names
from hybrid_sysid_ros.rigs.rig import Rig

StructureName = Annotated[
    str,
    typer.Option(
        help=f"{', '.join(structure_names())}, a further gray box of the rig, or hybrid_NAME on one.",
        autocompletion=structure_names,
    ),
]
StructureOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--option", metavar="NAME=VALUE", help="Option of the structure, such as units=8; may be given several times."
    ),
]
InputHandlingOption = Annotated[
    InputHandling,
    typer.Option(
        "--input",
        help="How the model takes its input: the mean over each step of samples that are held (averaged) or joined by "
        "lines (interpolated), one reading a period (sampled), or as the training records show it (auto).",
    ),
]
Initial = Annotated[
    str | None,
    typer.Option(
        "--initial",
        metavar="estimated|first|rest|NAME=VALUE,...",
        help="State at which a simulation of a record begins: estimated from the first samples near what the record "
        "shows (the default), as the record shows it, at rest, or values of states in SI.",
    ),
]
InitialSamples = Annotated[
    int | None, typer.Option("--initial-samples", help="Scored samples that estimate a start; 40 by default.", min=1)
]
WarmUp = Annotated[
    int | None, typer.Option("--warm-up", help="First scored samples of a record that no score counts.", min=0)
]
StepOption = Annotated[
    float | None, typer.Option("--step", help="Integration step [s]; by default that of the rig's file, or 0.005.")
]
Period = Annotated[
    float | None,
    typer.Option("--period", help="Time between fitted samples [s]; by default that of the rig's file, or 0.05."),
]


def sampling_of(
    rig: Rig,
    step: float | None,
    period: float | None,
    handling: InputHandling,
    start: Mapping[str, str | int | None],
    records: Sequence[Record] = (),
) -> Sampling:
    """The sampling of options, the rest as the rig's file says, or else as records allow. start: ``initial``,
    ``initial_samples``, ``warm_up``. Raises UserError for values that can't be.
    """
    given = {"step": step, "period": period, "input": handling, **start}
    return given_sampling({name: value for name, value in given.items() if value is not None}, rig, records)

"""hybrid-sysid run: the whole loop as ROS 2 processes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.table import Table

from hybrid_sysid_ros.commands import options, terminal
from hybrid_sysid_ros.report.run_summary import RunSummary
from hybrid_sysid_ros.rigs.rig import default
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.companion import LOOP, Companion
from hybrid_sysid_ros.runtime.parameters import of_file
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import Interrupted
from hybrid_sysid_ros.support.progress import progress_bars

EXTENDED_BY = "companions"


def command(
    rig: options.RigName = "",
    policy: Annotated[options.DriverChoice, typer.Option(help="What drives the rig.")] = "supervised",
    solver: Annotated[
        Literal["sqp", "ipopt"], typer.Option(help="Solver of the exact MPC; ipopt is the slow reference.")
    ] = "sqp",
    model: Annotated[Path | None, typer.Option(help="Model folder; the shipped one by default.")] = None,
    policy_path: Annotated[Path | None, typer.Option(help="Policy folder; the shipped one by default.")] = None,
    rate: Annotated[float | None, typer.Option(help="Measurements per second [Hz]; the rig's rate by default.")] = None,
    duration: Annotated[float, typer.Option(help="Length of the run [s]; 0: as long as the reference.")] = 0.0,
    reference: Annotated[
        str,
        typer.Option(
            help="Reference: constant, steps, sine, multisine, one of the rig's, or a file of signals (.csv); by "
            "default the rig's first."
        ),
    ] = "",
    seed: options.Seed = 0,
    bag: Annotated[Path | None, typer.Option(help="Record into this bag.")] = None,
    overwrite: options.Overwrite = False,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Run in simulated time, as fast as the nodes answer; the run repeats.")
    ] = False,
    composed: Annotated[
        bool, typer.Option("--composed", help="Run all nodes but the recorder in one process.")
    ] = False,
    params_file: Annotated[
        Path | None, typer.Option(help="ROS parameter file of the nodes, such as one that `tune` writes.")
    ] = None,
    domain: Annotated[int | None, typer.Option(help="ROS domain; that of ROS_DOMAIN_ID by default.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print all diagnostics at the end.")] = False,
    as_json: options.Json = False,
    companions: Sequence[Companion] = (),
) -> None:
    """Run plant, estimator, controller and reference as ROS 2 nodes; end with six lines on how it went."""
    with progress_bars(terminal.status) as update:

        def progress(seconds: float, expected: float) -> None:
            if expected:
                update(f"{reference or 'reference'}, seconds", min(int(seconds), int(expected)), int(expected))

        outcome = Run(
            rig=rig,
            policy=policy,
            solver=solver,
            model=model or "",
            policy_path=policy_path or "",
            rate=rate,
            duration=duration,
            reference=reference,
            seed=seed,
            bag=bag,
            overwrite=overwrite,
            companions=companions,
            parameters=_in_file(params_file),
            lockstep=lockstep,
            composed=composed,
            domain=domain,
            tell=terminal.status.print,
            progress=progress,
        ).go()
    kept = outcome.bag if outcome.bag is not None and outcome.bag.exists() else None
    if outcome.diagnostics:
        summary = RunSummary.of(outcome.diagnostics, load_rig(rig or default()), bag=kept, lockstep=lockstep)
        _print(summary, outcome.diagnostics, verbose=verbose, as_json=as_json)
    if outcome.interrupted:
        raise Interrupted(f"{outcome.bag} holds what was recorded" if kept else "")


def _print(summary: RunSummary, diagnostics: Mapping[str, Mapping[str, Any]], *, verbose: bool, as_json: bool) -> None:
    """Print how a run went, and the last diagnostics where all of them are asked for."""
    if as_json:
        terminal.console.print(json.dumps(summary.content | {"diagnostics": diagnostics}, indent=2))
        return
    if verbose:
        terminal.print_table(_table(diagnostics))
    terminal.print_lines(summary.lines, summary.alarms)


def _in_file(file: Path | None) -> dict[str, dict[str, Any]]:
    """Parameters of the loop's nodes in a file, but for what all of them have from the command line."""
    found = {node: of_file(str(file), f"/{node}") for node in LOOP} if file else {}
    return {
        node: {name: given[name] for name in given if name not in ("rig", "lockstep")} for node, given in found.items()
    }


def _table(diagnostics: Mapping[str, Mapping[str, Any]]) -> Table:
    table = Table("node", "quantity", "value", title="last diagnostics")
    for node, values in diagnostics.items():
        for key, value in values.items():
            table.add_row(node, key, f"{value:.4g}" if isinstance(value, float) else str(value))
    return table

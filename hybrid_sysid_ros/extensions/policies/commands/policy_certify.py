"""hybrid-sysid policy certify: how a policy does beside the exact MPC, and how sure that is."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands import options, terminal
from hybrid_sysid_ros.control.safety import certificate as certificates
from hybrid_sysid_ros.control.safety.supervisor import REASONS
from hybrid_sysid_ros.extensions.policies.configured import trial_of
from hybrid_sysid_ros.extensions.policies.counting import certify
from hybrid_sysid_ros.extensions.policies.criteria import EXACT, JUDGED
from hybrid_sysid_ros.extensions.policies.trial import Trial
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.files import beside, check_file
from hybrid_sysid_ros.support.progress import progress_bars


def command(
    policy: Annotated[Path, typer.Argument(help="Policy folder; the certificate is written into it.")],
    model: Annotated[
        Path | None,
        typer.Option(help="Folder of the model that the policy was trained on; the shipped one by default."),
    ] = None,
    loops: Annotated[
        int, typer.Option(help="Number of independent closed loops of this seed; other seeds stay counted.", min=1)
    ] = certificates.LOOPS,
    seed: options.Seed = 0,
    seconds: Annotated[float | None, typer.Option(help="Length of a loop [s].", min=0.02, max=8.0)] = None,
    delta: Annotated[
        float, typer.Option(help="Probability with which one of all bounds may be wrong.")
    ] = certificates.DELTA,
    workers: options.WorkerCount = 0,
    cluster: options.ClusterAddress = "",
    again: Annotated[
        int | None,
        typer.Option("--again", help="Number of a loop to run again and print; nothing is written.", min=0),
    ] = None,
    driver: Annotated[options.DriverChoice, typer.Option(help="What drives the loop of --again.")] = "network",
    rig: options.OwnRig = "",
    as_json: options.Json = False,
) -> None:
    """Run random closed loops of a policy beside the exact MPC and state how it does, with how much confidence.

    Ctrl-C keeps what is done; the same command goes on from there. Loops that are counted stay so.
    """
    trial = trial_of(policy, model, seed=seed, seconds=seconds)
    if again is not None:
        if as_json:
            raise UserError("--again prints a table of one loop: leave --json out")
        terminal.print_table(loop_table(trial, again, driver))
        return
    certificate = _counted(policy, trial, loops, delta=delta, workers=workers, cluster=cluster)
    certificate.save(policy)
    if as_json:
        terminal.console.print(json.dumps(content(certificate), indent=2))
        return
    for table in tables(certificate):
        terminal.print_table(table)
    terminal.console.print(summary(certificate))
    terminal.console.print(str(policy / certificates.FILE))


def _counted(policy: Path, trial: Trial, loops: int, **settings: Any) -> certificates.Certificate:
    """The certificate of so many loops, with those that are counted already. settings: those of :func:`certify`. Raises
    UserError where more are counted, and where finished loops can't be kept.
    """
    store = beside(policy, ".certificate.part")
    check_file(policy / certificates.FILE)
    if store.exists() and not store.is_dir():
        raise UserError(f"{store}: is a file, and finished loops are to be kept there: remove it")
    before, seed = _before(policy, trial), trial.seed
    there = next((sum(item.loops.values()) for item in before.ledger if item.seed == seed), 0) if before else 0
    if there > loops:
        raise UserError(f"{policy / certificates.FILE}: counts {there} loops of seed {seed}; give as many with --loops")
    kept = 0
    try:
        with progress_bars(terminal.status) as update:

            def progress(stage: str, done: int, of: int) -> None:
                nonlocal kept
                kept = done
                update(stage, done, of)

            return certify(trial, loops=loops, before=before, store=store, progress=progress, **settings)
    except KeyboardInterrupt:
        raise Interrupted(f"{kept} of {loops} loops are kept; the same command goes on from there") from None


def _before(policy: Path, trial: Trial) -> certificates.Certificate | None:
    """The policy's certificate so far; None where there is none, or one of another policy or model."""
    path = policy / certificates.FILE
    if path.is_file():  # one that was altered is nobody's to replace
        storage.load_sheet(path, kind="certificate", version=certificates.FORMAT)
    try:
        return certificates.find_certificate(policy, policy=trial.seal, model=trial.policy.model)
    except UserError:
        return None


def content(certificate: certificates.Certificate) -> dict[str, Any]:
    """The certificate as plain data, with what follows of its counts."""
    return {**asdict(certificate), "failed": certificate.failed, "bounds": certificate.bounds}


def tables(certificate: certificates.Certificate) -> list[Table]:
    """What was counted, and the worst cases."""
    counted = Table("driver", "stratum", "loops", title="certificate")
    names = list(certificate.failed["network"][certificates.MIXTURE])
    for name in names:
        counted.add_column(f"failed {name}", justify="right")
    counted.add_column("rate at least", justify="right")
    for driver, parts in certificate.failed.items():
        for stratum, failed in parts.items():
            bound = certificates.rounded_down(certificate.bounds[driver][stratum])
            counted.add_row(driver, stratum, str(certificate.strata[stratum]), *map(str, failed.values()), bound)
    answers = {reason: sum(entry.check.get(reason, 0) for entry in certificate.ledger) for reason in REASONS}
    checked = Table("the online check", "share", title="supervised")
    for reason, count in answers.items():
        checked.add_row(reason, f"{count / sum(answers.values()):.4f}")
    worst = Table("worst loops of", "by", "--seed", "--again", "input error", "in period", "cost / exact")
    for case in certificate.worst:
        ratio = case["cost"] / case["exact_cost"] if case["exact_cost"] else np.inf
        worst.add_row(
            case["driver"],
            case["by"],
            str(case["seed"]),
            str(case["loop"]),
            f"{case['input_error']:.3f}",
            str(case["period"]),
            f"{ratio:.3f}",
        )
    return [counted, checked, worst]


def summary(certificate: certificates.Certificate) -> str:
    """The certificate in two lines."""
    exact = [sum(entry.exact[name] for entry in certificate.ledger) for name in ("not_converged", "periods")]
    seeds = ", ".join(str(entry.seed) for entry in certificate.ledger)
    worst = certificate.worst_stratum("supervised")
    return (
        f"supervised keeps everything in {certificates.rounded_down(certificate.mu('supervised'))} of the loops of its "
        f"worst stratum, {worst}, at least; {certificate.loops} loops of seeds {seeds}, delta {certificate.delta:g} "
        f"for {certificate.statements} statements; the exact MPC did not converge in {exact[0] / exact[1]:.2%} of its "
        "periods"
    )


def loop_table(trial: Trial, loop: int, driver: str) -> Table:
    """One loop, period by period."""
    scenario = trial.scenario(loop)
    driven = trial.run(scenario, {"exact": EXACT, **JUDGED}[driver])
    policy, system = trial.policy, trial.model
    table = Table("time [s]")
    for k in policy.tracked:
        output = system.outputs[k]
        table.add_column(f"reference {output.name} [{output.unit}]")
    for item in system.states:
        table.add_column(f"{item.name} [{item.unit}]")
    for item in system.inputs:
        table.add_column(f"{item.name} [{item.unit}]")
        table.add_column("exact")
    table.add_column("check")
    table.title = f"loop {loop} of seed {trial.seed}, driven by {driver}"
    for k, (given, exact, reason) in enumerate(zip(driven.inputs, driven.exact, driven.reasons, strict=True)):
        pairs = [f"{value:.3f}" for pair in zip(given, exact, strict=True) for value in pair]
        table.add_row(
            f"{(k + 1) * policy.period:.3f}",
            *(f"{scenario.references[k, output]:.4g}" for output in policy.tracked),
            *(f"{value:.4g}" for value in driven.states[k + 1]),
            *pairs,
            REASONS[reason] if reason >= 0 else "",
        )
    return table

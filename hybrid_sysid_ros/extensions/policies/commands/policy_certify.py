"""hybrid-sysid policy certify: how a policy does beside the exact MPC, and how sure that is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands.terminal import Driver, OwnRig, Seed, console, print_table, status
from hybrid_sysid_ros.control.safety.certificate import FILE, FORMAT, LEAST_LOOPS, Certificate, find_certificate
from hybrid_sysid_ros.control.safety.supervisor import REASONS
from hybrid_sysid_ros.extensions.policies.by_rig import certification_of
from hybrid_sysid_ros.extensions.policies.certification import certify
from hybrid_sysid_ros.extensions.policies.certified_loops import EXACT, JUDGED, Certification
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.files import beside, check_file
from hybrid_sysid_ros.support.progress import progress_bars

LOOPS = 26_500
CRITERIA = {
    "input": "input within {eta} of exact",
    "bounds": "bounds",
    "cost": "cost within {share:.0%} of exact",
    "all": "all of these",
}


def command(
    policy: Annotated[Path, typer.Argument(help="Policy folder; the certificate is written into it.")],
    model: Annotated[
        Path | None,
        typer.Option(help="Folder of the model that the policy was trained on; the shipped one by default."),
    ] = None,
    loops: Annotated[
        int, typer.Option(help=f"Number of independent closed loops; {LEAST_LOOPS} give a margin of .01.", min=1)
    ] = LOOPS,
    seed: Seed = 0,
    seconds: Annotated[float | None, typer.Option(help="Length of a loop [s].", min=0.02, max=8.0)] = None,
    delta: Annotated[float, typer.Option(help="Probability with which a bound may be wrong.")] = 0.01,
    workers: Annotated[int, typer.Option(help="Number of processes; 0: one on each processor.", min=0)] = 0,
    again: Annotated[
        int | None,
        typer.Option("--again", help="Number of a loop to run again and print; nothing is written.", min=0),
    ] = None,
    driver: Annotated[Driver, typer.Option(help="What drives the loop of --again.")] = "network",
    rig: OwnRig = "",
) -> None:
    """Run random closed loops of a policy beside the exact MPC and state how it does, with how much confidence.

    Ctrl-C keeps what is done; the same command goes on from there. A certificate of more loops is not replaced.
    """
    certification = certification_of(policy, model, seed=seed, seconds=seconds)
    if again is not None:
        print_table(loop_table(certification, again, driver))
        return
    store = beside(policy, ".certificate.part")
    check_file(policy / FILE)
    if store.exists() and not store.is_dir():
        raise UserError(f"{store}: is a file, and finished loops are to be kept there: remove it")
    there = _loops(policy, certification)
    if there > loops:
        raise UserError(f"{policy / FILE}: is of {there} loops; give as many with --loops, or remove it first")
    kept = 0
    try:
        with progress_bars(status) as update:

            def progress(stage: str, done: int, of: int) -> None:
                nonlocal kept
                kept = done
                update(stage, done, of)

            certificate = certify(
                certification, loops=loops, delta=delta, workers=workers, store=store, progress=progress
            )
    except KeyboardInterrupt:
        raise Interrupted(f"{kept} of {loops} loops are kept; the same command goes on from there") from None
    certificate.save(policy)
    for table in tables(certificate):
        print_table(table)
    console.print(summary(certificate))
    console.print(str(policy / FILE))


def _loops(policy: Path, certification: Certification) -> int:
    """Of the policy's certificate; 0 where there is none that counts."""
    path = policy / FILE
    if path.is_file():  # one that was altered is nobody's to replace
        storage.load_sheet(path, kind="certificate", version=FORMAT)
    try:
        there = find_certificate(policy, policy=certification.seal, model=certification.policy.model)
    except UserError:
        return 0
    return 0 if there is None else there.loops


def tables(certificate: Certificate) -> list[Table]:
    """What was counted, and the worst cases."""
    criteria, rates = certificate.criteria, certificate.rates
    counted = Table("driver", "a loop keeps", title="certificate")
    for heading in ("share", "failed", "mu, Hoeffding", "mu, binomial"):
        counted.add_column(heading, justify="right")
    for name in JUDGED:
        for key, text in CRITERIA.items():
            rate = rates[name][key]
            failed = round((1.0 - rate) * certificate.loops)
            bounds = [certificate.bounds[kind][name][key] for kind in ("hoeffding", "binomial")]
            words = text.format(
                eta=", ".join(f"{value:g}" for value in criteria["input_error"]), share=criteria["cost_share"]
            )
            counted.add_row(name, words, f"{rate:.4f}", str(failed), *(f"{bound:.4f}" for bound in bounds))
    checked = Table("the online check", "share", title="supervised")
    for reason in REASONS:
        checked.add_row(reason, f"{certificate.check[reason]:.4f}")
    worst = Table("worst loops of", "by", "--again", "input error", "in period", "cost / exact")
    for case in certificate.worst:
        ratio = case["cost"] / case["exact_cost"] if case["exact_cost"] else np.inf
        worst.add_row(
            case["driver"],
            case["by"],
            str(case["loop"]),
            f"{case['input_error']:.3f}",
            str(case["period"]),
            f"{ratio:.3f}",
        )
    return [counted, checked, worst]


def summary(certificate: Certificate) -> str:
    """The certificate in two lines."""
    return (
        f"{certificate.loops} loops of {certificate.distribution['seconds']:g} s, margin {certificate.margin:.4f} with "
        f"delta {certificate.delta:g}, seed {certificate.seed}, {certificate.made['seconds']:.0f} s; "
        f"the exact MPC did not converge in {certificate.exact['not_converged']:.2%} of the periods"
    )


def loop_table(certification: Certification, loop: int, driver: str) -> Table:
    """One loop, period by period."""
    scenario = certification.scenario(loop)
    driven = certification.run(scenario, {"exact": EXACT, **JUDGED}[driver])
    policy, system = certification.policy, certification.model
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
    table.title = f"loop {loop} of seed {certification.seed}, driven by {driver}"
    for k, (given, exact, reason) in enumerate(zip(driven.loop.inputs, driven.exact, driven.reasons, strict=True)):
        pairs = [f"{value:.3f}" for pair in zip(given, exact, strict=True) for value in pair]
        table.add_row(
            f"{(k + 1) * policy.period:.3f}",
            *(f"{scenario.references[k, output]:.4g}" for output in policy.tracked),
            *(f"{value:.4g}" for value in driven.loop.states[k + 1]),
            *pairs,
            REASONS[reason] if reason >= 0 else "",
        )
    return table

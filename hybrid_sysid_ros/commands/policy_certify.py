"""hybrid-sysid policy certify: how a policy does beside the exact MPC, and how sure that is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from hybrid_sysid_ros.commands.terminal import Seed, console, print_table, status
from hybrid_sysid_ros.control.safety.certificate import FILE, LEAST_LOOPS, Certificate, find
from hybrid_sysid_ros.control.safety.certification import certify
from hybrid_sysid_ros.control.safety.certified_policy import JUDGED, Subject
from hybrid_sysid_ros.control.safety.online_check import REASONS
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.checking import subject_of
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.files import beside, check_file
from hybrid_sysid_ros.support.progress import progress_bars

LOOPS = 26_500
CRITERIA = {
    "input": "input within {eta:g} of exact",
    "bounds": "bounds",
    "cost": "cost within {share:.0%} of exact",
    "all": "all of these",
}


def command(
    policy: Annotated[Path, typer.Argument(help="Policy folder; the certificate is written into it.")],
    model: Annotated[
        Path | None, typer.Option(help="Folder of the model it imitates; the shipped one by default.")
    ] = None,
    loops: Annotated[
        int, typer.Option(help=f"Independent closed loops; {LEAST_LOOPS} for a margin of .01.", min=1)
    ] = LOOPS,
    seed: Seed = 0,
    seconds: Annotated[float | None, typer.Option(help="Length of a loop [s].", min=0.02, max=8.0)] = None,
    delta: Annotated[float, typer.Option(help="Probability with which a bound may be wrong.")] = 0.01,
    workers: Annotated[int, typer.Option(help="Threads; 0 for one per core.", min=0)] = 0,
    again: Annotated[
        int | None,
        typer.Option("--again", help="Run this loop again and print how it went; nothing is written.", min=0),
    ] = None,
    driver: Annotated[
        str, typer.Option(help="Who drives the loop of --again: network, supervised or exact.")
    ] = "network",
) -> None:
    """Run random closed loops of a policy beside the exact MPC and state how it does, with how much confidence.

    Ctrl-C keeps what is done; the same command goes on from there. A certificate of more loops is not replaced.
    """
    if driver not in (*JUDGED, "exact"):
        raise UserError(f"--driver {driver!r} is unknown; choose one of network, supervised, exact")
    subject = subject_of(policy, model, seed=seed, seconds=seconds)
    if again is not None:
        print_table(track_table(subject, again, driver))
        return
    store = beside(policy, ".certificate.part")
    for place in (policy / FILE, store):
        check_file(place)
    there = _loops(policy, subject)
    if there > loops:
        raise UserError(f"{policy / FILE}: is of {there} loops; give as many with --loops, or remove it first")
    kept = 0
    try:
        with progress_bars(status) as update:

            def progress(stage: str, done: int, of: int) -> None:
                nonlocal kept
                kept = done
                update(stage, done, of)

            certificate = certify(subject, loops=loops, delta=delta, workers=workers, store=store, progress=progress)
    except KeyboardInterrupt:
        raise Interrupted(f"{kept} of {loops} loops are kept; the same command goes on from there") from None
    certificate.save(policy)
    for table in tables(certificate):
        print_table(table)
    console.print(summary(certificate))
    console.print(str(policy / FILE))


def _loops(policy: Path, subject: Subject) -> int:
    """Of the policy's certificate; 0 where there is none that counts."""
    try:
        there = find(policy, policy=subject.seal, model=subject.policy.model)
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
            words = text.format(eta=criteria["input_error"], share=criteria["cost_share"])
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


def track_table(subject: Subject, loop: int, driver: str) -> Table:
    """One loop, period by period."""
    draw, track = subject.again(loop, driver)
    rig = load_rig(subject.policy.rig)
    output, scale, period = subject.policy.output, rig.display[0].scale, subject.policy.problem.period
    table = Table("time [s]", "reference [V]", "position [V]", "input", "exact", "check", title_justify="left")
    table.title = f"loop {loop} of seed {subject.seed}, driven by {driver}"
    for k, (given, exact, reason) in enumerate(zip(track.inputs, track.exact, track.reasons, strict=True)):
        table.add_row(
            f"{(k + 1) * period:.3f}",
            f"{draw.wanted[k] / scale:.3f}",
            f"{track.states[k + 1, output] / scale:.3f}",
            f"{given:.3f}",
            f"{exact:.3f}",
            REASONS[reason] if reason >= 0 else "",
        )
    return table

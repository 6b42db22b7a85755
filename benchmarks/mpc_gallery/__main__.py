"""Problems like those of other solvers' documentation, solved from a cold start by the exact MPC, IPOPT and acados.

All solve the same statement from the same first guess. Times are those around the Python call of a cold start, the
median of REPEATS; of acados, where it is installed, without what its interface sets and gets.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import acados_peer, result
from benchmarks.mpc_gallery import acados, mechanics, picture, processes
from benchmarks.mpc_gallery.case import Case
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control import ExactMpc, MpcSolution, Status
from hybrid_sysid_ros.support.arrays import Array

NAME = "mpc_gallery"
PICTURE = Path(__file__).parents[2] / "docs" / "results" / "mpc_gallery.svg"
CASES = {**mechanics.CASES, **processes.CASES}
REPEATS = 15
CLOSE = 1e-6
"""Largest share by which the cost may exceed IPOPT's."""


def timed(solver: Any, case: Case, repeats: int) -> tuple[MpcSolution, Array]:
    """The answer to a cold start, and the times of all of them [s]."""
    times = []
    for _ in range(repeats + 1):  # the first one compiles
        solver.reset()
        began = perf_counter()
        plan = solver.control(*case.instance)
        times.append(perf_counter() - began)
    return plan, np.array(times[1:])


def compared(case: Case, repeats: int = REPEATS) -> tuple[dict[str, Any], tuple[Case, Array]]:
    """All solvers on one case, whose costs are those of the simulated plans; and its states (N + 1, n)."""
    from hybrid_sysid_ros.extensions.ipopt.interior_point import InteriorPointMpc

    exact, peer = ExactMpc(case.system, case.problem), InteriorPointMpc(case.system, case.problem, tolerance=1e-10)
    plan, times = timed(exact, case, repeats)
    answer, others = timed(peer, case, repeats)
    cost, best = (exact.follow(found.inputs)[0] for found in (plan, answer))
    figures = {
        "status": plan.status.value,
        "ipopt_status": answer.status.value,
        "iterations": exact.iterations,
        "cost": cost,
        "excess": (cost - best) / max(abs(best), 1e-9),
        "inputs_apart": float(np.abs(plan.inputs - answer.inputs).max()),
        "milliseconds": result.percentiles(1e3 * times),
        "ipopt_milliseconds": result.percentiles(1e3 * others),
    }
    if acados_peer.installed():
        figures["acados"] = of_acados(case, exact, best, repeats)
    return figures, (case, exact.follow(plan.inputs)[1])


def of_acados(case: Case, exact: ExactMpc, best: float, repeats: int = REPEATS) -> dict[str, Any]:
    """By set-up, cost above the best and time; and the fastest that finds the optimum, if one does."""
    found = dict[str, Any]()
    for set_up in acados.SET_UPS:
        try:
            peer = acados.AcadosCase(case, set_up)
        except ValueError:
            return {}
        answers = [peer.solve() for _ in range(repeats + 1)]
        excess = (exact.follow(answers[-1][0])[0] - best) / max(abs(best), 1e-9)
        seconds = [answer[1] for answer in answers[1:]]
        found[set_up.name] = {
            "excess": excess if np.isfinite(excess) else None,
            "iterations": answers[-1][2],
            "milliseconds": result.percentiles(1e3 * np.array(seconds)),
        }
    optimal = [name for name, item in found.items() if item["excess"] is not None and item["excess"] <= CLOSE]
    fastest = min(optimal, key=lambda name: found[name]["milliseconds"]["p50"], default=None)
    return {"set_ups": found, "fastest": fastest}


def times_as_fast(repeats: int = REPEATS) -> float:
    """How many times as fast the uneven intervals of a case are solved as even ones over the same time."""
    uneven = mechanics.masses_uneven()
    even = replace(uneven, problem=replace(uneven.problem, intervals=()))
    one, other = (np.median(timed(ExactMpc(item.system, item.problem), item, repeats)[1]) for item in (even, uneven))
    return float(one / other)


def main() -> int:
    """Run, print a table, write the results."""
    headings = ("problem", "answer", "cost", "above IPOPT's", "steps", "p50", "IPOPT's", "acados'", "by")
    shown = Table(*headings, title="cold starts [ms]")
    results, machine, answers = {}, result.machine(), {}
    for name, make in CASES.items():
        case = make()
        found, answers[name] = compared(case)
        results[name] = found
        shown.add_row(
            name.replace("_", " "),
            found["status"],
            f"{found['cost']:.6g}",
            f"{found['excess']:.1e}",
            str(found["iterations"]),
            f"{found['milliseconds']['p50']:.2f}",
            f"{found['ipopt_milliseconds']['p50']:.2f}",
            *of_fastest(found),
        )
    print(picture.draw(PICTURE, answers))
    short = [name for name, found in results.items() if not same(found) or slower(found)]
    print_table(shown)
    faster = times_as_fast()
    print(f"uneven intervals are solved {faster:.1f} times as fast as even ones")
    short += ["uneven intervals"] if faster <= 1.0 else []
    print(f"short: {', '.join(short) or 'none'}")
    print(result.write(NAME, {"cases": results, "uneven_times_as_fast": faster, "short": len(short)}, on=machine))
    return 0


def same(found: dict[str, Any]) -> bool:
    """Whether the answer is IPOPT's optimum, or a better one."""
    return found["status"] == Status.SOLVED.value and found["excess"] <= CLOSE


def slower(found: dict[str, Any]) -> bool:
    """Whether IPOPT or acados is faster."""
    peers, fastest = [found["ipopt_milliseconds"]["p50"]], found.get("acados", {}).get("fastest")
    if fastest:
        peers.append(found["acados"]["set_ups"][fastest]["milliseconds"]["p50"])
    return bool(found["milliseconds"]["p50"] > min(peers))


def of_fastest(found: dict[str, Any]) -> tuple[str, str]:
    """Time and set-up of acados' fastest answer that is optimal, as cells."""
    if not found.get("acados"):
        return "", ""
    fastest = found["acados"]["fastest"]
    if fastest is None:
        return "", "no set-up finds it"
    return f"{found['acados']['set_ups'][fastest]['milliseconds']['p50']:.2f}", fastest


if __name__ == "__main__":
    result.run(main)

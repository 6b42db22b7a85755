"""The certificates of the shipped policies, rig by rig and stratum by stratum, beside what is asked of them.

The counts are those in the policies' folders; ``hybrid-sysid policy certify`` counts further loops.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.safety.certificate import ALL, MIXTURE, Certificate, rounded_down
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError

NAME = "certificates"
RIGS = ("cam_beam", "flexible_joint", "wheel_motor", "winged_cone", "drill_string")
ASKED = {"supervised": 0.999, "network": 0.99}
"""Of the worst stratum."""
SPARED = {"supervised": 0, "network": 1}
"""Rigs on which a driver may do worse."""


def main(arguments: list[str]) -> int:
    """Read, print tables, write the results."""
    argparse.ArgumentParser(prog=f"benchmarks.{NAME}", description=__doc__).parse_args(arguments)
    machine, found, short = result.machine(), {}, 0
    for rig in RIGS:
        certificate = _shipped(rig)
        found[rig] = _measured(certificate)
        print_table(_table(rig, certificate))
    for driver, asked in ASKED.items():
        below = [rig for rig in RIGS if found[rig][driver]["at least"] < asked]
        short += max(len(below) - SPARED[driver], 0)
        kept = f"{len(RIGS) - len(below)} of {len(RIGS)} rigs are at {asked} in their worst stratum"
        others = f"; not {', '.join(below)}" if below else ""
        print(f"{driver}: {kept}{others}")
    print(f"written to {result.write(NAME, {**found, 'short': short}, on=machine)}")
    return 0


def _shipped(rig: str) -> Certificate:
    """Raises UserError where a rig ships none."""
    model = load_model(configuration.shipped(rig, "model"))
    found = policy.load(configuration.shipped(rig, "policy"), model=model).certificate
    if found is None:
        raise UserError(f"{rig}: its policy has no certificate; hybrid-sysid policy certify makes one")
    return found


def _measured(certificate: Certificate) -> dict[str, Any]:
    """Of each driver: its worst stratum, the bound there and over all loops, and the failures of each stratum."""
    drivers = {
        driver: {
            "worst": certificate.worst_stratum(driver),
            "at least": certificate.mu(driver),
            "at least, mixture": certificate.bounds[driver][MIXTURE],
            "failed": parts,
        }
        for driver, parts in certificate.failed.items()
    }
    seeds = [entry.seed for entry in certificate.ledger]
    return {
        "loops": certificate.loops,
        "strata": certificate.strata,
        "delta": certificate.delta,
        "seeds": seeds,
        **drivers,
    }


def _table(rig: str, certificate: Certificate) -> Table:
    table = Table("stratum", "loops", title=f"{rig}, delta {certificate.delta:g}")
    for driver in ASKED:
        table.add_column(f"{driver}: failed", justify="right")
        table.add_column("at least", justify="right")
    for stratum, loops in certificate.strata.items():
        cells = []
        for driver in ASKED:
            mark = " *" if stratum == certificate.worst_stratum(driver) else ""
            bound = rounded_down(certificate.bounds[driver][stratum])
            cells += [str(certificate.failed[driver][stratum][ALL]), f"{bound}{mark}"]
        table.add_row(stratum, str(loops), *cells)
    return table


if __name__ == "__main__":
    result.run(lambda: main(sys.argv[1:]))

"""The certificate of a policy: what many random closed loops say about it, with how much confidence."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import path_of
from hybrid_sysid_ros.support.text_table import text_table

FORMAT = 2
FILE = "certificate.yaml"

LOOPS, DELTA = 138_149, 1e-6
"""By default: one statement over so many loops of which none failed is .9999, but with probability delta."""

ALL, MIXTURE = "all", "mixture"
"""The criterion that a loop keeps which keeps every other one; the loops of all strata together."""

ROUNDING = 1e-9
"""Of a bound that is written down."""

CASE = {"driver": str, "by": str, "seed": int, "loop": int, "input_error": float, "period": int, "cost": float}
"""What is said of one of the worst loops, beside the exact_cost."""

Failures = Mapping[str, Mapping[str, Mapping[str, int]]]
"""By driver, stratum and criterion: how many loops did not keep it."""


def binomial_bound(kept: int, loops: int, delta: float) -> float:
    """The rate at which so many or more of the loops are kept with probability delta: the exact lower bound.

    Independent loops are Bernoulli trials, so their number is binomial, and no inequality is needed: Clopper & Pearson
    (1934), The use of confidence or fiducial limits illustrated in the case of the binomial, Biometrika 26(4).
    """
    from scipy.stats import beta  # not in every node that reads a certificate

    # Not special.betaincinv, which errs by up to .06 before SciPy 1.12.
    return float(beta.ppf(delta, kept, loops - kept + 1)) if kept else 0.0


@dataclass(frozen=True, kw_only=True)
class SeedCounts:
    """What was counted over the loops of one seed. Raises UserError for what nobody counts."""

    seed: int
    loops: Mapping[str, int]
    """By stratum."""
    failed: Failures
    check: Mapping[str, int]
    """Answers of the online check, by its reason."""
    exact: Mapping[str, int]
    """periods of the exact MPC's own loops, and in how many it was not_converged."""
    made: Mapping[str, Any]
    """seconds and versions."""

    def __post_init__(self) -> None:
        where = f"ledger, seed {self.seed}"
        _whole(self.seed, f"{where}: seed")
        for name in ("loops", "check", "exact"):
            for key, value in _mapping(getattr(self, name), f"{where}: {name}").items():
                _whole(value, f"{where}: {name}.{key}")
        if not sum(self.loops.values()):
            raise UserError(f"{where}: has no loops")
        _mapping(self.made, f"{where}: made")
        for driver, strata in _mapping(self.failed, f"{where}: failed").items():
            if set(_mapping(strata, f"{where}: {driver}")) != set(self.loops):
                raise UserError(f"{where}: {driver} has other strata than loops")
            for stratum, counts in strata.items():
                here, most = f"{where}: {driver}, {stratum}", self.loops[stratum]
                for criterion, count in _mapping(counts, here).items():
                    _whole(count, f"{here}: {criterion}", most)
                single = [count for criterion, count in counts.items() if criterion != ALL]
                if ALL not in counts or not max(single, default=0) <= counts[ALL] <= (sum(single) if single else most):
                    raise UserError(f"{here}: the loops that failed {ALL} are not those that failed a criterion")


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What was counted, over what, and what it says.

    policy, model: seals of their folders. delta: probability with which one of all statements may be wrong; there is
    one for each driver (network, supervised) in each stratum, and in the mixture of them, and each has the same part of
    it. distribution: what loops are made of. criteria: what a loop must keep. ledger: every seed that was tried; what
    is certified is their loops together. worst: the loops with the largest errors, each with the seed and the number
    that run it again.
    """

    policy: str
    model: str
    delta: float
    distribution: Mapping[str, Any]
    criteria: Mapping[str, Any]
    ledger: Sequence[SeedCounts]
    worst: Sequence[Mapping[str, Any]]

    def __post_init__(self) -> None:
        """Raises UserError for what no certificate says: nodes and reports rely on it."""
        if type(self.delta) is not float or not 0.0 < self.delta < 1.0:
            raise UserError(f"delta is {self.delta!r}: it needs a number between 0 and 1")
        for name in ("distribution", "criteria"):
            _mapping(getattr(self, name), name)
        for case in self.worst:
            kinds = {name: type(value) for name, value in _mapping(case, "worst").items()}
            if kinds != {**CASE, "exact_cost": float}:
                raise UserError(f"worst has a loop of {kinds}: it needs {', '.join(CASE)} and exact_cost")
        seeds = [entry.seed for entry in self.ledger]
        if not seeds or len({*seeds}) != len(seeds):
            raise UserError(f"ledger has seeds {seeds}: it needs each once, and one at least")
        shapes = {
            str([sorted(entry.loops), {driver: _criteria(parts) for driver, parts in sorted(entry.failed.items())}])
            for entry in self.ledger
        }
        if len(shapes) > 1 or not self.ledger[0].failed:
            raise UserError("ledger has seeds of other drivers, strata or criteria than each other")

    def __repr__(self) -> str:
        return f"Certificate({self.loops} loops, delta {self.delta:g})"

    def __str__(self) -> str:
        """A table of the share of the loops that kept everything in each stratum, and the bound that holds for it."""
        rows = [
            (driver, stratum, f"{self.rates[driver][stratum][ALL]:.4f}", rounded_down(bound))
            for driver, parts in self.bounds.items()
            for stratum, bound in parts.items()
        ]
        title = f"certificate of {self.loops} closed loops, at a confidence of 1 - {self.delta:g}"
        return text_table(title, ("driver", "stratum", "share", "at least"), rows, most=24, rest="certificate.rates")

    @property
    def loops(self) -> int:
        return sum(sum(entry.loops.values()) for entry in self.ledger)

    @cached_property
    def strata(self) -> dict[str, int]:
        """How many loops there are of each stratum, and of the mixture."""
        found: Counter[str] = Counter()
        for entry in self.ledger:
            found.update(entry.loops)
        return {**found, MIXTURE: self.loops}

    @cached_property
    def failed(self) -> dict[str, dict[str, dict[str, int]]]:
        """By driver, stratum and criterion, over all seeds; the mixture is one of the strata."""
        found: dict[str, dict[str, dict[str, int]]] = {}
        for driver, strata in self.ledger[0].failed.items():
            parts = {
                stratum: {name: sum(entry.failed[driver][stratum][name] for entry in self.ledger) for name in names}
                for stratum, names in strata.items()
            }
            names = next(iter(parts.values()))
            parts[MIXTURE] = {name: sum(part[name] for part in parts.values()) for name in names}
            found[driver] = parts
        return found

    @property
    def rates(self) -> dict[str, dict[str, dict[str, float]]]:
        """Share of the loops that keep each criterion."""
        return {
            driver: {
                stratum: {name: 1.0 - count / max(self.strata[stratum], 1) for name, count in counts.items()}
                for stratum, counts in parts.items()
            }
            for driver, parts in self.failed.items()
        }

    @property
    def statements(self) -> int:
        """How many share delta."""
        return len(self.failed) * len(self.strata)

    @cached_property
    def bounds(self) -> dict[str, dict[str, float]]:
        """By driver and stratum: the true share of loops that keep everything is at least this."""
        share = self.delta / self.statements
        return {
            driver: {
                stratum: binomial_bound(self.strata[stratum] - counts[ALL], self.strata[stratum], share)
                for stratum, counts in parts.items()
            }
            for driver, parts in self.failed.items()
        }

    def worst_stratum(self, driver: str) -> str:
        """The stratum with the lowest bound."""
        return min(self.bounds[driver], key=lambda stratum: self.bounds[driver][stratum])

    def mu(self, driver: str) -> float:
        """The headline: the bound of the worst stratum."""
        return self.bounds[driver][self.worst_stratum(driver)]

    def save(self, folder: Path | str) -> None:
        """Write it into the folder of its policy. Raises UserError where that is another policy by now."""
        folder = path_of(folder, "folder")
        if storage.digest(folder, kind="policy") != self.policy:
            raise UserError(f"{folder}: is another policy than the one that was certified; certify it again")
        content = {**asdict(self), "statements": self.statements, "bounds": self.bounds}
        storage.save_sheet(folder / FILE, version=FORMAT, content=content)


def doubt(certificate: Certificate | None, driver: str, least: float) -> str:
    """What speaks against a driver (network, supervised) of a policy, in words; nothing where its headline is high
    enough.
    """
    if certificate is None:
        return "has no certificate (hybrid-sysid policy certify makes one)"
    mu = certificate.mu(driver)
    if mu >= least:
        return ""
    worst = certificate.worst_stratum(driver)
    return f"its certificate says {rounded_down(mu)} of {driver} in {worst}, less than certificate_rate {least:g}"


def rounded_down(bound: float) -> str:
    """A bound of four digits that is not above the bound."""
    return f"{math.floor(1e4 * bound) / 1e4:.4f}"


def find_certificate(folder: Path | str, *, policy: str, model: str) -> Certificate | None:
    """The certificate in a policy's folder, None where there is none.

    policy, model: seals of the policy and of the model that it is used with. Raises UserError where the certificate was
    altered, says other bounds than its counts, or belongs to another policy or model.
    """
    path = Path(folder) / FILE
    if not path.is_file():
        return None
    again = "certify it again (hybrid-sysid policy certify) or remove the certificate"
    content = storage.load_sheet(path, kind="certificate", version=FORMAT)
    try:
        ledger = [SeedCounts(**entry) for entry in content["ledger"]]
        given = {item.name: content[item.name] for item in fields(Certificate)}
        found = Certificate(**{**given, "ledger": ledger})
        _check_bounds(found, content["bounds"])
    except UserError as error:
        raise UserError(f"{path}: {error}; {again}") from error
    except (KeyError, TypeError) as error:
        raise UserError(f"{path}: {error!r} is missing or malformed; {again}") from error
    if found.policy != policy:
        raise UserError(f"{path}: belongs to another policy; {again}")
    if found.model != model:
        raise UserError(f"{path}: belongs to another model; {again}")
    return found


def _check_bounds(certificate: Certificate, written: Any) -> None:
    """Raises UserError where the bounds that are written are not those of the counts."""
    for driver, parts in certificate.bounds.items():
        for stratum, bound in parts.items():
            said = written[driver][stratum]
            if type(said) is not float or not math.isclose(said, bound, rel_tol=0.0, abs_tol=ROUNDING):
                raise UserError(f"bound of {driver}, {stratum} is {said!r}, and by its counts it is {bound:.6f}")


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise UserError(f"{where} is {value!r}: it needs keys")
    return value


def _whole(value: Any, where: str, most: int = 1 << 53) -> None:
    if type(value) is not int or not 0 <= value <= most:
        raise UserError(f"{where} is {value!r}: it needs a whole number from 0 to {most}")


def _criteria(parts: Mapping[str, Mapping[str, int]]) -> list[list[str]]:
    return sorted(sorted(counts) for counts in parts.values())

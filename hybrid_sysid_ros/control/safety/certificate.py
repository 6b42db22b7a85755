"""The certificate of a policy: what many random closed loops say about it, with how much confidence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import path_of
from hybrid_sysid_ros.support.text_table import text_table

FailureRates = Mapping[str, Mapping[str, float]]

FORMAT = 1
FILE = "certificate.yaml"

LEAST_LOOPS = 26_492
"""With so many loops the margin is .01 at a confidence of 99 %."""


def margin(loops: int, delta: float) -> float:
    """By how much a rate over independent loops may be better than the truth, but with probability delta.

    sqrt(ln(2 / delta) / (2 N)): Hoeffding's inequality, as Hertneck, Köhler, Trimpe, Allgöwer (2018), Learning an
    approximate model predictive controller with guarantees, IEEE L-CSS 2(3), use it.
    """
    return math.sqrt(math.log(2.0 / delta) / (2.0 * loops))


def binomial_bound(kept: int, loops: int, delta: float) -> float:
    """The rate at which so many or more of the loops are kept with probability delta: the exact lower bound.

    Independent loops are Bernoulli trials, so their number is binomial, and no inequality is needed: Clopper & Pearson
    (1934), The use of confidence or fiducial limits illustrated in the case of the binomial, Biometrika 26(4).
    """
    from scipy.special import betaincinv  # not in every node that reads a certificate

    return float(betaincinv(kept, loops - kept + 1, delta)) if kept else 0.0


def bounds(rates: FailureRates, loops: int, delta: float) -> dict[str, FailureRates]:
    """Rates that the true ones are at least, each but with probability delta, by hoeffding and by binomial."""
    return {
        "hoeffding": {
            driver: {name: max(rate - margin(loops, delta), 0.0) for name, rate in parts.items()}
            for driver, parts in rates.items()
        },
        "binomial": {
            driver: {name: binomial_bound(round(rate * loops), loops, delta) for name, rate in parts.items()}
            for driver, parts in rates.items()
        },
    }


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What was counted, and over what.

    policy, model: seals of their folders. loops, seed, delta: N random loops of this seed, and the probability with
    which one of the bounds may be wrong. distribution: what loops are made of. criteria: what a loop must keep. rates:
    share of loops that do, by driver (network, supervised) and criterion. bounds: see :func:`bounds`. check: share of
    the answers of the online check, by its reason. exact: share of its loops' periods in which the exact MPC found no
    solution to tolerance. worst: the loops with the largest errors, each with the number that runs it again. made:
    seconds and versions.
    """

    policy: str
    model: str
    loops: int
    seed: int
    delta: float
    distribution: Mapping[str, Any]
    criteria: Mapping[str, Any]
    rates: FailureRates
    bounds: Mapping[str, FailureRates]
    check: Mapping[str, float]
    exact: Mapping[str, float]
    worst: Sequence[Mapping[str, Any]]
    made: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Raises UserError for what no certificate says: nodes and reports rely on it."""
        if type(self.loops) is not int or not 0 < self.loops < 1 << 53:
            raise UserError(f"loops is {self.loops!r}: it needs a whole number above 0")
        if type(self.delta) is not float or not 0.0 < self.delta < 1.0:
            raise UserError(f"delta is {self.delta!r}: it needs a number between 0 and 1")
        for name in ("distribution", "criteria", "rates", "bounds", "check", "exact", "made"):
            if not isinstance(getattr(self, name), Mapping):
                raise UserError(f"{name} is {getattr(self, name)!r}: it needs keys")
        for name in ("hoeffding", "binomial"):
            if _criteria(self.bounds.get(name, {})) != _criteria(self.rates):
                raise UserError(f"bounds.{name} has other drivers or criteria than rates")
        if any("all" not in names for names in _criteria(self.rates).values()):
            raise UserError("rates lack criterion all")

    def __repr__(self) -> str:
        return f"Certificate({self.loops} loops, delta {self.delta:g})"

    def __str__(self) -> str:
        """A table of the share of the loops that kept each criterion, and the bound that holds for it."""
        rows = [
            (driver, name, f"{rate:.4f}", f"{self.bounds['binomial'][driver][name]:.4f}")
            for driver, parts in self.rates.items()
            for name, rate in parts.items()
        ]
        title = f"certificate of {self.loops} closed loops, at a confidence of {1.0 - self.delta:.4g}"
        return text_table(title, ("driver", "kept", "share", "at least"), rows, most=8, rest="certificate.rates")

    @property
    def margin(self) -> float:
        return margin(self.loops, self.delta)

    def mu(self, driver: str) -> float:
        """Rate of the loops that keep everything: it is at least this, but with probability delta (binomial)."""
        return float(self.bounds["binomial"][driver]["all"])

    def save(self, folder: Path | str) -> None:
        """Write it into the folder of its policy. Raises UserError where that is another policy by now."""
        folder = path_of(folder, "folder")
        if storage.digest(folder, kind="policy") != self.policy:
            raise UserError(f"{folder}: is another policy than the one that was certified; certify it again")
        content = {**asdict(self), "margin": self.margin}
        storage.save_sheet(folder / FILE, version=FORMAT, content=content)


def _criteria(rates: Any) -> dict[str, set[str]]:
    """Drivers and the criteria of each. Raises UserError where a rate is none."""
    parts = rates.items() if isinstance(rates, Mapping) else ()
    for driver, found in parts:
        numbers: list[Any] = list(found.values()) if isinstance(found, Mapping) else [None]
        if any(type(rate) not in (int, float) or not 0.0 <= rate <= 1.0 for rate in numbers):
            raise UserError(f"rates of {driver} need numbers between 0 and 1")
    return {driver: set(found) for driver, found in parts}


def find_certificate(folder: Path | str, *, policy: str, model: str) -> Certificate | None:
    """The certificate in a policy's folder, None where there is none.

    policy, model: seals of the policy and of the model that it is used with. Raises UserError where the certificate was
    altered or belongs to another policy or model.
    """
    path = Path(folder) / FILE
    if not path.is_file():
        return None
    again = "certify it again (hybrid-sysid policy certify) or remove the certificate"
    content = storage.load_sheet(path, kind="certificate", version=FORMAT)
    try:
        found = Certificate(**{item.name: content[item.name] for item in fields(Certificate)})
    except UserError as error:
        raise UserError(f"{path}: {error}; {again}") from error
    except (KeyError, TypeError) as error:
        raise UserError(f"{path}: {error!r} is missing or malformed; {again}") from error
    if found.policy != policy:
        raise UserError(f"{path}: belongs to another policy; {again}")
    if found.model != model:
        raise UserError(f"{path}: belongs to another model; {again}")
    return found

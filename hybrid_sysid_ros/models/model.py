"""An identified model: an equation, how sure its numbers are, and where they come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.models.structures import assemble
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

FORMAT = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """rig, structure: names. equation: with the identified values.

    sampling: what it was identified at. covariance (free, free): of the free parameters
    ``names``. training_range: lowest and highest value of each state and input in the training data. records: name,
    source, digest and part of each training record. scores: free run on them. fit: relative error, seconds, evaluations
    and seed.
    """

    rig: str
    structure: str
    system: System
    sampling: Sampling
    names: tuple[str, ...]
    covariance: Array
    training_range: Mapping[str, tuple[float, float]]
    records: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    scores: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    fit: Mapping[str, Any] = field(default_factory=dict)
    seal: str = ""

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error of each free physical parameter, in its unit."""
        deviations = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        physical = {item.name for item in self.system.parameters}
        return {name: float(d) for name, d in zip(self.names, deviations, strict=True) if name in physical}

    @property
    def free_numbers(self) -> int:
        """What a fit could choose: free parameters and the weights of what is learned."""
        return len({*self.names} | {f"weight_{index}" for index in range(len(self.system.weights))})

    def save(self, folder: Path | str) -> None:
        """Write the model folder; see :mod:`~hybrid_sysid_ros.models.storage`."""
        errors = self.standard_errors
        parameters = {
            item.name: {
                "value": float(value),
                "standard_error": errors.get(item.name),
                "unit": item.unit,
                "bounds": [item.low, item.high],
                "description": item.description,
            }
            for item, value in zip(self.system.parameters, self.system.values, strict=True)
        }
        content = {
            "rig": self.rig,
            "structure": self.structure,
            "design": self.system.design,
            "parameters": parameters,
            "sampling": asdict(self.sampling),
            "training_range": {name: list(ends) for name, ends in self.training_range.items()},
            "records": list(self.records),
            "scores": self.scores,
            "fit": self.fit,
            "free": list(self.names),
            "versions": versions(),
        }
        arrays = {"weights": self.system.weights, "covariance": self.covariance}
        storage.save(folder, kind="model", version=FORMAT, content=content, arrays=arrays)


def load(folder: Path | str) -> Model:
    """Read a model folder.

    Raises UserError where a file is missing, altered or newer, or the model does not fit its rig or its bounds.
    """
    content, arrays = storage.load(folder, kind="model", version=FORMAT)
    try:
        rig = rigs.load(content["rig"])
        stored = content["parameters"]
        system = assemble(
            content["structure"],
            rig.system,
            design=content["design"],
            weights=arrays["weights"],
        )
        expected = [item.name for item in system.parameters]
        if expected != list(stored):
            raise UserError(
                f"structure {content['structure']} of rig {rig.name} has the parameters {', '.join(expected)}, "
                f"the model {', '.join(stored)}; fit again"
            )
        system = system.with_values(np.array([float(entry["value"]) for entry in stored.values()]))
        system.check()
        names, covariance = tuple(content["free"]), arrays["covariance"]
        if covariance.shape != (len(names), len(names)):
            raise UserError(f"covariance has shape {covariance.shape} for {len(names)} free parameters; fit again")
        return Model(
            rig=rig.name,
            structure=content["structure"],
            system=system,
            sampling=Sampling(**content["sampling"]),
            names=names,
            covariance=covariance,
            training_range={name: (float(a), float(b)) for name, (a, b) in content["training_range"].items()},
            records=tuple(content["records"]),
            scores=content["scores"],
            fit=content["fit"],
            seal=content["seal"],
        )
    except UserError as error:
        raise UserError(f"{Path(folder) / 'model.yaml'}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{Path(folder) / 'model.yaml'}: {error!r} is missing or malformed; fit again") from error


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {}
    for name in ("hybrid_sysid_ros", "numpy", "scipy", "numba", "casadi"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found

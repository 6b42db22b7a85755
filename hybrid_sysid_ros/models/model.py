"""An identified model: a system, the uncertainty of its numbers, and their provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.models.structure import Structure, assemble, structure_of
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import path_of
from hybrid_sysid_ros.support.text_table import text_table

FORMAT = 2
Own = TypeVar("Own", bound="Model")
NOTES = "notes.yaml"
"""File beside the model's own of what was noted of its training records after it was sealed."""
FAILED = (
    "the fit failed, for the mean of a record would be nearer; begin nearer (values in system.py), at more points "
    "(the option starts), or with a smaller step"
)
TRIALS = 0.2, 0.45, 0.8
"""Points in the training range at which a step of a saved model is compared, to notice that the law has changed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """An identified system with everything that is needed to use it."""

    rig: str
    """Name of the rig, by which it is found again; ``place`` is the folder of one that was given by its path."""
    structure: str
    system: System
    """The system with the identified values."""
    sampling: Sampling
    """The sampling of the identification."""
    names: tuple[str, ...]
    """Names of the free parameters."""
    covariance: Array
    """Covariance of the free parameters, (free, free), in their units."""
    training_range: Mapping[str, tuple[float, float]]
    """Lowest and highest value of each state and input in the training data."""
    records: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    """Name, source, digest and part of each training record."""
    scores: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Scores of the free run by training record."""
    fit: Mapping[str, Any] = field(default_factory=dict)
    """Relative error, seconds, evaluations and seed of the fit."""
    place: str = ""
    """Folder of a rig outside the package."""
    seal: str = ""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """What was noted of its training records later."""

    def note(self, name: str) -> Any:
        """What is known of the training records by a name, as "bands"; None where nothing is."""
        return self.notes.get(name, self.fit.get(name))

    def __repr__(self) -> str:
        """One line without arrays."""
        return f"{type(self).__name__}({self.structure} of {self.rig}, {len(self.names)} free parameters)"

    def __str__(self) -> str:
        """A table of the physical parameters and of the scores on training records."""
        errors = self.standard_errors
        rows = [
            (item.name, f"{value:.4g}", error_text(errors.get(item.name)), item.unit)
            for item, value in zip(self.system.parameters, self.system.values, strict=True)
            if not item.learned
        ]
        title, met = f"{self.structure} of {self.rig}", [scores["r2"] for scores in self.scores.values()]
        if met:
            title += f", R2 {min(met):.4f} to {max(met):.4f} over {len(met)} training records"
            title += f": {FAILED}" if self.failed else ""
        return text_table(
            title, ("parameter", "value", "standard error", "unit"), rows, most=7, rest="model.parameters"
        )

    @property
    def failed(self) -> bool:
        """Whether the mean of a training record is nearer to it than the model's run."""
        return any(not scores["r2"] > 0.0 for scores in self.scores.values())

    def started(
        self: Own, *, initial: str | None = None, initial_samples: int | None = None, warm_up: int | None = None
    ) -> Own:
        """The model with other starts of its runs than in its fit, see :class:`~.sampling.Sampling`; None keeps one.

        Raises UserError for values that can't be.
        """
        given = {"initial": initial, "initial_samples": initial_samples, "warm_up": warm_up}
        changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        return replace(self, sampling=replace(self.sampling, **changes)) if changes else self

    @property
    def kind(self) -> Structure:
        """The model's structure on its rig."""
        rig = rigs.load(self.rig)
        return structure_of(self.structure, rig.system, rig.structures)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error of each free parameter that has a meaning by itself, in its unit; infinite where neither data
        nor a prior determine it, whose row of the covariance is zero.
        """
        variances = np.clip(np.diag(self.covariance), 0.0, None)
        deviations = np.sqrt(np.where(variances > 0.0, variances, np.inf))
        physical = {item.name for item in self.system.parameters if not item.learned}
        return {name: float(d) for name, d in zip(self.names, deviations, strict=True) if name in physical}

    @property
    def inputs_sentence(self) -> str:
        """How the model takes its inputs, and by what training errors this was chosen, if by any."""
        words = {
            "interpolated": "lines join their samples (first-order hold)",
            "sampled": "each is read once a period and holds",
        }
        found = words.get(self.sampling.input, "each sample holds until the next")
        tried = self.fit.get("inputs_tried", {})
        errors = ", ".join(f"{name} {100.0 * float(error):.3g} %" for name, error in tried.items())
        return f"{found}; training errors: {errors} of the output's deviation" if errors else found

    @property
    def free_numbers(self) -> int:
        """Number of free parameters and weights of the learned part."""
        return len({*self.names} | {f"weight_{index}" for index in range(len(self.system.weights))})

    def was_trained_on(self, digest: str, start: float, stop: float) -> bool | None:
        """Whether a part of a record, between fractions of it, overlaps with the training data; None where digests are
        missing.
        """
        if not digest or not self.records or not all(entry.get("sha256") for entry in self.records):
            return None
        parts = [entry.get("part", (0.0, 1.0)) for entry in self.records if entry["sha256"] == digest]
        return any(first < stop and start < last for first, last in parts)

    def save(self, folder: Path | str) -> None:
        """Write the model folder; see :mod:`~hybrid_sysid_ros.models.storage`."""
        errors = self.standard_errors
        parameters = {
            item.name: {
                "value": float(value),
                "standard_error": finite(errors.get(item.name)),
                "unit": item.unit,
                "bounds": [item.low, item.high],
                "description": item.description,
            }
            for item, value in zip(self.system.parameters, self.system.values, strict=True)
        }
        content = {
            "rig": self.rig,
            **({"place": self.place} if self.place else {}),
            "signals": signals_of(self.system),
            "structure": self.structure,
            "design": self.system.design,
            "parameters": parameters,
            "sampling": asdict(self.sampling),
            "training_range": {name: list(ends) for name, ends in self.training_range.items()},
            "records": list(self.records),
            "scores": self.scores,
            "fit": self.fit,
            "free": list(self.names),
            "trial": _trial(self.system, self.training_range, self.sampling.step),
            "versions": versions(),
        }
        arrays = {"weights": self.system.weights, "covariance": self.covariance}
        storage.save(folder, kind="model", version=FORMAT, content=content, arrays=arrays)
        if self.notes:
            save_notes(folder, self.notes)


def load(folder: Path | str, *, rig: str | Path = "", noted: bool = True) -> Model:
    """Read a model folder. noted: with the notes beside it.

    rig: name or path of its rig, which is needed where the rig is not known by name: a path in the model folder is
    never followed, since loading a rig runs its Python. Raises UserError where a file is missing, altered or newer, and
    where the model belongs to another rig or does not fit its rig or its bounds.
    """
    content, arrays = storage.load(folder, kind="model", version=FORMAT)
    try:
        described = _rig_of(content, rig)
        stored, names = content["parameters"], tuple(map(str, content["free"]))
        weights = storage.numbers(arrays, "weights", None)
        covariance = storage.numbers(arrays, "covariance", len(names), len(names))
        system = assemble(
            content["structure"],
            described.system,
            design=content["design"],
            weights=weights,
            boxes=described.structures,
        )
        if (signals := content.get("signals", signals_of(system))) != signals_of(system):
            raise UserError(f"rig {described.name} {_changed(signals, signals_of(system))}; fit again")
        expected = [item.name for item in system.parameters]
        values = {name: float(entry["value"]) for name, entry in stored.items()}
        if set(values) != set(expected):
            raise UserError(
                f"structure {content['structure']} of rig {described.name} has the parameters {', '.join(expected)}, "
                f"the model {', '.join(stored)}; fit again"
            )
        system = system.with_values([values[name] for name in expected])
        system.check()
        if len(system.weights) != len(weights):
            raise UserError(
                f"array weights has {len(weights)} numbers, structure {content['structure']} {len(system.weights)}; "
                "fit again"
            )
        ranges = {name: (float(a), float(b)) for name, (a, b) in content["training_range"].items()}
        sampling = Sampling(**content["sampling"])
        moved = _trial(system, ranges, sampling.step)
        if not np.allclose(moved, content.get("trial", moved), rtol=1e-6, atol=1e-9, equal_nan=True):
            raise UserError(f"rig {described.name} has another law than when the model was fitted; fit again")
        return Model(
            rig=described.name,
            structure=content["structure"],
            system=system,
            sampling=sampling,
            names=names,
            covariance=covariance,
            training_range=ranges,
            records=tuple(content["records"]),
            scores=content["scores"],
            fit=content["fit"],
            place=content.get("place", ""),
            seal=content["seal"],
            notes=_notes(Path(folder) / NOTES, content["seal"]) if noted else {},
        )
    except UserError as error:
        raise UserError(f"{Path(folder) / 'model.yaml'}: {error}") from error
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise UserError(f"{Path(folder) / 'model.yaml'}: {error!r} is missing or malformed; fit again") from error


def save_notes(folder: Path | str, notes: Mapping[str, Any]) -> None:
    """Write notes beside a saved model; older ones are replaced. Raises UserError where they can't be written."""
    place = path_of(folder, "folder")
    content = {"model": storage.digest(place, kind="model"), "notes": dict(notes)}
    storage.save_sheet(place / NOTES, version=FORMAT, content=content)


def _notes(path: Path, seal: str) -> Mapping[str, Any]:
    """The notes beside a model, if there are any. Raises UserError for those of another model."""
    if not path.is_file():
        return {}
    content = storage.load_sheet(path, kind="notes", version=FORMAT)
    if content.get("model") != seal or not isinstance(content.get("notes"), dict):
        raise UserError(f"{path} is of another model: remove it, or make it again (hybrid-sysid trained-range)")
    found: dict[str, Any] = content["notes"]
    return found


def finite(error: float | None) -> float | None:
    """A standard error as plain data: None where there is none, or an infinite one."""
    return error if error is not None and np.isfinite(error) else None


def error_text(error: float | None) -> str:
    """A standard error in a table: "set" for a parameter that was not fitted, "unknown" for an infinite one."""
    return "set" if error is None else f"{error:.2g}" if np.isfinite(error) else "unknown"


def signals_of(system: System) -> dict[str, list[str]]:
    """Names and units of a system's inputs and outputs, as they are saved."""
    return {"inputs": [str(item) for item in system.inputs], "outputs": [str(item) for item in system.outputs]}


def _trial(system: System, ranges: Mapping[str, tuple[float, float]], step: float) -> list[float]:
    """States after a step from each of the TRIALS; a variable without training range begins at zero."""
    ends = np.array([ranges.get(item.name, (0.0, 0.0)) for item in (*system.states, *system.inputs)])
    low, high = ends.T
    advance, n = symbolic_step(system, step=step), len(system.states)
    points = [low + place * (high - low) for place in TRIALS]
    return [float(value) for point in points for value in np.array(advance(point[:n], point[n:])).ravel()]


def _changed(before: Mapping[str, Sequence[str]], now: Mapping[str, Sequence[str]]) -> str:
    kind = next(kind for kind in now if list(before.get(kind, ())) != list(now[kind]))
    return f"has the {kind} {', '.join(now[kind])}, the model {', '.join(before.get(kind, ()))}"


def _rig_of(content: Mapping[str, Any], given: str | Path) -> rigs.Rig:
    """The rig that the user named, or else the one that is known by the name in the model."""
    name, place = rigs.name_in(content), str(content.get("place") or "")
    try:
        rig = rigs.load(given or name)
    except UserError as error:
        if given or not place:
            raise
        raise UserError(
            f"its rig {name} is not known by name; its folder was {place}: give that folder as its rig (--rig)"
        ) from error
    if rig.name != name:
        raise UserError(f"is a model of rig {name}, not of {rig.name}")
    return rig


def versions() -> dict[str, str]:
    """Versions of the packages on which a result depends."""
    found = {}
    for name in ("hybrid_sysid_ros", "numpy", "scipy", "numba", "casadi"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found

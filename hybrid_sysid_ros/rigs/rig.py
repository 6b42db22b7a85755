"""A rig: its system, sensors, actuators and experiments, from one folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.rigs import folder as folders
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.drivers import Experiments, experiments_of, index_of
from hybrid_sysid_ros.rigs.excitation import Excitation, ReferenceSchedule, Segment
from hybrid_sysid_ros.rigs.joints import Joints
from hybrid_sysid_ros.rigs.sensor import Display, Sensor
from hybrid_sysid_ros.rigs.units import factor_of
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError, UserErrors, collected
from hybrid_sysid_ros.support.structured import built, numbers, read_mapping, refuse_endless, refuse_unknown, section

OF_EXTENSIONS = (
    "demo", "drawing", "faults", "scene", "mockup", "modes", "names", "policy_training", "policy_certificate",
)  # fmt: skip
"""Sections of this package's extensions, which a rig may have where the extensions are missing."""
BEYOND = 1e9
"""Limit of all states, inputs and outputs in any unit."""
MARGIN = 0.02
"""Share of the travel at each end that no reference reaches."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """A rig with all its data; see docs/guides/rig-file.md for its two files."""

    name: str
    folder: Path
    system: System
    """The best known physics of the rig, with numbers identified from its records."""
    structures: Mapping[str, System]
    """Further gray boxes of the rig, by name."""
    step: float
    """Step of the simulated plant [s]."""
    sensors: tuple[Sensor, ...]
    """The sensor of each output."""
    actuators: tuple[Actuator, ...]
    """The actuator of each input."""
    travel: NDArray[np.float64]
    """Lowest and highest value of each state (2, states): the stops of the simulated rig; infinite without one."""
    joints: Joints
    namespace: str
    """Namespace of its topics, without slashes at its ends."""
    signals: Signals
    experiments: Experiments
    references: Mapping[str, ReferenceSchedule]
    """References by name; the first is the default."""
    content: Mapping[str, Any]
    """All of rig.yaml."""
    disturbances: Mapping[int, Excitation] = field(default_factory=dict)
    """By state, a signal that moves it in simulations, which no model knows."""
    validity: NDArray[np.float64] | None = None
    """Lowest and highest value of each state for which the equations are valid, (2, states)."""
    offsets: Mapping[str, float] = field(default_factory=dict)
    """States with an unknown offset of their rates, and its drift [unit of the state/s/sqrt(s)]."""

    def __reduce__(self) -> Any:
        """Pickle a rig by its source, so that another process loads its Python too."""
        return (load, (self.source,)) if _LOADED.get(self.folder) is self else object.__reduce_ex__(self, 2)

    def __repr__(self) -> str:
        inputs, outputs = (", ".join(map(str, items)) for items in (self.system.inputs, self.system.outputs))
        return f"Rig({self.name}: {inputs} -> {outputs})"

    @property
    def source(self) -> str:
        """The name of the rig or the path of its folder, by which another process loads it."""
        return self.name if self.name in folders.names() else str(self.folder)

    @property
    def file(self) -> Path:
        """Path of its rig.yaml."""
        return self.folder / folders.VALUES

    @property
    def display(self) -> tuple[Display, ...]:
        """The unit in which each output is shown, and SI per unit."""
        return tuple(sensor.display for sensor in self.sensors)

    @property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest value of each input, (inputs,) each."""
        return np.array([item.low for item in self.actuators]), np.array([item.high for item in self.actuators])

    def steps(self, period: float, what: str) -> int:
        """Number of steps in a period [s]. Raises UserError, naming it by ``what``, where it is not whole."""
        count = round(period / self.step)
        if count < 1 or abs(count * self.step / period - 1.0) > 1e-9:
            raise UserError(
                f"{what}, {period:g} s, is no multiple of the step of {self.name}, {self.step:g} s; change one of them"
            )
        return count

    @property
    def travel_of_outputs(self) -> NDArray[np.float64]:
        """Travel of each output that is a state, (2, outputs); infinite for others."""
        return self._of_outputs(self.travel)

    def _of_outputs(self, limits: NDArray[np.float64]) -> NDArray[np.float64]:
        names = [item.name for item in self.system.states]
        found = np.tile([[-np.inf], [np.inf]], len(self.system.outputs))
        for index, item in enumerate(self.system.outputs):
            if item.name in names:
                found[:, index] = limits[:, names.index(item.name)]
        return found

    @property
    def reach(self) -> NDArray[np.float64]:
        """Lowest and highest reference of each output, (2, outputs), within its travel and validity."""
        low, high = self.travel_of_outputs
        if self.validity is not None:
            valid = self._of_outputs(self.validity)
            low, high = np.maximum(low, valid[0]), np.minimum(high, valid[1])
        margin = np.where(np.isfinite(high - low), MARGIN * (high - low), 0.0)
        return np.array([low + margin, high - margin])

    @property
    def bias(self) -> tuple[float, ...]:
        """Constant that is added to each input of the simulated rig, (inputs,), which no model knows."""
        plant = section(section(self.content, "nodes", str(self.file)), "plant", f"{self.file}: nodes")
        return numbers(plant.get("bias", 0.0), f"{self.file}: nodes.plant.bias", count=len(self.actuators))

    @property
    def reference(self) -> str:
        """Name of the default reference: the rig's first, or "steps" where it has none."""
        return next(iter(self.references), "steps")

    def schedule(self, name: str = "") -> ReferenceSchedule:
        """One of the rig's references by its name, the first by default. Raises UserError where there is none."""
        if (name or self.reference) not in self.references:
            raise UserError(f"{self.file}: no reference {name}: it has {', '.join(self.references) or 'none'}")
        return self.references[name or self.reference]

    def section(self, name: str) -> dict[str, Any]:
        """A section of rig.yaml. Raises UserError where it is missing."""
        return section(self.content, name, str(self.file), needed=True)

    def channel(self, kind: str, name: str) -> str:
        """Name of a record's channel "reference" or "filtered" of an output, or "command" of an input."""
        alone = len(self.sensors if kind != "command" else self.actuators) == 1
        return kind if alone else f"{kind}_{name}"


_LOADED: dict[Path, Rig] = {}
_TEXTS: dict[Path, tuple[bytes, bytes]] = {}
"""Of their files, when they were read."""


def load(rig: str | Path) -> Rig:
    """A rig by its name, or by the path of its folder; it is loaded once. "": the default rig.

    After a process has loaded a rig by its path, it and the processes that it starts know the rig by its name.

    Raises UserError for an unknown rig, and for errors in its files.
    """
    found = folders.find(rig or default())
    if found.path not in _LOADED:
        _TEXTS[found.path], _LOADED[found.path] = found.texts, _read(found)
    return _LOADED[found.path]


def reload(rig: str | Path) -> Rig:
    """As :func:`load`, but a rig whose files were edited since it was loaded is read again, for notebooks."""
    found = folders.find(rig or default())
    if _TEXTS.get(found.path) != found.texts:
        _LOADED.pop(found.path, None)
    return load(rig)


def name_in(content: Mapping[str, Any]) -> str:
    """The rig's name in a model's or a policy's file, which could be a path: whose Python nobody asked to run.

    Raises UserError for a path.
    """
    name = content["rig"]
    if not isinstance(name, str) or not name.isidentifier() or len(name) > folders.LONGEST_NAME:
        raise UserError(f"its rig is {name!r}: that is no rig's name")
    return name


def default() -> str:
    """Name of the default rig: the one whose file declares it, or the only one."""
    known = list(folders.names())
    chosen = [name for name in known if read_mapping(folders.find(name).path / folders.VALUES).get("default")]
    return (chosen or known)[0]


def _read(found: folders.RigFolder) -> Rig:
    path = found.path / folders.VALUES
    where, content = str(path), read_mapping(path)
    refuse_endless(content, f"{where}:")
    system, structures = folders.systems_of(found)
    made, problems = dict[str, Any](), list[str]()
    with collected(problems):
        refuse_unknown(content, tuple(dict.fromkeys((*extensions.targets("sections"), *OF_EXTENSIONS))), where)
    for other in structures.values():
        with collected(problems):
            _check_alike(system, other, str(found.path / folders.SYSTEM))
    with collected(problems):
        made["step"] = _above_zero(content, "step", where)
    with collected(problems):
        made["namespace"] = _namespace(content, found.name, where)
    for key, part in PARTS.items():
        with collected(problems):
            made[key] = part(section(content, key, where), system, f"{where}: {key}")
    if problems:
        raise UserErrors(problems)
    given, derived = section(content, "signals", where), made["joints"].signals(system, made["sensors"])
    signals = Signals.of(given, made["namespace"], where, given=derived).ordered(system.inputs, system.outputs)
    made |= {"name": found.name, "folder": found.path}
    return Rig(system=system, structures=structures, signals=signals, content=content, **made)


def _namespace(content: Mapping[str, Any], name: str, where: str) -> str:
    """Of the topics, by default the rig's name."""
    found = str(content.get("namespace") or name).strip("/")
    if not all(part.isidentifier() and part.isascii() for part in found.split("/")):
        raise UserError(f"{where}: namespace is {found!r}: topics take letters, digits and underscores, not first")
    return found


def _check_alike(system: System, other: System, where: str) -> None:
    """Raise UserError for a further gray box with other inputs or outputs than the rig."""
    for kind in ("inputs", "outputs"):
        mine, its = ([str(item) for item in getattr(each, kind)] for each in (system, other))
        if mine != its:
            name = type(other).__name__
            raise UserError(f"{where}: {name} has the {kind} {', '.join(its)}, the rig's are {', '.join(mine)}")


def _check_names(given: Mapping[str, Any], kind: str, variables: tuple[Variable, ...], where: str) -> None:
    """Raise UserErrors for the parts of a section that are of no variable."""
    names = [item.name for item in variables]
    if unknown := [name for name in given if name not in names]:
        known = ", ".join(names)
        raise UserErrors(f"{where}.{name}: the system has no such {kind}; known are {known}" for name in unknown)


def _sensors(given: Mapping[str, Any], system: System, where: str) -> tuple[Sensor, ...]:
    """A sensor for each output, a plain one where none is declared."""
    _check_names(given, "sensor", system.outputs, where)
    found = []
    for item in system.outputs:
        value, here = given.get(item.name), f"{where}.{item.name}"
        sensor = built(Sensor, {"unit": item.unit, **(value or {})} if isinstance(value, dict | None) else value, here)
        factor = factor_of(sensor.unit, item.unit)
        unknown = factor is None and (sensor.scale != 1.0 or not item.unit)
        if not (unknown or (factor and math.isclose(abs(sensor.scale), factor, rel_tol=0.01))):
            raise UserError(
                f"{here}: readings are in {sensor.unit}, the output is in {item.unit}, and scale is {sensor.scale:g}: "
                f"give scale, in {item.unit} per {sensor.unit}{f', which is {factor:g}' if factor else ''}"
            )
        found.append(sensor)
    return tuple(found)


def _actuators(given: Mapping[str, Any], system: System, where: str) -> tuple[Actuator, ...]:
    """An actuator for each input."""
    _check_names(given, "actuator", system.inputs, where)
    for item in system.inputs:
        if item.name not in given:
            raise UserError(f"{where}.{item.name} is missing: it needs low and high [{item.unit}]")
    return tuple(built(Actuator, given[item.name], f"{where}.{item.name}") for item in system.inputs)


def _ranges(given: Mapping[str, Any], system: System, where: str) -> NDArray[np.float64]:
    """Lowest and highest value of each state."""
    found = np.tile([[-np.inf], [np.inf]], len(system.states))
    for name, value in given.items():
        index = index_of(name, system.declared_states, where, "state")
        low, high = numbers(value, f"{where}.{name}", count=2)
        if not low < high:
            raise UserError(f"{where}.{name} goes from {low:g} to {high:g}: the lowest value must come first")
        found[:, index] = low, high
    return found


def _disturbances(given: Mapping[str, Any], system: System, where: str) -> dict[int, Excitation]:
    """The signals of states with disturbances."""
    found = {}
    for name, value in given.items():
        signal = Excitation.of(value, f"{where}.{name}")
        if not signal.endless:
            raise UserError(f"{where}.{name}: a {signal.kind} comes to an end: take another kind, or give it a period")
        found[index_of(name, system.declared_states, where, "state")] = signal
    return found


def _offsets(given: Mapping[str, Any], system: System, where: str) -> dict[str, float]:
    """Drifts of the offsets of states' rates."""
    found = {}
    for name in given:
        index_of(name, system.declared_states, where, "state")
        found[name] = _above_zero(given, name, where)
    return found


def _above_zero(content: Mapping[str, Any], key: str, where: str) -> float:
    (value,) = numbers(content.get(key), f"{where}: {key}", count=1)
    if not value > 0:
        raise UserError(f"{where}: {key} is {value:g}: it needs more than 0")
    return value


def _references(content: Mapping[str, Any], system: System, where: str) -> dict[str, ReferenceSchedule]:
    found = {}
    for name in content:
        here, given = f"{where}: {name}", section(content, name, where)
        refuse_unknown(given, ("duration", "segments"), here)
        segments = []
        for label, value in section(given, "segments", here, needed=True).items():
            at = f"{here}.segments.{label}"
            numbers_of = dict(value) if isinstance(value, dict) else {}
            output = index_of(numbers_of.pop("output", system.outputs[0].name), system.outputs, at, "output")
            start = numbers(numbers_of.pop("start", 0.0), f"{at}.start", count=1)[0]
            stop = numbers(numbers_of.pop("stop", None), f"{at}.stop", count=1)[0]
            if not 0 <= start < stop:
                raise UserError(f"{at}: goes from {start:g} to {stop:g} s: its start must lie before its stop")
            excitation = Excitation.of(numbers_of, at)
            segments.append(Segment(name=label, output=output, start=start, stop=stop, excitation=excitation))
        found[name] = ReferenceSchedule(
            name=name,
            duration=_above_zero(given, "duration", here),
            outputs=len(system.outputs),
            segments=tuple(segments),
        )
    return found


PARTS: Mapping[str, Callable[[Mapping[str, Any], System, str], Any]] = {
    "sensors": _sensors, "actuators": _actuators, "travel": _ranges,
    "validity": lambda given, system, where: _ranges(given, system, where) if given else None,
    "joints": Joints.of, "disturbances": _disturbances, "offsets": _offsets, "experiments": experiments_of,
    "references": _references,
}  # fmt: skip
"""What makes each section of rig.yaml of the system that it is about."""

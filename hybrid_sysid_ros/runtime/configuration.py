"""Configuration: the parameters of a rig's nodes and how its topics are carried, from msgs_config/NAME.yaml.

The nodes declare these parameters in ROS; the library (demo, training, benchmarks) takes the same numbers from here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.bags.signals import configuration_of, load_configuration
from hybrid_sysid_ros.control import Problem
from hybrid_sysid_ros.control.policy.sampling import Spread
from hybrid_sysid_ros.estimation import Channel, Tuning
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

DEFAULT_RIG = "cam_beam"
CAMERA = "camera"
"""Channel of an estimator for a second sensor of the rig's position."""
TRAINED = Path(__file__).parents[1] / "trained"
RELIABILITIES = ("reliable", "best_effort")
DURABILITIES = ("volatile", "transient_local")
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of a node: its default, in its range or among its choices, and whether it may change while it runs.

    Raises UserError when the default is not allowed.
    """

    name: str
    default: Any
    description: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    live: bool = False

    def __post_init__(self) -> None:
        if type(self.default) not in _KINDS:
            raise UserError(f"parameter {self.name}: the default {self.default!r} is of no known kind")
        self.checked(self.default)

    @property
    def kind(self) -> type:
        """bool, int, float or str."""
        return type(self.default)

    def holds(self, value: Any) -> bool:
        """Whether a value is of the parameter's kind; a truth value is no number."""
        return type(value) is self.kind

    def checked(self, value: Any) -> Any:
        """Return the value as the parameter's kind (an integer does for a number).

        Raises:
            UserError: it is of another kind, out of range or none of the choices.
        """
        if self.kind is float and type(value) is int:
            value = float(value)
        if not self.holds(value):
            raise UserError(f"parameter {self.name} is {value!r}: it needs {_KINDS[self.kind]}")
        if self.kind in (int, float) and not (math.isfinite(value) and self.low <= value <= self.high):
            unit = f" {self.unit}" if self.unit else ""
            raise UserError(f"parameter {self.name} is {value}{unit}: it must be within [{self.low:g}, {self.high:g}]")
        if self.choices and value not in self.choices:
            raise UserError(f"parameter {self.name} is {value!r}: choose one of {', '.join(self.choices)}")
        return value


@dataclass(frozen=True, kw_only=True)
class Quality:
    """How a topic is carried: reliable or best_effort, volatile or transient_local, and how many messages wait."""

    reliability: str
    durability: str
    depth: int

    def __post_init__(self) -> None:
        if self.reliability not in RELIABILITIES or self.durability not in DURABILITIES:
            allowed = f"{' or '.join(RELIABILITIES)}, {' or '.join(DURABILITIES)}"
            raise UserError(f"{self.reliability}, {self.durability}: needs {allowed}")
        if type(self.depth) is not int or not 1 <= self.depth <= 100_000:
            raise UserError(f"depth is {self.depth!r}: it needs a whole number from 1 to 100000")


def parameters(rig: str, node: str) -> dict[str, Parameter]:
    """Parameters of a node of a rig, by name.

    Raises:
        UserError: the rig, the node or one of its parameters is not described as it should be.
    """
    path = configuration_of(rig)
    nodes = _section(load_configuration(path), "nodes", path)
    entries = _section(nodes, node, path, within="nodes.")
    return {name: _parameter(name, entry, f"{path}: nodes.{node}.{name}") for name, entry in entries.items()}


def defaults(rig: str, node: str) -> dict[str, Any]:
    """Default of each parameter of a node.

    Raises:
        UserError: see parameters().
    """
    return {name: parameter.default for name, parameter in parameters(rig, node).items()}


def namespace(rig: str) -> str:
    """Namespace of a rig's topics, without slashes at its ends.

    Raises:
        UserError: there is no such rig.
    """
    return str(load_configuration(configuration_of(rig)).get("namespace") or rig).strip("/")


def shipped(rig: str, kind: str) -> Path:
    """Folder of what comes trained with the package for a rig; kind: model or policy.

    Raises:
        UserError: nothing does.
    """
    folder = TRAINED / rig / kind
    if not folder.is_dir():
        raise UserError(f"no {kind} comes with the package for the rig {rig} ({folder}): give the path of one")
    return folder


def qualities(rig: str) -> dict[str, Quality]:
    """How each topic of a rig is carried, by its name as in the configuration.

    Raises:
        UserError: a class is not described as it should be, or names a topic that another has.
    """
    path = configuration_of(rig)
    found: dict[str, Quality] = {}
    for name, entry in _section(load_configuration(path), "qos", path).items():
        try:
            content = dict(entry)
            topics = list(content.pop("topics"))
            quality = Quality(**content)
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(f"{path}: qos.{name}: needs reliability, durability, depth and topics") from error
        except UserError as error:
            raise UserError(f"{path}: qos.{name}: {error}") from error
        for topic in topics:
            if topic in found:
                raise UserError(f"{path}: qos.{name}: topic {topic} is in another class already")
            found[topic] = quality
    return found


def estimator_tuning(values: Mapping[str, Any], rig: Rig) -> Tuning:
    """Tuning of the estimators from the parameters of the node `estimator`; the sensor's volts become radians.

    Raises:
        UserError: `followed` is no list of NAME=DRIFT.
    """
    scale = rig.sensor.radians_per_volt
    camera = scale * values["camera_noise_volts"]
    return Tuning(
        measurement_noise=(scale * values["measurement_noise_volts"],),
        process_noise=(scale * values["position_process_noise_volts"], values["velocity_process_noise"]),
        disturbance_noise=(values["disturbance_noise"],),
        disturbance_limit=(values["disturbance_limit"],),
        hum_hertz=(values["hum_hertz"],),
        hum_amplitude=(scale * values["hum_amplitude_volts"],),
        hum_noise=(scale * values["hum_noise_volts"],),
        gate=values["gate"],
        patience=values["patience"],
        input_noise=(values["input_noise"],),
        followed=_drifts(values["followed"]),
        channels={CAMERA: Channel(of=rig.system.outputs[0].name, noise=camera)} if camera else {},
        window=values["window"],
        horizon=values["horizon"],
    )


def _drifts(text: str) -> dict[str, float]:
    """NAME=DRIFT NAME=DRIFT... by name."""
    found = {}
    for item in text.split():
        name, _, drift = item.partition("=")
        try:
            found[name] = float(drift)
        except ValueError as error:
            raise UserError(f"parameter followed: {item!r} is no NAME=DRIFT, as in coulomb=0.1") from error
    return found


def mpc_problem(values: Mapping[str, Any], rig: Rig) -> Problem:
    """Problem of the exact MPC from the parameters of the node `controller`; its outputs are weighed in volts.

    Raises:
        UserError: a number makes no problem.
    """
    return Problem(
        horizon=values["horizon"],
        period=values["period"],
        substeps=values["substeps"],
        output_weight=values["output_weight"],
        rate_weight=values["rate_weight"],
        input_limit=rig.input_limit,
        output_scale=rig.sensor.radians_per_volt,
        smoothing=values["smoothing"],
        max_iterations=values["max_iterations"],
        input_weight=values["input_weight"],
        rate_limit=values["rate_limit"] or math.inf,
        state_bounds=_state_bounds(values, rig),
        soft_linear=values["soft_linear"],
        soft_quadratic=values["soft_quadratic"],
        literal=values["literal"],
    )


def _state_bounds(values: Mapping[str, Any], rig: Rig) -> tuple[tuple[float, float], ...]:
    """Soft bounds of the rig's states, none where no parameter sets one."""
    position = rig.sensor.radians_per_volt * values["position_limit_volts"] or math.inf
    velocity = values["velocity_limit"] or math.inf
    if math.isinf(position) and math.isinf(velocity):
        return ()
    limits = [math.inf] * len(rig.system.states)
    for output in rig.system.measured:
        limits[output] = position
        limits[rig.system.kinematics[output]] = velocity
    return tuple((-limit, limit) for limit in limits)


def sampling_spread(rig: Rig) -> Spread:
    """What the closed loops are made of that a policy of the rig learns from.

    Raises:
        UserError: section policy_training lacks a number.
    """
    path = configuration_of(rig.name)
    section = _section(load_configuration(path), "policy_training", path)
    try:
        content = {**section, "kick": tuple(rig.sensor.radians_per_volt * value for value in section["kick"])}
        return Spread(**content)
    except (KeyError, TypeError) as error:
        needs = "amplitude, disturbance, input_jitter and kick; it may have parameters"
        raise UserError(f"{path}: policy_training: needs {needs}") from error


def _section(content: Mapping[str, Any], key: str, path: Path, *, within: str = "") -> dict[str, Any]:
    section = content.get(key)
    if not isinstance(section, dict):
        known = f": known are {', '.join(content)}" if within else ""
        raise UserError(f"{path}: no section {within}{key}{known}")
    return section


def _parameter(name: str, entry: Any, where: str) -> Parameter:
    if not isinstance(entry, dict):
        raise UserError(f"{where}: needs default and description, not {entry!r}")
    content = dict(entry)
    try:
        if "range" in content:
            content["low"], content["high"] = content.pop("range")
        content["choices"] = tuple(content.get("choices", ()))
        return Parameter(name=name, **content)
    except (TypeError, ValueError) as error:
        known = "default, description, unit, range, choices and live"
        raise UserError(f"{where}: has wrong keys: known are {known}") from error
    except UserError as error:
        raise UserError(f"{where}: {error}") from error

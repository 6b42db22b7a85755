"""Requests: all that a page may ask for, declared once, and checked field by field against what a rig offers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import NodeParameter, parameters
from hybrid_sysid_ros.runtime.set_points import SetPointRange, set_point_ranges
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, refuse_endless, section

LARGEST = 1 << 16
"""Bytes of a request: a drawn curve has some 200 points."""
POINTS = 500
"""Of a drawn curve, at most."""
CURVE = 5.0
"""Seconds ahead of now that a curve may be drawn."""
LOST = {"sensor out": {"sensor_out": 1.0}}
"""Faults of a rig whose file has none."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a page asks for."""

    do: ClassVar[str]
    id: int = 0
    """By which the page knows the answer."""


@dataclass(frozen=True, kw_only=True)
class Next(Request):
    """The next picture: the page has drawn the one before."""

    do: ClassVar[str] = "next"


@dataclass(frozen=True, kw_only=True)
class SetPointRequest(Request):
    """What the tracked outputs are to be from now on: straight between the points, then as the last one says."""

    do: ClassVar[str] = "set_point"
    times: tuple[float, ...]
    """Of the points, from now on [s], growing."""
    values: tuple[tuple[float, ...], ...]
    """Of each point: the tracked outputs, as they are shown."""


@dataclass(frozen=True, kw_only=True)
class ReferenceRequest(Request):
    """A reference by its name or kind, from its beginning."""

    do: ClassVar[str] = "experiment"
    kind: str


@dataclass(frozen=True, kw_only=True)
class Fault(Request):
    """A fault of the simulated rig."""

    do: ClassVar[str] = "fault"
    name: str
    on: bool


@dataclass(frozen=True, kw_only=True)
class PolicyChoice(Request):
    """The policy that the controller uses."""

    do: ClassVar[str] = "policy"
    policy: str


@dataclass(frozen=True, kw_only=True)
class ServiceCall(Request):
    """A service of the controller."""

    do: ClassVar[str] = "call"
    service: str


@dataclass(frozen=True, kw_only=True)
class WeightChange(Request):
    """Weights of the exact MPC, all of one kind."""

    do: ClassVar[str] = "weight"
    name: str
    values: tuple[float, ...]
    """One for each output or input, or one for all."""


@dataclass(frozen=True, kw_only=True)
class RecordRequest(Request):
    """A bag of what goes on."""

    do: ClassVar[str] = "record"
    on: bool


KINDS = (Next, SetPointRequest, ReferenceRequest, Fault, PolicyChoice, ServiceCall, WeightChange, RecordRequest)
REQUESTS = {kind.do: kind for kind in KINDS}
SERVICES = ("stop", "hold", "enable", "reset", "arm", "disarm", "estop")
"""Of a controller; not each has all."""
WEIGHTS = ("output_weight", "rate_weight", "input_weight")
"""Parameters of a controller that a page may set."""


def check_faults(rig: Rig) -> None:
    """Raise UserError where the section faults of a rig's file is not as it should be."""
    RequestMenu.of(rig, ())


@dataclass(frozen=True, kw_only=True)
class RequestMenu:
    """What there is to ask for at a rig."""

    outputs: tuple[SetPointRange, ...]
    kinds: tuple[str, ...]
    """References: the rig's own by name, then the general ones."""
    faults: Mapping[str, Mapping[str, Any]]
    """By name: values of the simulated rig's parameters."""
    policies: tuple[str, ...]
    weights: Mapping[str, NodeParameter]
    sound: Mapping[str, Any] = field(default_factory=dict)
    """The same parameters without a fault."""

    @classmethod
    def of(cls, rig: Rig, kinds: tuple[str, ...]) -> RequestMenu:
        """That of a rig. kinds: the general ones. Raises UserError where its faults are not parameters of the plant
        that may change.
        """
        plant, controller = parameters(rig, "plant"), parameters(rig, "controller")
        faults = {}
        for name, content in (section(rig.content, "faults", str(rig.file)) or LOST).items():
            faults[name] = _fault(content, plant, f"{rig.file}: faults.{name}")
        return cls(
            outputs=set_point_ranges(rig),
            kinds=(*rig.references, *(kind for kind in kinds if kind not in rig.references)),
            faults=faults,
            policies=controller["policy"].choices,
            weights={name: controller[name] for name in WEIGHTS},
            sound={key: plant[key].default for values in faults.values() for key in values},
        )

    @property
    def tracked(self) -> tuple[SetPointRange, ...]:
        return tuple(output for output in self.outputs if output.tracked)

    def check(self, request: Request) -> None:
        """Raise UserError for what is not offered."""
        if not 0 <= request.id < 1 << 53:
            raise UserError("id must be within 0 and 2^53")
        if isinstance(request, SetPointRequest):
            self._check_set_point(request)
        elif isinstance(request, ReferenceRequest):
            _check_choice("experiment", request.kind, self.kinds)
        elif isinstance(request, Fault):
            _check_choice("fault", request.name, tuple(self.faults))
        elif isinstance(request, PolicyChoice):
            _check_choice("policy", request.policy, self.policies)
        elif isinstance(request, ServiceCall):
            _check_choice("call", request.service, SERVICES)
        elif isinstance(request, WeightChange):
            _check_choice("weight", request.name, WEIGHTS)
            self.weights[request.name].checked(request.values)

    def _check_set_point(self, request: SetPointRequest) -> None:
        times, tracked = request.times, self.tracked
        if not 1 <= len(times) <= POINTS or len(request.values) != len(times):
            raise UserError(
                f"set_point: {len(times)} times and {len(request.values)} values: they must be as many, 1 to {POINTS}"
            )
        if not all(0.0 <= time <= CURVE for time in times) or any(np.diff(times) < 1e-6):
            raise UserError(f"set_point: times must grow, from 0 to {CURVE:g} s at most")
        for row in request.values:
            if len(row) != len(tracked):
                names = ", ".join(output.name for output in tracked) or "none"
                raise UserError(f"set_point: {len(row)} values at a time: needed is one for each of {names}")
            for value, output in zip(row, tracked, strict=True):
                if not output.low <= value <= output.high:
                    raise UserError(
                        f"set_point: {output.name} of {value:g} {output.unit}: "
                        f"it must be within [{output.low:.4g}, {output.high:.4g}]"
                    )


def read_request(text: str | bytes, offer: RequestMenu) -> Request:
    """A request from what a page sent. Raises UserError for anything that is none, in a line."""
    if isinstance(text, bytes):
        raise UserError("a request is text, not bytes")
    try:
        content = json.loads(text, parse_constant=_no_number)
        if not isinstance(content, dict):
            raise UserError('a request is an object, {"do": ...}')
        refuse_endless(content, "request:")
        do = content.pop("do", None)
        kind = REQUESTS.get(do) if isinstance(do, str) else None
        if kind is None:
            raise UserError(f"unknown request {str(do)[:40]!r}: known are {', '.join(REQUESTS)}")
        request: Request = built(kind, content, kind.do)
    except (ValueError, RecursionError, OverflowError) as error:
        raise UserError("a request is JSON with numbers of a common size, which this is not") from error
    offer.check(request)
    return request


def _no_number(text: str) -> float:
    raise ValueError(text)


def _check_choice(what: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise UserError(f"{what}: {value[:40]!r}: choose one of {', '.join(choices)}")


def _fault(content: object, plant: Mapping[str, NodeParameter], where: str) -> dict[str, Any]:
    """Values of the plant's parameters, checked."""
    if not isinstance(content, dict) or not content:
        raise UserError(f"{where}: needs parameters of the plant with their values")
    for key in content:
        if key not in plant or not plant[key].live:
            known = ", ".join(name for name, item in plant.items() if item.live)
            raise UserError(f"{where}: {key} is no parameter of the plant that may change: those are {known}")
    try:
        return {key: plant[key].checked(value) for key, value in content.items()}
    except UserError as error:
        raise UserError(f"{where}: {error}") from error

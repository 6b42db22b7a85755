"""Readings of sentences, as a corpus writes them down: values are in the units in which outputs are shown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

BEAM, JOINT, DRILL, WHEEL, CONE = "cam_beam", "flexible_joint", "drill_string", "wheel_motor", "winged_cone"
ROBOT = "balancing_robot"
RPM = 2.0 * math.pi / 60.0


@dataclass(frozen=True)
class Refused:
    """A refusal; ``why`` stands in its reason."""

    why: str


def go(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "smooth", "to": {output: value}, **more}


def by(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "smooth", "by": {output: value}, **more}


def ramp(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "straight", "to": {output: value}, **more}


def step(value: float, output: str = "", **more: Any) -> dict[str, Any]:
    return {"do": "step", "to": {output: value}, **more}


def swing(low: float, high: float, hertz: float, seconds: float, output: str = "") -> dict[str, Any]:
    return {"do": "swing", "between": (low, high), "hertz": hertz, "seconds": seconds, "output": output}


def square(low: float, high: float, hertz: float, seconds: float, output: str = "") -> dict[str, Any]:
    return {**swing(low, high, hertz, seconds, output), "do": "square"}


def wait(seconds: float) -> dict[str, Any]:
    return {"do": "wait", "seconds": seconds}


def follow(name: str) -> dict[str, Any]:
    return {"do": "follow", "name": name}


HOME: dict[str, Any] = {"do": "home"}
STOP: dict[str, Any] = {"do": "stop"}

"""What a mock-up is to do, by a rig's file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared import drawn_scenarios
from hybrid_sysid_ros.extensions.shared.demo_recipe import DemoRecipe
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import plant_near
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import named_numbers, numbers, refuse_unknown, section

KEYS = ("learn", "part", "test", "seconds", "rate", "structure", "options", "tolerance")
"""Of the section mockup of rig.yaml."""
SECONDS = 1.0, 86_400.0
"""Of an experiment."""
SLOWEST = 1.0
"""Samples of an experiment a second."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is to be done."""

    rig: Rig
    reality: System
    """What the rig is, and nobody in the mock-up knows."""
    plan: DemoRecipe
    """How the rig's demo identifies, and which reference it follows."""
    learn: tuple[str, ...]
    """Experiments to learn from."""
    part: Part
    """Of each of these."""
    test: tuple[str, ...]
    """Experiments to test the models on."""
    seconds: float
    """Of each."""
    rate: float
    """Of their samples [Hz]."""
    tolerance: Mapping[str, float]
    """Of misses, by the name of a window of the reference, as its output is shown."""
    seed: int

    @classmethod
    def of(cls, rig: Rig, seed: int = 0) -> Setup:
        """By the sections demo and mockup of a rig's file; without the latter all experiments but the last are learnt
        from. What the rig really is, is drawn by the seed: its system with each free physical parameter moved by the
        deviation of policy_training. Raises UserError for what is not there.
        """
        plan, where = DemoRecipe.of(rig), f"{rig.file}: mockup"
        given = section(rig.content, "mockup", str(rig.file))
        refuse_unknown(given, KEYS, where)
        if "options" in given and "structure" not in given:
            raise UserError(f"{where}.options: belong to a structure: name one beside them")
        if "structure" in given:
            plan = replace(plan, structure=str(given["structure"]), options=named_numbers(given, "options", where))
        known = list(rig.experiments.excitations)
        if len(known) < 2:
            raise UserError(f"{rig.file}: experiments.excitations: needs two at least, one of them to test on")
        windows = rig.schedule(plan.reference).windows
        tolerance = named_numbers(given, "tolerance", where)
        for name in tolerance:
            if name not in windows:
                raise UserError(f"{where}.tolerance: {plan.reference} has no part {name}: it has {', '.join(windows)}")
            if not tolerance[name] > 0.0:
                raise UserError(f"{where}.tolerance.{name} is {tolerance[name]:g}: it needs to be above 0")
        learn, test = (
            _chosen(given, key, usual, known, where) for key, usual in (("learn", known[:-1]), ("test", known[-1:]))
        )
        if {*learn} & {*test}:
            both = ", ".join(sorted({*learn} & {*test}))
            raise UserError(f"{where}: {both} can't be in both learn and test: keep some that no fit sees")
        rate = _number(given, "rate", 1.0 / plan.sampling.step, (SLOWEST, 1.0 / rig.step), where)
        rig.steps(1.0 / rate, f"{where}.rate {rate:g} Hz: its period")
        return cls(
            rig=rig,
            reality=plant_near(rig.system, drawn_scenarios.spread_of(rig).parameters, np.random.default_rng(seed)),
            plan=plan,
            learn=learn,
            part=Part.parse(str(given.get("part", "0:1"))),
            test=test,
            seconds=_number(given, "seconds", 40.0, SECONDS, where),
            rate=rate,
            tolerance=tolerance,
            seed=seed,
        )


def _chosen(
    given: Mapping[str, Any], key: str, usual: Sequence[str], known: Sequence[str], where: str
) -> tuple[str, ...]:
    """Names of experiments."""
    found = given.get(key, list(usual))
    if not isinstance(found, list) or not found or not all(name in known for name in found):
        raise UserError(f"{where}.{key} is {found!r}: it needs a list of experiments: {', '.join(known)}")
    return tuple(found)


def _number(given: Mapping[str, Any], key: str, usual: float, within: tuple[float, float], where: str) -> float:
    found = numbers(given.get(key, usual), f"{where}.{key}", count=1)[0]
    if not within[0] <= found <= within[1]:
        raise UserError(f"{where}.{key} is {found:g}: it needs {within[0]:g} to {within[1]:g}")
    return found

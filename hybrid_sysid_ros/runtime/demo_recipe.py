"""Plan: what a rig's demo learns from, how, and which reference its loop follows: the section demo of rig.yaml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.structure import Options
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import named_numbers, numbers, refuse_unknown, section

SHIPPED_BAGS = Path(__file__).resolve().parents[2] / "bags"
KEYS = ("learn", "part", "test", "structure", "options", "step", "period", "reference", "scored")
"""Of the section demo of rig.yaml."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoRecords:
    """What a demo learns from and is scored on."""

    training: Sequence[Record]
    part: Part
    """Of each training record."""
    tests: Sequence[tuple[Record, Part]]
    names: Mapping[str, str] = field(default_factory=dict)
    """What the summary calls a record, where that is another name than its own."""
    source: str = "simulated"
    """simulated or real."""


@dataclass(frozen=True, kw_only=True)
class DemoRecipe:
    """The section demo of a rig's file."""

    learn: tuple[str, ...]
    """Bags to learn from."""
    part: Part
    """Of each; it is scored on the rest."""
    test: tuple[str, ...]
    """Bags that it is scored on as a whole."""
    structure: str
    options: Options
    """Of the structure."""
    sampling: Sampling
    reference: str
    """Which one of the rig's the loop follows."""
    scored: tuple[str, ...]
    """Its parts where tracking is judged."""

    @classmethod
    def of(cls, rig: Rig) -> DemoRecipe:
        """Raises UserError where the section names what is not there; without one all is as usual, but for the bags."""
        given, where = section(rig.content, "demo", str(rig.file)), f"{rig.file}: demo"
        refuse_unknown(given, KEYS, where)
        usual = Sampling()
        step, period = (numbers(given.get(key, getattr(usual, key)), where, count=1)[0] for key in ("step", "period"))
        schedule = rig.schedule(str(given.get("reference") or rig.reference))
        scored = _names(given, "scored", where) or tuple(schedule.windows)
        for name in scored:
            if name not in schedule.windows:
                raise UserError(f"{where}.scored: {schedule.name} has no part {name}: {', '.join(schedule.windows)}")
        return cls(
            learn=_names(given, "learn", where),
            part=Part.parse(str(given.get("part", "0:0.5"))),
            test=_names(given, "test", where),
            structure=str(given.get("structure", "hybrid")),
            options=named_numbers(given, "options", where),
            sampling=Sampling(step=step, period=period),
            reference=schedule.name,
            scored=scored,
        )

    def places(self, rig: Rig) -> tuple[list[Path], list[Path]]:
        """Those to learn from and those to test. Raises UserError where one is missing, or none is named."""
        if not self.learn:
            raise UserError(f"{rig.file}: demo: is missing: give it bags to learn from, {{learn: [NAME, ...]}}")
        return [_bag(rig, name) for name in self.learn], [_bag(rig, name) for name in self.test]

    def records(self, rig: Rig) -> DemoRecords:
        """The bags, from the rig's folder or those that ship. Raises UserError where one is missing."""
        learnt, kept = ([bags.read(place, rig.signals) for place in places] for places in self.places(rig))
        rest = Part(start=self.part.stop) if self.part.stop < 1.0 else Part(stop=self.part.start)
        halves = [(record, rest) for record in learnt if (self.part.start, self.part.stop) != (0.0, 1.0)]
        return DemoRecords(training=learnt, part=self.part, tests=[*halves, *((record, Part()) for record in kept)])


def _names(given: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    """A list of names. Raises UserError for anything else."""
    found = given.get(key, [])
    if not isinstance(found, list) or not all(isinstance(item, str) for item in found):
        raise UserError(f"{where}.{key} is {found!r}: it needs a list of names")
    return tuple(found)


def _bag(rig: Rig, name: str) -> Path:
    """A bag by its name."""
    places = [folder / name for folder in (rig.folder / "bags", SHIPPED_BAGS)]
    for place in places:
        if place.is_dir():
            return place
    raise UserError(
        f"{rig.file}: demo: no bag {name} in {places[0].parent}: record it there, or hybrid-sysid simulate it"
    )

"""Recipe of a rig's demo, the section demo of rig.yaml: records, structure, and the loop's reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.structure import Options
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, named_numbers, numbers, refuse_unknown, section

SHIPPED_BAGS = Path(__file__).resolve().parents[3] / "bags"
KEYS = ("learn", "part", "test", "structure", "options", "step", "period", "reference", "scored", "simulate")
"""Keys of the section demo of rig.yaml."""


@dataclass(frozen=True, kw_only=True)
class SimulatedBag:
    """A bag that is simulated where it is not there; see :func:`~..rigs.experiments.simulate_experiment`."""

    kind: str
    """Name of the experiment."""
    seed: int = 1
    duration: float = 40.0
    """[s]."""
    rate: float = 200.0
    """Samples per second [Hz]."""
    disturbed: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordSplit:
    """Records on which a demo's model is trained and tested."""

    training: Sequence[Record]
    part: Part
    """The part of each training record that is used."""
    tests: Sequence[tuple[Record, Part]]
    names: Mapping[str, str] = field(default_factory=dict)
    """Names of records in the summary, where they differ from the records' own."""
    source: str = "simulated"
    """Whether the records are simulated or real."""


@dataclass(frozen=True, kw_only=True)
class DemoRecipe:
    """The section demo of a rig's file."""

    learn: tuple[str, ...]
    """Training bags."""
    part: Part
    """Part of each training bag that is used; the rest is a test."""
    test: tuple[str, ...]
    """Test bags, which are used as a whole."""
    structure: str
    options: Options
    """Options of the structure."""
    sampling: Sampling
    reference: str
    """Name of the rig's reference that the loop follows."""
    scored: tuple[str, ...]
    """Names of the reference's parts in which tracking is judged."""
    simulate: Mapping[str, SimulatedBag]
    """How bags are made that are not there, by name."""

    @classmethod
    def of(cls, rig: Rig) -> DemoRecipe:
        """The recipe of a rig, with defaults for a missing section. Raises UserError for unknown names in it."""
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
            simulate={
                name: built(SimulatedBag, item, f"{where}.simulate.{name}")
                for name, item in section(given, "simulate", where).items()
            },
        )

    def places(self, rig: Rig, out: Path = Path()) -> tuple[list[Path], list[Path]]:
        """Paths of training and test bags: in the rig's folder, the package, or ``out``, where they may be simulated.

        Raises UserError where one is missing and can't be simulated, or none is named.
        """
        if not self.learn:
            raise UserError(f"{rig.file}: demo: is missing: give it training bags, {{learn: [NAME, ...]}}")
        return [self._bag(rig, name, out) for name in self.learn], [self._bag(rig, name, out) for name in self.test]

    def records(self, rig: Rig, out: Path) -> RecordSplit:
        """The records of the bags; those that are not there are simulated into ``out``. Raises UserError where one is
        missing and can't be simulated.
        """
        found = self.places(rig, out)
        for path in {path for places in found for path in places if path.parent == out}:
            given = asdict(self.simulate[path.name])
            simulate_experiment(rig, given.pop("kind"), path, **given, overwrite=True)
        learnt, kept = ([bags.read(place, rig.signals) for place in places] for places in found)
        rest = Part(start=self.part.stop) if self.part.stop < 1.0 else Part(stop=self.part.start)
        halves = [(record, rest) for record in learnt if (self.part.start, self.part.stop) != (0.0, 1.0)]
        return RecordSplit(training=learnt, part=self.part, tests=[*halves, *((record, Part()) for record in kept)])

    def _bag(self, rig: Rig, name: str, out: Path) -> Path:
        places = [folder / name for folder in (rig.folder / "bags", SHIPPED_BAGS)]
        for place in places:
            if place.is_dir():
                return place
        if name in self.simulate:
            return out / name
        raise UserError(
            f"{rig.file}: demo: no bag {name} in {places[0].parent}: record it there, or hybrid-sysid simulate it"
        )


def checked(rig: Rig) -> None:
    """Raise UserError for wrong values in the section, and for bags that are missing."""
    if rig.content["demo"].keys() != {"step", "period"}:  # which are those of fits, also without a demo
        DemoRecipe.of(rig).places(rig)


def _names(given: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    """A list of names. Raises UserError for anything else."""
    found = given.get(key, [])
    if not isinstance(found, list) or not all(isinstance(item, str) for item in found):
        raise UserError(f"{where}.{key} is {found!r}: it needs a list of names")
    return tuple(found)

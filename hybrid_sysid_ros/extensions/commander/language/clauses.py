"""Clauses: what each part of a sentence says."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from hybrid_sysid_ros.extensions.commander.language.lexicon import Symbol
from hybrid_sysid_ros.rigs.units import PLAIN, Unit
from hybrid_sysid_ros.support.errors import UserError

MOST = 20  # clauses
ENDS = ("between", "range", "span")
"""Roles of quantities that are one of two ends."""


class IncompleteError(UserError):
    """A reading that leaves a word or a slot open: another way to part the sentence may not."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number with its unit, and what it is for."""

    value: float
    unit: Unit | None
    role: str
    text: str
    kind: str = ""
    """"amplitude", "peak_to_peak", "speed", ... where a noun said so."""
    output: int | None = None
    """Which was named with it."""

    @property
    def said(self) -> float:
        """In the base of its unit."""
        return self.value * (self.unit or PLAIN).factor

    @property
    def base(self) -> str:
        return self.unit.base if self.unit is not None else ""


@dataclass(frozen=True)
class Share:
    """A factor of the present value, of the range, or of what was not said."""

    factor: float
    of: str
    """"now", "range" or ""."""
    role: str
    text: str
    word: str
    """That says the factor."""


class Awaited(NamedTuple):
    """What a clause waits for."""

    when: str
    """"once", "until", or "if", of what is so already."""
    value: Quantity | None
    """That is reached; None: that nothing moves any more."""
    side: float = 0.0
    """1 where it has to be above the value, -1 below, 0 where it comes to it from either side."""


@dataclass(kw_only=True)
class Clause:
    """What one part of a sentence says."""

    then: bool = False
    """Whether it begins with the word."""
    meanwhile: bool = False
    """Whether it is to hold while the one before moves."""
    verbs: list[Symbol] = field(default_factory=list)
    quantities: list[Quantity] = field(default_factory=list)
    shares: list[Share] = field(default_factory=list)
    paces: list[str] = field(default_factory=list)
    directions: list[Symbol] = field(default_factory=list)
    comparatives: list[tuple[float, str]] = field(default_factory=list)
    """Factors, and what was said."""
    targets: list[int] = field(default_factory=list)
    nouns: list[str] = field(default_factory=list)
    """"amplitude", "frequency" or "period" that stand alone."""
    names: list[str] = field(default_factory=list)
    delay: Quantity | None = None
    condition: Awaited | None = None
    each: Quantity | None = None
    """How long each of the parts up to here lasts."""
    increment: Quantity | None = None
    """Of a staircase."""
    count_of_steps: int = 0
    """That lead to the end of a staircase; 0 where nobody says how many."""
    whole_range: str = ""
    """That a swing is over all of it."""
    together: str = ""
    """That several outputs go at once."""
    sense: Symbol | None = None
    """"forwards" or "backwards"."""
    full_speed: str = ""
    at_full_speed: str = ""
    """That it is how another value is gone to, or the value itself where there is none."""
    here: str = ""
    from_home: str = ""
    """That a change is counted from where all is 0, and not from where it is."""
    bit: str = ""
    smoothly: bool = False
    displacing: Symbol | None = None
    """A verb of moving, which leaves open whether a value is a place or a change; "change" does with a speed, too."""
    addressed: bool = False
    """Whether the rig was named, beside which "at" a value needs no verb."""
    going: bool = False
    """Whether the rig was said to be turning, moving ..."""
    wish: bool = False
    """Whether "I want" or "give me" was said, which asks for the value behind it."""

    neighbours: list[tuple[Symbol, Symbol]] = field(default_factory=list)
    """Verbs with nothing between them."""

    def adjacent(self, first: Symbol, second: Symbol) -> bool:
        """Whether nothing stands between two verbs."""
        return (first, second) in self.neighbours

    @property
    def said(self) -> list[str]:
        """Its verbs."""
        return [symbol.value for symbol in self.verbs]

    @property
    def empty(self) -> bool:
        return not (
            self.verbs or self.quantities or self.shares or self.paces or self.directions or self.comparatives
            or self.targets or self.names or self.delay or self.condition or self.here or self.nouns or self.each
            or self.sense or self.full_speed or self.increment or self.count_of_steps
        )  # fmt: skip

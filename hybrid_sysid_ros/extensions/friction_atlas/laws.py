"""The laws of friction, each on one block that a force and a spring push: parameters, bounds, units and sources."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core.friction import (
    Ageing,
    Bristles,
    Contact,
    Dry,
    Hysteretic,
    MaxwellSlip,
    Viscous,
    fading_stiffnesses,
)
from hybrid_sysid_ros.core.friction.contact import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.parameters import bounded
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.errors import UserError

Vector = Sequence[Scalar]
ELEMENTS = 4


@dataclass(frozen=True, kw_only=True)
class SlidingBlock(System):
    """m x'' = f + k (p - x) + c (p' - x') - F: a force f, and a spring and damper to an end p that is led."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("force [N]", "end [m]", "end_speed [m/s]")
    source: ClassVar[str] = ""
    """Of the law."""

    mass: float = bounded(1.0, 1e-3, 1e3, unit="kg")
    """m, mass of the block."""
    spring: float = bounded(0.0, 0.0, 1e7, unit="N/m")
    """k."""
    damper: float = bounded(0.0, 0.0, 1e5, unit="N s/m")
    """c."""

    @property
    def way(self) -> float:
        """By which bristles or elements are bent before all of them slide [m]; 0: there are none."""
        return 0.0

    def sliding(self, speed: float) -> tuple[float, ...]:
        """Hidden states of a block that has slid at a speed [m/s] above 0 for long."""
        return ()

    def law(self, x: Vector, u: Vector) -> Vector:
        led = self.spring * (u[1] - x[0]) + self.damper * (u[2] - x[1])
        return x[1], (u[0] + led) / self.mass


@dataclass(frozen=True, kw_only=True)
class ViscousLaw(SlidingBlock):
    """F = fv v."""

    source = "Newton's law of viscosity; Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7)"
    contacts: ClassVar[tuple[Contact, ...]] = (Viscous(on="speed", viscous="viscous_rate"),)

    viscous: float = bounded(0.4, 0.0, 1e4, unit="N s/m")
    """fv, viscous friction per speed."""

    def viscous_rate(self, x: Vector, u: Vector) -> Scalar:
        return self.viscous / self.mass


@dataclass(frozen=True, kw_only=True)
class CoulombLaw(ViscousLaw):
    """F = Fc sgn v + fv v."""

    source = "Coulomb (1785); solved by Moreau's time stepping, Acary & Brogliato (2008)"
    contacts: ClassVar[tuple[Contact, ...]] = (Dry(on="speed", level="level", viscous="viscous_rate"),)

    coulomb: float = bounded(1.0, 0.0, 1e4, unit="N")
    """Fc, dry friction while it slides."""

    def level(self, x: Vector, u: Vector) -> Scalar:
        return self.coulomb / self.mass


@dataclass(frozen=True, kw_only=True)
class _Static(CoulombLaw):
    """What is higher at rest."""

    static: float = bounded(1.5, 0.0, 1e4, unit="N")
    """Fs, at rest; not below Fc."""

    def check(self) -> None:
        super().check()
        if self.static < self.coulomb:
            raise UserError(
                f"static friction of {self.static:g} N is below Coulomb friction of {self.coulomb:g} N, so that what "
                "moves would rub more than what rests: raise static or lower coulomb"
            )


@dataclass(frozen=True, kw_only=True)
class StribeckLaw(_Static):
    """F = [Fc + (Fs - Fc) exp(-(v / vs)^2)] sgn v + fv v."""

    source = "Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), eq. (3) with exponent 2"

    stribeck_speed: float = bounded(0.05, 1e-5, 1e2, unit="m/s")
    """vs, the speed about which that at rest is lost."""

    def level(self, x: Vector, u: Vector) -> Scalar:
        return self.friction(x[1]) / self.mass

    def friction(self, speed: Scalar) -> Scalar:
        """At a steady speed [m/s], without the viscous one [N]."""
        return stribeck(speed, self.coulomb, self.static, self.stribeck_speed)


@dataclass(frozen=True, kw_only=True)
class DahlLaw(CoulombLaw):
    """F = s0 z + fv v,  z' = v - |v| z s0 / Fc."""

    source = "Dahl (1968), Aerospace Corporation TOR-0158(3107-18)-1, with exponent 1"
    contacts = (Bristles(on="speed", level="level", stiffness="bristles", viscous="viscous_rate"),)

    stiffness: float = bounded(500.0, 1e-3, 1e8, unit="N/m")
    """s0, stiffness of the contact."""

    def bristles(self, x: Vector, u: Vector) -> Scalar:
        return self.stiffness / self.mass

    @property
    def way(self) -> float:
        return self.coulomb / self.stiffness

    def sliding(self, speed: float) -> tuple[float, ...]:
        return (self.way,)


@dataclass(frozen=True, kw_only=True)
class LugreLaw(StribeckLaw):
    """F = s0 z + s1 z' + fv v,  z' = v - |v| z s0 / g(v),  g = Fc + (Fs - Fc) exp(-(v / vs)^2)."""

    source = "Canudas de Wit, Olsson, Astrom, Lischinsky (1995), IEEE TAC 40(3), eqs. (1)-(3)"
    contacts = (
        Bristles(on="speed", level="level", stiffness="bristles", damping="bristle_rate", viscous="viscous_rate"),
    )

    stiffness: float = bounded(500.0, 1e-3, 1e8, unit="N/m")
    """s0, stiffness of the contact."""
    damping: float = bounded(10.0, 0.0, 1e5, unit="N s/m")
    """s1, damping of the contact."""

    def bristles(self, x: Vector, u: Vector) -> Scalar:
        return self.stiffness / self.mass

    def bristle_rate(self, x: Vector, u: Vector) -> Scalar:
        return self.damping / self.mass

    @property
    def way(self) -> float:
        return self.static / self.stiffness

    def sliding(self, speed: float) -> tuple[float, ...]:
        return (self.friction(speed) / self.stiffness,)


def _element(index: int) -> object:
    def stiffness(system: MaxwellLaw, x: Vector, u: Vector) -> Scalar:
        return fading_stiffnesses(system.stiffness / system.mass, ELEMENTS)[index]

    return stiffness


@dataclass(frozen=True, kw_only=True)
class MaxwellLaw(StribeckLaw):
    """F = sum k_i z_i + fv v; z_i' = v until k_i |z_i| = g(v) / N, then k_i z_i' = C (sgn v / N - k_i z_i / g(v))."""

    source = "Al-Bender, Lampaert, Swevers (2005), IEEE TAC 50(11); four elements that yield at 1 : 2 : 3 : 4"
    contacts = (
        MaxwellSlip(
            on="speed",
            level="level",
            stiffness=tuple(_element(i) for i in range(ELEMENTS)),  # type: ignore[misc]
            attraction="rate",
            viscous="viscous_rate",
        ),
    )

    stiffness: float = bounded(500.0, 1e-3, 1e8, unit="N/m")
    """Of all elements together, before one slips."""
    attraction: float = bounded(50.0, 1e-3, 1e9, unit="N/s")
    """C: how fast slipping elements follow a level that falls."""

    def rate(self, x: Vector, u: Vector) -> Scalar:
        return self.attraction / self.mass

    @property
    def way(self) -> float:
        return self._bent(self.static)[-1]

    def sliding(self, speed: float) -> tuple[float, ...]:
        return self._bent(self.friction(speed))

    def _bent(self, friction: float) -> tuple[float, ...]:
        """Deflections of the elements that share a friction [N] equally."""
        return tuple(friction / ELEMENTS / k for k in fading_stiffnesses(self.stiffness, ELEMENTS))


@dataclass(frozen=True, kw_only=True)
class StefanskiLaw(_Static):
    """F = [Fc + (Fs - Fc) exp(-a1 |v| / (|v'| + a2)) sgn(v v')] sgn v + fv v."""

    source = (
        "Wojewoda, Stefanski, Wiercigroch, Kapitaniak (2008), Phil. Trans. R. Soc. A 366, 747-765; the formula as it "
        "is commonly quoted, not compared with the paper's print"
    )
    contacts = (
        Hysteretic(
            on="speed",
            coulomb="level",
            static="static_level",
            speed_shape="speed_shape",
            acceleration_shape="acceleration_shape",
            viscous="viscous_rate",
        ),
    )

    speed_shape: float = bounded(10.0, 0.0, 1e5, unit="1/s")
    """a1, how much the speed lowers it."""
    acceleration_shape: float = bounded(0.5, 1e-6, 1e5, unit="m/s^2")
    """a2, the acceleration beside which that counts."""

    def static_level(self, x: Vector, u: Vector) -> Scalar:
        return self.static / self.mass

    def sliding(self, speed: float) -> tuple[float, ...]:
        return (0.0,)


@dataclass(frozen=True, kw_only=True)
class AgeingLaw(_Static):
    """F = [Fc + (Fs - Fc) (1 - r)] sgn v + fv v,  r' = |v| (1 - r) / L - r / T."""

    source = " ".join((Ageing.__doc__ or "").partition("Source: ")[2].split()).rstrip(".")
    contacts = (
        Ageing(
            on="speed",
            level="level",
            excess="excess",
            rest_time="rest_time",
            memory="memory",
            viscous="viscous_rate",
        ),
    )

    rest_time: float = bounded(0.5, 1e-4, 1e5, unit="s")
    """T, in which a contact ages."""
    memory: float = bounded(0.005, 1e-7, 1e2, unit="m")
    """L, the sliding displacement that renews it."""

    def excess(self, x: Vector, u: Vector) -> Scalar:
        return (self.static - self.coulomb) / self.mass

    def sliding(self, speed: float) -> tuple[float, ...]:
        renewal = speed * self.rest_time / self.memory
        return (renewal / (1.0 + renewal),)


LAWS: Mapping[str, SlidingBlock] = {
    "viscous": ViscousLaw(),
    "coulomb": CoulombLaw(),
    "stribeck": StribeckLaw(),
    "dahl": DahlLaw(),
    "lugre": LugreLaw(),
    "maxwell": MaxwellLaw(),
    "stefanski": StefanskiLaw(),
    "ageing": AgeingLaw(),
}


def law(name: str, values: Mapping[str, float] | None = None) -> SlidingBlock:
    """A law by its name, with other values of its parameters.

    Raises UserError for an unknown law or parameter, for a value outside its bounds, and for values that contradict
    each other.
    """
    if name not in LAWS:
        raise UserError(f"friction law {name!r} is unknown; choose one of {', '.join(LAWS)}")
    chosen, given = LAWS[name], dict(values or {})
    known = chosen.named
    for item in given:
        if item not in known or item in ("spring", "damper"):
            names = ", ".join(key for key in known if key not in ("spring", "damper"))
            raise UserError(f"friction law {name} has no parameter {item!r}: it has {names}")
    made = chosen.with_values([given.get(item, value) for item, value in known.items()])
    for parameter, value in made.outside:
        bounds = f"{parameter.low:g} to {parameter.high:g}"
        raise UserError(f"friction law {name}: {parameter.name} = {value:g} {parameter.unit} is outside {bounds}")
    made.check()
    assert isinstance(made, SlidingBlock)
    return made

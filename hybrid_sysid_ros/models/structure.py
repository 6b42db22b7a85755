"""Model structures that can be identified. Each is one class, which the manifest of trunk or extension names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from inspect import isabstract
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Options = Mapping[str, float | int]


@dataclass(frozen=True, kw_only=True)
class Option:
    """An option with a default within low and high; kind "log" is a positive number that is searched by magnitude."""

    default: float | int
    low: float | int
    high: float | int
    kind: Literal["int", "float", "log"]
    description: str
    searched: bool = True
    """Whether a search varies it: not what only buys less chance with more time, or makes another structure."""


def complete(given: Options, known: Mapping[str, Option], structure: str) -> dict[str, float | int]:
    """All options, the given ones over the defaults.

    Raises UserError for an option that the structure does not have, or a value outside its range.
    """
    for name, value in given.items():
        if name not in known:
            raise UserError(f"structure {structure} has no option {name}; it has {', '.join(known) or 'none'}")
        option = known[name]
        if not option.low <= value <= option.high:
            raise UserError(f"option {name} = {value:g} is outside {option.low:g} to {option.high:g}")
        if option.kind == "int" and value != int(value):
            raise UserError(f"option {name} = {value:g} must be a whole number")
    chosen = {name: given.get(name, option.default) for name, option in known.items()}
    return {name: int(value) if known[name].kind == "int" else float(value) for name, value in chosen.items()}


def parse(texts: list[str]) -> dict[str, float]:
    """Options from NAME=VALUE. Raises UserError for anything else."""
    options = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            options[name.strip()] = float(value)
        except ValueError:
            raise UserError(f"option {text!r}: write NAME=NUMBER, such as units=8") from None
    return options


if TYPE_CHECKING:
    from hybrid_sysid_ros.rigs.rig import Rig
    from hybrid_sysid_ros.rigs.sensor import Sensor
Boxes = Mapping[str, System]
"""Further gray boxes of a rig, by name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Magnitudes:
    """How large the declared states and the inputs of a rig are in training data."""

    scales: Array
    """Magnitudes of declared states and inputs, (states + inputs,)."""
    centre: Array
    """Means of declared states and inputs."""
    features: Array | None = None
    """Magnitudes of the features that the rig's system declares, (features,)."""
    unshown: tuple[str, ...] = ()
    """Names of the states that no record shows."""
    sensors: tuple[Sensor, ...] = ()
    """The rig's sensors, at which those that are fitted begin."""


class FitContext(Protocol):
    """Everything on which the fit of a structure depends; the records are resampled once."""

    @property
    def rig(self) -> Rig: ...

    @property
    def sampling(self) -> Sampling:
        """The sampling that :meth:`Structure.sampling` returned."""

    @property
    def options(self) -> Mapping[str, float | int]:
        """All options of the structure, defaults included."""

    @property
    def seed(self) -> int: ...

    @property
    def progress(self) -> Any:
        """A function of stage, evaluations and relative error, or None."""

    @property
    def magnitudes(self) -> Magnitudes:
        """Magnitudes of the rig's states and inputs in the records."""

    def experiments(self, system: System) -> list[PreparedRecord]:
        """The records with the states of a system."""

    def fit(self, system: System, **settings: Any) -> Fit:
        """Least squares on free runs over the records, beginning at the values of a system.

        settings: those of :func:`hybrid_sysid_ros.identification.fitting.fit`; ``experiments`` instead of the records'.
        """

    def fit_physics(self, systems: Sequence[System], **settings: Any) -> Fit:
        """The best of fits that begin at several systems, by the options ``starts``, ``ridge`` and ``input_bias``.
        For a rig that needs a stabiliser they use short windows.
        """

    def of(self, structure: Structure) -> FitContext:
        """The context for a part of the structure, with the options of this part."""


@dataclass(frozen=True, kw_only=True)
class Structure(ABC):
    """A model structure on one rig.

    A new structure is a class with :attr:`options`, :meth:`fit` and :meth:`assemble`; an extension provides it under a
    name as ``structures``. Nodes import the class's module to load a model, so modules that only a fit needs are
    imported in :meth:`fit`.
    """

    summary: ClassVar[str] = ""
    """A description in one line."""
    seeded: ClassVar[bool] = False
    """Whether a model begins at random weights, so that studies fit it over several seeds."""
    is_gray_box: ClassVar[bool] = False
    """Whether it is physics alone, on which other structures may build."""
    combines: ClassVar[bool] = False
    """Whether the name NAME_BOX means this structure on the gray box BOX."""
    default_box: ClassVar[str] = ""
    """The gray box on which it builds where its name has none; empty for none."""

    name: str
    physics: System
    """The rig's own system."""
    boxes: Boxes = field(default_factory=dict)
    chosen_box: str = ""
    """The gray box in its name."""

    @property
    def options(self) -> Mapping[str, Option]:
        """Options that a user may set, by name."""
        return {}

    def sampling(self, asked: Sampling) -> Sampling:
        """The sampling of the fit and of its model, where a user asks for the sampling ``asked``."""
        return asked

    @abstractmethod
    def fit(self, context: FitContext) -> Fit:
        """Fit the structure to the records of a context. Raises UserError where they can't be fitted."""

    @abstractmethod
    def assemble(self, design: Mapping[str, Any], weights: Array) -> System:
        """The system from its stored :attr:`~hybrid_sysid_ros.core.System.design` and weights (size,).

        The values of its parameters are set afterwards. Raises UserError where design and weights don't fit.
        """

    def build(self, sizes: Magnitudes, options: Options, seed: int) -> tuple[System, tuple[str, ...]]:
        """The system before its fit, and the names of the parameters that the fit does not change.

        Raises UserError for structures that are selected from data.
        """
        raise UserError(f"structure {self.name} is selected from data: call identify() instead of build()")

    # ------------------------------------------------------------------ physics

    @property
    def box(self) -> str:
        """The name of the gray box on which it builds; its own name if it is one, empty for none."""
        return self.name if self.is_gray_box else self.chosen_box or self.default_box

    @property
    def gray(self) -> Structure:
        """The gray box on which it builds."""
        return structure_of(self.box, self.physics, self.boxes)

    def initial_guess(self, system: System, context: FitContext) -> System:
        """A gray box with initial values of a fit, as far as they follow from the records."""
        return system

    # ------------------------------------------------------------------ description

    def lines(self, system: System) -> Sequence[str]:
        """Lines that describe a fitted system, such as its rules."""
        return ()

    def figures(self, system: System) -> Mapping[str, Any]:
        """Plotly figures of a fitted system for a report, by name."""
        return {}

    def stages(self, system: System) -> Mapping[str, System]:
        """Parts of a fitted system that can be simulated by themselves, and the whole system, by name: their free runs
        are compared. Empty where there is nothing to compare.
        """
        return {}


def structure_names() -> tuple[str, ...]:
    """The names of all structures. Any gray box G has further ones, such as hybrid_G and residual_G."""
    return tuple(extensions.targets("structures"))


def structure_of(name: str, physics: System, boxes: Boxes | None = None) -> Structure:
    """A structure on a rig's system; a rig's own boxes take precedence over other structures of the same name.

    Raises UserError for an unknown name, and for one whose extension can't be imported.
    """
    table, own = extensions.targets("structures"), boxes or {}
    given: dict[str, Any] = {"name": name, "physics": physics, "boxes": own}
    if name in own:
        return _class_of(table["gray"])(**given)
    if name in table:
        return _class_of(table[name])(**given)
    for kind, place in table.items():
        box = name.removeprefix(f"{kind}_")
        known = box in own or (box in table and _class_of(table[box]).is_gray_box)
        if box != name and known and _class_of(place).combines:
            return _class_of(place)(**given, chosen_box=box)
    if why := extensions.missing(name):
        raise UserError(f"structure {name!r}: {why}")
    raise UserError(
        f"structure {name!r} is unknown; choose one of {', '.join(dict.fromkeys((*table, *own)))}, or hybrid_NAME or "
        f"residual_NAME of a gray box, or install the extension that provides it{extensions.left_out()}"
    )


def _class_of(target: str) -> type[Structure]:
    found: type[Structure] = extensions.loaded(target)
    if not (isinstance(found, type) and issubclass(found, Structure)) or isabstract(found):
        raise UserError(f"{target} is {found!r}: it needs a Structure that has fit and assemble")
    return found


def options_of(structure: str, physics: System, boxes: Boxes | None = None) -> dict[str, Option]:
    """The options of a structure, and the terms of the rig's system as options, each 0 (left out) or 1.

    Raises UserError for an unknown name.
    """
    return dict(structure_of(structure, physics, boxes).options)


def assemble(
    structure: str,
    physics: System,
    *,
    design: Mapping[str, Any] | None = None,
    weights: Array | None = None,
    boxes: Boxes | None = None,
) -> System:
    """A system of a named structure on a rig's system, with its learned part if it has one.

    design: that of the saved system (:attr:`~hybrid_sysid_ros.core.System.design`). Raises UserError for an unknown
    name, and where the design or the weights (size,) are missing or don't fit each other.
    """
    kind = structure_of(structure, physics, boxes)
    if not kind.is_gray_box and (design is None or weights is None):
        raise UserError(f"structure {structure}: the design or the weights of its learned part are missing")
    return kind.assemble(design or {}, np.zeros(0) if weights is None else weights)


def build(
    structure: str,
    physics: System,
    *,
    scales: Array,
    seed: int,
    options: Options | None = None,
    centre: Array | None = None,
    features: Array | None = None,
    unshown: tuple[str, ...] = (),
    boxes: Boxes | None = None,
) -> tuple[System, tuple[str, ...]]:
    """A system before its fit, with all parameters at their initial values, so that no earlier result leaks in; and the
    names of the parameters that the fit must not change, since their term is switched off.

    physics: the rig's system. scales, centre, features, unshown: see :class:`Magnitudes`; centre is zero by default.
    seed: that of a network's first weights.

    Raises UserError for an unknown name or option, for a structure that makes no sense on the rig, and for
    structures that are selected from data.
    """
    kind = structure_of(structure, physics, boxes)
    sizes = Magnitudes(
        scales=scales, centre=np.zeros(len(scales)) if centre is None else centre, features=features, unshown=unshown
    )
    return kind.build(sizes, complete(options or {}, kind.options, structure), seed)

"""Terms of a stage's cost and constraints: formulas of states, inputs, outputs and parameters.

A formula is text, so that a problem stays plain data in files, policies and nodes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, permutations
from typing import Any

import daqp
import numpy as np

from hybrid_sysid_ros.core import System, trace
from hybrid_sysid_ros.core.intervals import Nearest, nearest
from hybrid_sysid_ros.core.stage_values import InputValues, StageValues, depend_on, values_by_inputs
from hybrid_sysid_ros.core.symbolic import symbolic_output
from hybrid_sysid_ros.core.trace import NotFiniteError
from hybrid_sysid_ros.support import errors
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError, warn

FAR, INFEASIBLE = 1e20, -1
"""What DAQP takes for no bound, and its flag where nothing is within all of them."""


@dataclass(frozen=True, kw_only=True)
class StageTerm:
    """A scalar z of each stage, at the end of its interval, and its part of the problem:
    weight z^2 + price z, and low <= z <= high.

    weight and price are one number for all stages, or one for each. Raises UserError for values that make no sense.
    """

    name: str
    value: str
    """Formula of states, inputs without their disturbance, outputs, model's parameters and stage's parameters."""
    weight: Numbers | float = 0.0
    """[1/unit^2], at least 0."""
    price: Numbers | float = 0.0
    """[1/unit], of any sign."""
    low: float = -math.inf
    high: float = math.inf
    hard: bool = False
    """Whether the bounds hold without exception, which is for formulas of inputs alone; else they are soft."""
    soft_linear: float = 0.0
    """Price of a distance from the bounds [1/unit]."""
    soft_quadratic: float = 1e4
    """Price of a squared distance [1/unit^2]."""
    margin: Numbers | float = 0.0
    """By how much soft bounds are moved in, one number or one for each stage."""
    final: bool = False
    """Whether it counts at the end of the horizon alone."""

    def __post_init__(self) -> None:
        where = f"mpc: term {self.name}"
        if not isinstance(self.name, str) or not self.name.isidentifier() or not isinstance(self.value, str):
            raise UserError(f"{where}: a term needs a name and a formula, such as power: {{value: force * speed}}")
        for key in ("weight", "price", "margin"):
            given = getattr(self, key)
            object.__setattr__(self, key, tuple(given) if isinstance(given, list | tuple) else (given,))
        for key in ("weight", "price", "margin", "low", "high", "soft_linear", "soft_quadratic"):
            found = getattr(self, key)
            values = found if isinstance(found, tuple) else (found,)
            whole = key in ("low", "high")
            if not all(_is_number(item) and (whole or math.isfinite(item)) for item in values) or not values:
                raise UserError(f"{where}: {key} is {found!r}; it needs a number")
            if key in ("weight", "margin", "soft_linear") and min(values) < 0.0:
                raise UserError(f"{where}: {key} is {min(values):g}; it must be at least 0")
        for key in ("hard", "final"):
            if not isinstance(getattr(self, key), bool):
                raise UserError(f"{where}: {key} is {getattr(self, key)!r}; it must be true or false")
        if not self.soft_quadratic > 0.0:
            raise UserError(f"{where}: soft_quadratic is {self.soft_quadratic:g}; it must be above 0")
        if not self.low < self.high:
            raise UserError(f"{where}: low {self.low:g} is not below high {self.high:g}")
        if not (self.bounded or np.any(self.weight) or np.any(self.price)):
            raise UserError(f"{where}: has no effect; give it a weight, a price or a bound")

    @property
    def bounded(self) -> bool:
        return math.isfinite(self.low) or math.isfinite(self.high)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)


def terms_of(given: Any) -> tuple[StageTerm, ...]:
    """Terms from terms, from mappings of their fields, or from a mapping {name: fields or formula}."""
    if isinstance(given, Mapping):
        fields = {name: {"value": item} if isinstance(item, str) else item for name, item in given.items()}
        given = [
            {"name": name, **item} if isinstance(item, Mapping) else {"name": name} for name, item in fields.items()
        ]
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise UserError(f"mpc: terms is {given!r}; give {{name: {{value: formula, price: 1.0}}}}")
    found = tuple(_term(item) for item in given)
    names = [term.name for term in found]
    if len(set(names)) < len(names):
        raise UserError(f"mpc: term {next(n for n in names if names.count(n) > 1)} is there twice")
    return found


def _term(item: Any) -> StageTerm:
    if isinstance(item, StageTerm):
        return item
    known = tuple(StageTerm.__dataclass_fields__)
    if not isinstance(item, Mapping) or not {"name", "value"} <= {*item}:
        raise UserError(f"mpc: term {item!r} needs a name and a formula, such as power: {{value: force * speed}}")
    if wrong := [str(key) for key in item if key not in known]:
        raise UserError(f"mpc: term {item['name']}: unknown key {wrong[0]!r}: {errors.known(wrong[0], known)}")
    return StageTerm(**item)


def with_terms(system: System, terms: Sequence[StageTerm], stage: Sequence[str], *, curvature: bool = False) -> System:
    """The system with the terms behind its outputs; the system itself where there are none."""
    if not terms:
        return system
    pairs = tuple((term.name, term.value) for term in terms)
    return StageValues(physics=system, formulas=pairs, stage=tuple(stage), curvature=curvature)


def check_terms(system: System, terms: Sequence[StageTerm], stage: Sequence[str]) -> None:
    """Raise UserError for a formula that can't be evaluated or that no plan moves, and for a hard bound on more than
    inputs; warn where two bounds contradict each other.
    """
    if not terms:
        return
    try:
        moving = depend_on(with_terms(system, terms, stage), len(system.inputs))[len(system.outputs) :]
    except NotFiniteError as error:
        raise UserError(
            f"mpc: term {error.name} is not finite where states and inputs are zero; keep divisors, roots and "
            "logarithms from zero, such as by sqrt(x**2 + 1e-6)"
        ) from error
    if not _has_derivatives(system, terms, stage):
        culprit = next((term for term in terms if not _has_derivatives(system, [term], stage)), terms[0])
        raise UserError(
            f"mpc: term {culprit.name} has no finite derivatives where states and inputs are zero; keep roots, "
            "distances and angles from there, such as by sqrt(x**2 + y**2 + 1e-6)"
        )
    for term, (by_states, by_inputs) in zip(terms, moving, strict=True):
        if not (by_states or by_inputs):
            raise UserError(f"mpc: term {term.name}: {term.value} has neither states nor inputs, so no plan moves it")
        if term.hard and by_states:
            raise UserError(
                f"mpc: term {term.name}: a hard bound is for inputs alone, and {term.value} has states; make it soft"
            )
    for term, other in permutations(terms, 2):
        if term.value == other.value and term.low > other.high and not (term.hard and other.hard):
            warn(
                f"mpc: the bounds of {term.name} and {other.name} contradict each other: {term.value} is to be at "
                f"least {term.low:g} and at most {other.high:g}, so every plan is beyond one of them"
            )


def _has_derivatives(system: System, terms: Sequence[StageTerm], stage: Sequence[str]) -> bool:
    """Whether second derivatives are finite where states and inputs are zero."""
    try:
        trace.output_of(with_terms(system, terms, stage, curvature=True))
    except NotFiniteError:
        return False
    return True


def check_hard(
    system: System, terms: Sequence[StageTerm], stage: Sequence[str], values: Array, low: Numbers, high: Numbers
) -> None:
    """Raise UserError for hard bounds between which no input (m,) from low to high is left at a stage, and name the
    fewest; warn where that is a guess. values (N, q): of the stage's parameters.
    """
    if not any(term.hard for term in terms):
        return
    output, m, first = symbolic_output(with_terms(system, terms, stage)), len(system.inputs), len(system.outputs)
    last, box = len(values), (np.array(low), np.array(high))
    sound = set[Any]()
    for number, row in enumerate(values.tolist(), 1):
        hard = tuple(k for k, term in enumerate(terms) if term.hard and (number == last or not term.final))
        if (hard, *row) in sound:
            continue
        sound.add((hard, *row))
        left = partial(_left_between, values_by_inputs(output, m, row), terms, first, box)
        beyond = left(hard).beyond
        if beyond == 0.0:
            continue
        for group in (*combinations(hard, 1), *combinations(hard, 2), hard):
            if left(group).certain:
                raise UserError(
                    f"mpc: the hard bounds of {_named(terms, group)} leave no input at stage {number}, within those of "
                    "the inputs; widen them, or make one soft"
                )
        warn(
            f"mpc: the hard bounds of {_named(terms, hard)} perhaps leave no input at stage {number}, within those of "
            f"the inputs: none was found, and the nearest is {beyond:.3g} beyond one of them; widen them, or make one "
            "soft"
        )
        return  # one guess is enough: each takes a while


def _named(terms: Sequence[StageTerm], group: Sequence[int]) -> str:
    return " and ".join(terms[k].name for k in group)


def _left_between(
    found: InputValues, terms: Sequence[StageTerm], first: int, box: tuple[Array, Array], group: Sequence[int]
) -> Nearest:
    """Whether inputs within a box keep the bounds of a group of terms, whose values begin at the row ``first``."""
    rows = [first + k for k in group]
    least, most = (np.array([getattr(terms[k], side) for k in group]) for side in ("low", "high"))
    if not all(found.affine[row] for row in rows):
        return nearest(found.function, rows, box, (least, most))
    lower, upper = (
        np.clip([*end, *(side - found.at[rows])], -FAR, FAR) for end, side in zip(box, (least, most), strict=True)
    )
    m = len(box[0])
    flag = daqp.solve(np.eye(m), np.zeros(m), found.by[rows], upper, lower)[2]
    return Nearest(float(flag == INFEASIBLE), flag == INFEASIBLE)

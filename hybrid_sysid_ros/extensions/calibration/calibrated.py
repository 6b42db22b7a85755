"""Calibrated systems: physics with sensors whose gain, offset, delay and window are parameters."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Parameter, RecordMap, System
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.sensing import Sensing
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.models.structure import Magnitudes, Option, Options
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

QUANTITIES = {
    "gain": "Reading of the sensor over what is there",
    "offset": "Constant in the sensor's readings",
    "delay": "Age of a reading",
    "window": "Time over which a reading is a mean",
}
NOMINAL = {"gain": 1.0, "offset": 0.0, "delay": 0.0, "window": 0.0}
WIDEST = 10.0
"""Bounds of a parameter about its centre, in prior deviations."""
LEAST_GAIN = 0.01


@dataclass(frozen=True, kw_only=True)
class Free:
    """A number of a sensor that is fitted."""

    output: str
    quantity: str
    """One of QUANTITIES."""
    centre: float
    """Mean of its prior, at which a fit begins."""
    spread: float
    """Deviation of its prior, in its unit."""

    @property
    def name(self) -> str:
        return f"{self.output}_{self.quantity}"


@dataclass(frozen=True, kw_only=True)
class Calibrated(Wrapper):
    """r = g y(x, u) + b of each output, late and as a mean in runs (:mod:`~hybrid_sysid_ros.core.sensing`).

    Raises UserError where a name is that of a parameter of the physics.
    """

    free: tuple[Free, ...]
    numbers: tuple[float, ...]
    """Values of the free numbers."""
    lags: tuple[tuple[float, float], ...]
    """Delay and window of each output [s] as the rig's file declares them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("features", "closures", "operating_point"):
            object.__setattr__(self, name, getattr(self.physics, name))
        taken = {item.name for item in self.physics.parameters}
        if twice := [item.name for item in self.free if item.name in taken]:
            raise UserError(f"{twice[0]}: the rig's law has a parameter of that name; rename it in system.py")

    @property
    def form(self) -> tuple[Any, ...]:
        places = tuple((item.name, self._own(item.output, item.quantity) is not None) for item in self.free)
        return (type(self), self.physics.form, places)

    @property
    def design(self) -> dict[str, Any]:
        own = [[item.output, item.quantity, item.centre, item.spread] for item in self.free]
        return {**(self.physics.design or {}), "sensors": own, "lags": [list(item) for item in self.lags]}

    # ------------------------------------------------------------------ numbers

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*self.physics.parameters, *self._sensors)

    @cached_property
    def _sensors(self) -> tuple[Parameter, ...]:
        units, found = {item.name: item.unit for item in self.outputs}, []
        for item in self.free:
            least = {"gain": LEAST_GAIN, "offset": -np.inf}.get(item.quantity, 0.0)
            reach = WIDEST * item.spread
            found.append(
                Parameter(
                    name=item.name,
                    unit={"gain": "1", "offset": units[item.output]}.get(item.quantity, "s"),
                    low=max(least, item.centre - reach),
                    high=item.centre + reach,
                    start=item.centre,
                    spread=item.spread,
                    description=f"{QUANTITIES[item.quantity]}.",
                )
            )
        return tuple(found)

    @property
    def values(self) -> Array:
        return np.concatenate([self.physics.values, np.array(self.numbers, dtype=float)])

    def bound(self, values: Sequence[Scalar]) -> Calibrated:
        count = len(self.physics.parameters)
        return replace(self, physics=self.physics.bound(values[:count]), numbers=tuple(values[count:]))

    def _own(self, output: str, quantity: str) -> Any:
        """A free number, or None."""
        for item, value in zip(self.free, self.numbers, strict=True):
            if (item.output, item.quantity) == (output, quantity):
                return value
        return None

    def _linear(self) -> Iterator[tuple[Any, Any]]:
        """Gain and offset of each output."""
        for item in self.outputs:
            gain, offset = self._own(item.name, "gain"), self._own(item.name, "offset")
            yield 1.0 if gain is None else gain, 0.0 if offset is None else offset

    @property
    def sensing(self) -> Sensing:
        lags, known, moved = np.zeros((len(self.outputs), 2)), np.zeros(len(self.outputs), dtype=bool), []
        for k, (item, declared) in enumerate(zip(self.outputs, self.lags, strict=True)):
            own = [self._own(item.name, quantity) for quantity in ("delay", "window")]
            known[k] = own != [None, None]
            if known[k]:
                lags[k] = [value if value is not None else given for value, given in zip(own, declared, strict=True)]
            names = [f"{item.name}_{quantity}" for quantity in ("delay", "window")]
            late, mean = (name if value is not None else "" for name, value in zip(names, own, strict=True))
            moved.append((late, mean))
        spreads = np.zeros((len(self.outputs), len(QUANTITIES)))
        places = {item.name: k for k, item in enumerate(self.outputs)}
        for one in self.free:
            spreads[places[one.output], list(QUANTITIES).index(one.quantity)] = one.spread
        return Sensing(
            names=tuple(item.name for item in self.free),
            delays=lags[:, 0],
            windows=lags[:, 1],
            known=known,
            moved_by=tuple(moved),
            spreads=spreads,
        )

    # ------------------------------------------------------------------ the equation

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        plain = super().output(x, u)
        pairs = zip(plain, self._linear(), self.outputs, strict=True)
        return [gain * y + offset if self._scaled(item.name) else y for y, (gain, offset), item in pairs]

    def _scaled(self, output: str) -> bool:
        return self._own(output, "gain") is not None or self._own(output, "offset") is not None

    @property
    def plain_outputs(self) -> bool:
        return self.physics.plain_outputs and not any(self._scaled(item.name) for item in self.outputs)

    def feature(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.physics.feature(x, u)

    def closure(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.physics.closure(x, u)

    def corrected(self, more: Callable[[Sequence[Scalar], Sequence[Scalar]], Sequence[Scalar]]) -> System:
        changed = copy.copy(self)
        object.__setattr__(changed, "physics", self.physics.corrected(more))
        return changed

    def record_map(self) -> RecordMap:
        """The map of the physics from what is there: readings without gain and offset, carried on by their lag."""
        own, sensing = super().record_map(), self.sensing
        gains, offsets = (np.array([float(value) for value in column]) for column in zip(*self._linear(), strict=True))
        lag = sensing.delays + 0.5 * sensing.windows

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            there = (outputs - offsets + lag * rates) / gains
            return own.states_from_record(there, rates / gains, inputs)

        return replace(own, states_from_record=states_from_record)


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Sensors as options of a gray box: NAME_gain, NAME_offset, NAME_delay and NAME_window of each output."""

    def options(self, physics: System) -> dict[str, Option]:
        """The options, each a prior deviation, which is 0 where the number is no parameter."""
        found = {}
        for item in physics.outputs:
            for quantity, words in QUANTITIES.items():
                unit = {"gain": "", "offset": f" [{item.unit}]"}.get(quantity, " [s]")
                found[f"{item.name}_{quantity}"] = Option(
                    default=0.0,
                    low=0.0,
                    high=1e9,
                    kind="float",
                    description=f"Prior deviation{unit}: {words[0].lower()}{words[1:]}; 0: it is not fitted.",
                    searched=False,
                )
        return found

    def wrapped(self, system: System, options: Options, sizes: Magnitudes) -> System:
        """A gray box with the sensors that options free, which begin as the rig's file declares them."""
        lags = tuple((sensor.delay, sensor.window) for sensor in sizes.sensors) or ((0.0, 0.0),) * len(system.outputs)
        free = []
        for item, (delay, window) in zip(system.outputs, lags, strict=True):
            centres = {**NOMINAL, "delay": delay, "window": window}
            for quantity, centre in centres.items():
                if spread := float(options.get(f"{item.name}_{quantity}", 0.0)):
                    free.append(Free(output=item.name, quantity=quantity, centre=centre, spread=spread))
        return self._of(system, tuple(free), lags)

    def stored(self, system: System, design: Mapping[str, Any]) -> System:
        """A gray box of a stored model. Raises UserError for sensors that it has not."""
        rows, lags = design.get("sensors", ()), design.get("lags", ())
        known = {item.name for item in system.outputs}
        free = tuple(Free(output=a, quantity=b, centre=float(c), spread=float(d)) for a, b, c, d in rows)
        if free and (len(lags) != len(known) or any(item.output not in known for item in free)):
            raise UserError("its sensors are not those of the rig; fit again")
        if any(item.quantity not in QUANTITIES for item in free):
            raise UserError(f"a sensor has {', '.join(QUANTITIES)}, and its design another one; fit again")
        return self._of(system, free, tuple((float(a), float(b)) for a, b in lags))

    @staticmethod
    def _of(system: System, free: tuple[Free, ...], lags: tuple[tuple[float, float], ...]) -> System:
        if not free:
            return system
        return Calibrated(physics=system, free=free, numbers=tuple(item.centre for item in free), lags=lags)

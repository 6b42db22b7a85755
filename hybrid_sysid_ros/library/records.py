"""Records from bags and from arrays."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import UNIFORMITY, Record
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.library import arguments
from hybrid_sysid_ros.library.arguments import RigLike
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.plausibility import check_limits, check_travel, slowness, spikes, strangeness
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.units import factor_of
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, shown
from hybrid_sysid_ros.support.files import path_of

Doubtful = Callable[[str], object]
"""Receives doubtful values of a record."""


def load_rig(rig: str | Path) -> Rig:
    """Load a rig.

    rig: a name that ``hybrid-sysid rig list`` shows, or the path of a folder, such as "./my_rig", whose Python then
    runs with your rights, and is read again where it was edited since the last call. Raises UserError where there is no
    such rig, or a file of it is wrong.
    """
    return arguments.rig_of(rig, load=rigs.reload)


def read_bag(
    path: str | Path,
    rig: RigLike,
    *,
    signals: str | Path | None = None,
    period: float = 0.0,
    recover: bool = False,
) -> Record:
    """Read a record from a bag: a rosbag2 folder, or one MCAP or SQLite file. ROS need not be installed.

    rig: the rig, which declares the topics and fields of inputs and outputs. signals: YAML file that declares others.
    period: keep one sample in so many seconds, 0 for all. recover: read the readable part of a cut bag. Doubtful values
    give a warning. Raises UserError for a bag that is missing, damaged, or does not fit the rig.
    """
    described, place = arguments.rig_of(rig), path_of(path, "path")
    chosen = None if signals is None else path_of(signals, "signals")
    kept = arguments.number_of(period, "period", low=0.0, unit="s")
    cut = arguments.flag_of(recover, "recover")
    if not os.path.exists(place):
        raise UserError(f"path is {shown(path)}, which is not there; give the path of a bag")
    if chosen is not None and not os.path.isfile(chosen):
        raise UserError(f"signals is {shown(signals)}, which is no file; give a YAML file of signals")
    return checked_bag(place, described, signals=chosen, period=kept, recover=cut, doubtful=_warn)


def checked_bag(
    path: Path,
    rig: Rig,
    *,
    signals: Path | None,
    period: float,
    recover: bool,
    doubtful: Doubtful,
    model: Model | None = None,
) -> Record:
    """The record of a bag; ``doubtful`` receives its doubtful values. model: the model that is scored on it. Raises
    UserError for signals in another unit than the rig's, and for inputs that its actuators can't give.
    """
    found = Signals.load(signals) if signals is not None else rig.signals
    found = found.ordered(rig.system.inputs, rig.system.outputs)
    record = replace(bags.read(path, found, period=period or None, recover=recover), rig=rig.name)
    check_limits(record, rig, found)
    strange = [] if model is None else strangeness(record, model, rig, found)
    for line in (*slowness(record, rig), *spikes(record, rig, found), *strange):
        doubtful(line)
    return record


def record(
    *,
    time: ArrayLike,
    inputs: ArrayLike | Mapping[str, ArrayLike],
    outputs: ArrayLike | Mapping[str, ArrayLike],
    rig: RigLike | None = None,
    units: Mapping[str, str] | None = None,
    channels: Mapping[str, ArrayLike] | None = None,
    name: str = "arrays",
) -> Record:
    """Make a record from arrays.

    time: (samples,) in seconds, uniform; it may begin anywhere. inputs: (samples, m), one column alone as (samples,),
    or a mapping of columns by the rig's names; inputs[k] acts from time[k] to time[k + 1]. outputs: (samples, p)
    likewise, measured at time[k]. rig: the rig that has these inputs and outputs, whose actuators and travel they must
    fit. units: units of columns by name, where they are not the rig's, such as {"position": "mm"}; an output may also
    be in the unit of its sensor's readings. channels: further signals by name, (samples,) each. name: name of the
    record in tables.

    Raises UserError for another shape, unit or size than the rig's, for values that are not finite, and uneven times.
    """
    described = None if rig is None else arguments.rig_of(rig)
    times = _times(time)
    names: dict[str, list[str]] = {"inputs": [], "outputs": []}
    if described is not None:
        names = {kind: [item.name for item in getattr(described.system, kind)] for kind in names}
    u = arguments.given_columns(inputs, "inputs", names["inputs"], len(times))
    y = arguments.given_columns(outputs, "outputs", names["outputs"], len(times))
    if units is not None:
        u, y = (values * scales for values, scales in zip((u, y), _scales(units, described), strict=True))
    found = Record(
        name=arguments.name_of(name, "name"),
        time=times,
        input=u,
        output=y,
        channels={
            arguments.name_of(key, "a name in channels"): arguments.given_columns(
                value, f"channels[{key!r}]", [key], len(times)
            )[:, 0]
            for key, value in arguments.mapping_of(channels, "channels", '{"speed": speed}').items()
        },
        rig="" if described is None else described.name,
    )
    if described is not None:
        check_limits(found, described)
        check_travel(found, described)
        for line in (*slowness(found, described), *spikes(found, described)):
            _warn(line)
    return found


def _times(value: ArrayLike) -> Array:
    """Times from 0 on, exactly uniform."""
    times = arguments.array_of(value, "time")
    if times.ndim != 1 or len(times) < 2:
        raise UserError(f"time has shape {times.shape}; it needs (samples,), with 2 samples or more")
    step = (times[-1] - times[0]) / (len(times) - 1)
    uniform = np.arange(len(times)) * step
    away = np.abs(times - times[0] - uniform)
    kind = np.asarray(value).dtype
    spacing = float(np.spacing(np.abs(times).max().astype(kind if kind.kind == "f" else np.float64)))
    rounding = 4.0 * spacing  # of stamps since 1970, or of single precision
    if spacing > 0.1 * step >= 0.0:
        raise UserError(
            f"time has the precision {kind.name}, which tells values near {times[0]:.9g} s apart by {spacing:.3g} s "
            "only; give it in double precision (float64), or let it begin at 0"
        )
    if not step > 0.0:
        raise UserError(
            f"time runs from {times[0]:.9g} s to {times[-1]:.9g} s, backwards; sort the samples by their time"
        )
    if away.max() > UNIFORMITY * step + rounding:
        worst = int(np.argmax(away))
        raise UserError(
            f"time is not uniform at sample {worst}: {times[worst]:.9g} s, where steps of {step:.6g} s lead to "
            f"{times[0] + uniform[worst]:.9g} s; interpolate the signals to even times"
        )
    return uniform


def _scales(units: Mapping[str, str], rig: Rig | None) -> tuple[Array, Array]:
    """What each input and each output is multiplied by, (m,) and (p,)."""
    if rig is None:
        raise UserError("units need a rig that they can be held against; give rig, too")
    given = arguments.mapping_of(units, "units", '{"position": "mm"}')
    inputs = {item.name: (item.unit, item.unit, 1.0) for item in rig.system.inputs}
    pairs = zip(rig.system.outputs, rig.display, strict=True)
    outputs = {item.name: (item.unit, display.unit, display.scale) for item, display in pairs}
    for name in given:
        arguments.choice_of(name, "a name in units", [*inputs, *outputs])

    def factor(name: str, own: str, read: str, scale: float) -> float:
        unit = given.get(name, own)
        if not isinstance(unit, str) or (found := scale if unit == read else factor_of(unit, own)) is None:
            known = " or ".join(dict.fromkeys((own, read)))
            raise UserError(f"units of {name} is {shown(unit)}; {rig.name} takes {known}: convert the values")
        return found

    scales = ([factor(name, *of) for name, of in items.items()] for items in (inputs, outputs))
    return np.array(next(scales)), np.array(next(scales))


def _warn(line: str) -> None:
    """Warn at the caller of a public function of this file."""
    warnings.warn(line, stacklevel=4)

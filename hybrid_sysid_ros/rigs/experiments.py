"""Simulated experiments on a rig, as bags of the same shape as real ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags import Series, joint_states, joint_trajectories, markers, write_bag
from hybrid_sysid_ros.rigs.feedback import Follower
from hybrid_sysid_ros.rigs.plant import Measurement, Plant
from hybrid_sysid_ros.rigs.rig import BEYOND, Rig
from hybrid_sysid_ros.rigs.signal_file import SUFFIX, driving_columns, is_signal_file, read_signals
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder

START = 1_000_000_000
"""Stamp of the first sample [ns]: zero means "no time yet" to ROS."""
USUAL = 40.0
"""Length of an experiment whose length nothing says [s]."""
SEEDS = 7919
"""Difference between the seeds of the inputs' excitations."""


def excitation(rig: Rig, name: str, *, seed: int, duration: float, times: Array) -> Array:
    """The signals of one of a rig's experiments, or of a file of signals (.csv), [SI]: those of the inputs, or of
    their loops' references. For a rig with a feedback they are added to the inputs, and the commands come behind them,
    (times, inputs + followed).

    Raises UserError for an experiment that the rig lacks, and a file that does not fit it.
    """
    known = rig.experiments.excitations
    feedback = rig.experiments.feedback
    followed = feedback.followed if feedback else ()
    signals = np.zeros((len(times), len(rig.actuators) + len(followed)))
    if is_signal_file(name):
        columns = driving_columns(rig)
        given = read_signals(name, columns)
        signals[:] = np.stack([given.held(column, times) for column, _ in columns], axis=-1)
    elif name not in known:
        raise UserError(
            f"experiment {name!r} is unknown to {rig.file}; choose one of {', '.join(known) or 'none'}, or a file "
            f"of signals ({SUFFIX})"
        )
    else:
        for index, chosen in known[name].items():
            signals[:, index] = chosen.signal(seed=seed + SEEDS * index, duration=duration)(times)
    for index, loop in rig.experiments.loops.items():
        signals[:, index] *= rig.sensors[loop.output].scale
    for column, output in enumerate(followed, start=len(rig.actuators)):
        signals[:, column] *= rig.sensors[output].scale
    return signals


def duration_of(rig: Rig, name: str) -> float:
    """Length of an experiment [s]: of a file of signals its own, else :data:`USUAL`."""
    return read_signals(name, driving_columns(rig)).duration if is_signal_file(name) else USUAL


def driven(plant: Plant, wanted: Array) -> Iterator[Array]:
    """Drive a plant through an experiment; yield the inputs (inputs,) of each step after it.

    wanted (steps, signals): the result of :func:`excitation`. Inputs are within the actuators' limits, and an integral
    part stops at them.
    """
    commanded = _followed(plant, wanted) if plant.rig.experiments.feedback else _looped(plant, wanted)
    for inputs in commanded:
        plant.advance(inputs)
        yield np.array(plant.applied)


def _looped(plant: Plant, wanted: Array) -> Iterator[Array]:
    """Commands (inputs,) of each step, where inputs have loops of their own or none."""
    rig = plant.rig
    integrals = np.zeros(len(rig.actuators))
    for row in wanted:
        shown, inputs = plant.measure(), np.empty(len(row))
        for index, actuator in enumerate(rig.actuators):
            value, loop = float(row[index]), rig.experiments.loops.get(index)
            if loop is not None:
                error = float((value - shown.filtered[loop.output]) / rig.sensors[loop.output].scale)
                value = loop.gain * error + integrals[index]
                if actuator.low <= value <= actuator.high:  # else it would wind up
                    integrals[index] += loop.gain * loop.integral * error * rig.step
            inputs[index] = actuator.bounded(value)
        yield inputs


def _followed(plant: Plant, wanted: Array) -> Iterator[Array]:
    """Commands (inputs,) of each step under the rig's feedback, held over its period."""
    rig, count = plant.rig, len(plant.rig.actuators)
    feedback = rig.experiments.feedback
    assert feedback is not None
    every = rig.steps(feedback.period, f"{rig.file}: experiments.feedback.period")
    follower, inputs = Follower(feedback, rig.limits), np.zeros(count)
    for k, row in enumerate(wanted):
        if k % every == 0:
            inputs = follower.answer(plant.measure().filtered, row[count:], row[:count])
        yield inputs


def simulate_experiment(
    rig: Rig,
    kind: str,
    out: Path,
    *,
    seed: int,
    duration: float,
    rate: float,
    overwrite: bool = False,
    disturbed: bool = True,
    watch: Callable[[Plant], object] = lambda plant: None,
) -> Path:
    """Drive the simulated rig through an experiment as the real one is driven, and write the bag.

    rate: rate of the bag's samples [Hz]; each has the mean inputs since the previous one. disturbed: see
    :class:`~.plant.Plant`. watch: a function that is called at the beginning and after each of the rig's steps.

    Raises UserError for a rate that does not divide the rig's, an experiment that the rig lacks, one in which a state
    grows beyond :data:`BEYOND`, and a place that can't be written.
    """
    every = rig.steps(1.0 / rate, f"rate {rate:g} Hz: its period")
    check_folder(out, marker=markers(out), replace=overwrite)
    samples = round(duration * rate) + 1
    times = np.arange((samples - 1) * every + 1, dtype=np.float64) * rig.step
    wanted = excitation(rig, kind, seed=seed, duration=duration, times=times)
    plant = Plant(rig, seed=seed, bias=rig.bias, disturbed=disturbed)
    watch(plant)
    steps = _watched(driven(plant, wanted), lambda: watch(plant))
    shown, applied = [plant.measure()], [np.zeros(len(rig.actuators))]
    for _ in range(samples - 1):
        applied.append(sum(islice(steps, every), start=np.zeros(len(rig.actuators))) / every)
        shown.append(plant.measure())
        if not np.all(np.abs(np.append(plant.state, shown[-1].outputs)) < BEYOND):
            raise UserError(
                f"experiment {kind}: the simulated {rig.name} grows beyond all numbers, or its output is none, at "
                f"{plant.time:.3g} s; hold it by experiments.loops, or experiments.feedback, in {rig.file}"
            )
    stamps = START + np.round(np.arange(samples) / rate * 1e9).astype(np.int64)
    bias = ", ".join(f"{value:g} {item.unit}" for value, item in zip(rig.bias, rig.system.inputs, strict=True))
    made_by = f"simulated {rig.name}, {kind}, seed {seed}, {duration:g} s at {rate:g} Hz, bias {bias}"
    if rig.disturbances and not disturbed:
        made_by += ", undisturbed"
    series = [_measurements(rig, stamps, shown, np.array(applied))]
    if rig.experiments.loops or rig.experiments.feedback:
        series.append(_references(rig, stamps, wanted[::every]))
    return write_bag(out, series, replace=overwrite, notes={"made_by": made_by})


def _watched(steps: Iterator[Array], watch: Callable[[], object]) -> Iterator[Array]:
    for inputs in steps:
        watch()
        yield inputs


def _measurements(rig: Rig, stamps: NDArray[np.int64], shown: list[Measurement], applied: Array) -> Series:
    """The messages joint_states: outputs and inputs in the joints' fields, then the low-pass filtered outputs."""
    outputs = [item.name for item in rig.system.outputs]
    second = rig.joints.filtered(outputs, rig.sensors)
    names = [*rig.joints.names, *second.values()]
    fields = {key: np.full((len(stamps), len(names)), np.nan) for key in ("position", "velocity", "effort")}
    for index, name in enumerate(outputs):
        joint, field = rig.joints.place(name)
        fields[field][:, names.index(joint)] = [item.outputs[index] for item in shown]
        if rig.sensors[index].low_pass:
            fields[field][:, names.index(second[joint])] = [item.filtered[index] for item in shown]
    for index, item in enumerate(rig.system.inputs):
        joint, _ = rig.joints.place(item.name)
        fields["effort"][:, names.index(joint)] = applied[:, index]
    carried: dict[str, Any] = {key: values for key, values in fields.items() if np.isfinite(values).any()}
    return joint_states(f"/{rig.namespace}/joint_states", stamps, names, **carried)


def _references(rig: Rig, stamps: NDArray[np.int64], wanted: Array) -> Series:
    """The references of loops or feedback, one point for each message."""
    columns = {index: loop.output for index, loop in rig.experiments.loops.items()}
    if rig.experiments.feedback:
        columns = dict(enumerate(rig.experiments.feedback.followed, start=len(rig.actuators)))
    places = {column: rig.joints.place(rig.system.outputs[output].name) for column, output in columns.items()}
    names = list(dict.fromkeys(joint for joint, _ in places.values()))
    fields = {f: np.full((len(stamps), 1, len(names)), np.nan) for f in dict.fromkeys(f for _, f in places.values())}
    for column, (joint, field) in places.items():
        fields[field][:, 0, names.index(joint)] = wanted[:, column]
    plural = {"position": "positions", "velocity": "velocities"}
    given: dict[str, Any] = {plural[field]: values for field, values in fields.items()}
    return joint_trajectories(f"/{rig.namespace}/reference", stamps, names, times=[0.0], **given)

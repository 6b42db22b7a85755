"""Checks of a rig: what is wrong with it, as lines for its author."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import Sensitivities, System, one_step, rollouts
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.extensions.checks.transition import transition_of
from hybrid_sysid_ros.rigs.experiments import driven, excitation
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import LowPassFilter
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

POINTS = 300
"""Points of the grid of states and inputs."""
SECONDS, FEWEST_STEPS, MOST_STEPS = 4.0, 256, 20_000
"""Length of the experiment [s], and its least and most steps; the grid covers twice the range of its states."""
WINDOWS = 8
"""Windows of that experiment in which the outputs must determine the states."""
FORMS_AGREE = 1e-9
"""Largest relative difference between the compiled and the CasADi form."""
BLIND = 1e-9
"""Ratio of the least to the greatest effect of a state on the outputs, below which a state counts as unobservable."""
GROWTH = 1e-3
"""Growth rate [1/s], or of steps longer than a second per step, above which a linearised system is unstable."""
WOULD_SHOW = 4.0
"""Growth over the experiment, as a power of e, that a held rig would show if it were one that nothing stops."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What a check found."""

    problems: list[str]
    """Faults that must be corrected, a line each."""
    remarks: list[str]
    """Remarks for the author, a line each."""


def check(rig: Rig) -> Findings:
    """Check a rig's equations, sensors, actuators and experiments."""
    where = f"{rig.folder}/system.py"
    problems = list(_at_origin(rig.system, where))
    for name, other in rig.structures.items():
        problems += (f"{where}: structure {name}: {line.partition(': ')[2]}" for line in _at_origin(other, where))
    if problems:
        return Findings(problems=problems, remarks=[])
    problems, remarks = list(_values(rig)), list(_remarks(rig.system))
    states, inputs = _experiment(rig)
    steady = np.isfinite(states).all(axis=1)
    magnitudes = np.maximum(np.max(np.abs(states[steady]), axis=0), 1e-6)
    if growing := list(_growing(rig, states, magnitudes, where)):
        problems += growing
    elif not steady.all():
        problems.append(f"{where}: the states grow beyond all numbers in the experiments of {rig.file.name}")
    else:
        problems += (*_on_grid(rig, magnitudes, where), *_blind(rig, states, inputs, magnitudes, where))
        remarks += _reached(rig, states)
    return Findings(problems=problems, remarks=remarks)


def _at_origin(system: System, where: str) -> Iterator[str]:
    """Lines where a step or the outputs fail, or are not finite at rest."""
    try:
        system.step_context()
        x, u = np.zeros(len(system.states)), np.zeros(len(system.inputs))
        following, outputs = one_step(system, x, u, step=1e-3), output_of(system, x, u)
        system.check()
    except UserError as error:
        yield f"{where}: {error}"
        return
    for item, value in zip((*system.states, *system.outputs), (*following, *outputs), strict=True):
        if not np.isfinite(value):
            yield f"{where}: {item.name} is {value:g} a step from the origin; bound what it is divided or rooted by"
    names = [item.name for item in system.states]
    for position, velocity in system.kinematics.items():
        if any(contact.on == names[position] for contact in system.contacts):
            yield f"{where}: a contact is on {names[position]}; friction acts on its velocity, {names[velocity]}"


def _values(rig: Rig) -> Iterator[str]:
    """Lines for names and numbers in rig.yaml that can't be right."""
    joints, inputs = rig.joints.joints, [rig.joints.place(item.name)[0] for item in rig.system.inputs]
    carried = {name for joint in joints.values() for name in (joint.position, joint.velocity)}
    for name in dict.fromkeys(item.name for item in (*rig.system.states, *rig.system.outputs)):
        if name not in carried and name in (*joints, *inputs):
            yield f"{rig.file}: joints: {name} is a joint or an input, and a state that it does not carry: rename one"
    for item, sensor in zip(rig.system.outputs, rig.sensors, strict=True):
        where = f"{rig.file}: sensors.{item.name}"
        if sensor.low_pass is not None:
            radius = np.max(np.abs(np.linalg.eigvals(LowPassFilter(sensor.low_pass, rig.step).transition)))
            if radius >= 1.0:
                yield f"{where}.low_pass: is unstable at a step of {rig.step:g} s; make the step or its hertz smaller"
        if sensor.hum is not None and sensor.hum.hertz > 0.5 / rig.step:
            yield f"{where}.hum: {sensor.hum.hertz:g} Hz can't be shown at a step of {rig.step:g} s; make it smaller"
    for item, value, actuator in zip(rig.system.inputs, rig.bias, rig.actuators, strict=True):
        if abs(value) > actuator.high - actuator.low:
            yield f"{rig.file}: nodes.plant.bias: {value:g} {item.unit} is more than the range of {item.name}"
    for name, chosen in rig.experiments.excitations.items():
        for index, signal in chosen.items():
            if index >= len(rig.actuators):
                continue  # a command of an output
            item, actuator = rig.system.inputs[index], rig.actuators[index]
            problem = "" if index in rig.experiments.loops else signal.beyond(actuator.low, actuator.high)
            if problem:
                yield (
                    f"{rig.file}: experiments.excitations.{name}: {problem} is beyond what {item.name} may be, "
                    f"{actuator.low:g} to {actuator.high:g} {item.unit}; make it smaller"
                )

    low, high = rig.travel_of_outputs / np.array([display.scale for display in rig.display])
    for name, schedule in rig.references.items():
        for segment in schedule.segments:
            ends = sorted((low[segment.output], high[segment.output]))
            if problem := segment.excitation.beyond(*ends):
                yield (
                    f"{rig.file}: references.{name}.segments.{segment.name}: {problem} is beyond the travel, "
                    f"{ends[0]:g} to {ends[1]:g} {rig.display[segment.output].unit}; make it smaller"
                )


def _remarks(system: System) -> Iterator[str]:
    """Lines for missing units, and for delays that differ."""
    names = [item.name for item in (*system.states, *system.inputs, *system.outputs) if not item.unit]
    if names:
        yield f'{", ".join(dict.fromkeys(names))}: has no unit; write "angle [rad]", and [1] for plain numbers'
    if len({*system.input_delays}) > 1:
        yield "the delays of the inputs differ: a controller lets the faster ones wait for the slowest"


def _experiment(rig: Rig) -> tuple[Array, Array]:
    """States (steps + 1, states) of the noise-free rig in its first experiment, or under steps of its inputs where it
    has none, and the inputs (steps, inputs) that acted.
    """
    steps = min(max(round(SECONDS / rig.step), FEWEST_STEPS), MOST_STEPS)
    times = np.arange(steps, dtype=np.float64) * rig.step
    name = next(iter(rig.experiments.excitations), "")
    if name:
        wanted = excitation(rig, name, seed=0, duration=steps * rig.step, times=times)
    else:
        levels = np.random.default_rng(0).uniform(0.0, 1.0, (8, len(rig.actuators))).repeat(-(-steps // 8), axis=0)
        low, high = rig.limits
        wanted = low + (high - low) * levels
        if rig.experiments.feedback is not None:  # with commands of 0
            wanted = np.column_stack([wanted, np.zeros((len(wanted), len(rig.experiments.feedback.followed)))])
        for index, loop in rig.experiments.loops.items():
            wanted[:, index] *= rig.sensors[loop.output].scale
    plant = Plant(rig, seed=0, noisy=False)
    states, inputs = np.empty((steps + 1, len(rig.system.states))), np.empty((steps, len(rig.actuators)))
    states[0] = plant.state
    with np.errstate(all="ignore"):
        for k, inputs[k] in enumerate(driven(plant, wanted[:steps])):
            states[k + 1] = plant.state
    return states, inputs


def _growing(rig: Rig, states: Array, magnitudes: Array, where: str) -> Iterator[str]:
    """Lines for the fastest growing mode at rest, under the loops or the feedback of the experiments: a pole outside
    the unit circle, linearised with stick-slip rounded over the speeds of the experiment. An integrator has one on it.
    A mode that grows within a dead zone and not beyond it is none: the experiment shows that it is held.
    """
    names = [item.name for item in rig.system.states]
    rounding = max((magnitudes[names.index(contact.on)] for contact in rig.system.contacts), default=1.0)
    matrix, seconds, driver = transition_of(rig, float(rounding))
    # Of A - 1: a state that integrates has exact zeros there, which a chain of integrators needs.
    values, vectors = np.linalg.eig(matrix - np.eye(len(matrix)))
    growth = np.log(np.maximum(np.abs(1.0 + values), 1e-300)) / seconds
    fastest = int(np.argmax(growth))
    if growth[fastest] * max(rig.step, 1.0) > GROWTH:
        share = np.abs(vectors[: len(names), fastest]) / magnitudes
        grown = [index for index in range(len(names)) if share[index] > 0.3 * np.max(share)]
        if driver and _held_within(rig, states, grown) and growth[fastest] * (len(states) - 1) * rig.step > WOULD_SHOW:
            return
        remark = (
            f"unstable at the origin in {' and '.join(names[k] for k in grown)}, by e in {1 / growth[fastest]:.3g} s"
        )
        if driver:
            yield f"{rig.file}: experiments.{driver}: with them {remark}; change their gains"
        else:
            yield f"{where}: {remark}; give the experiments in {rig.file.name} loops or a feedback to hold it"


def _held_within(rig: Rig, states: Array, which: list[int]) -> bool:
    """Whether states (samples, states) stayed within the travel, and were in the last quarter of the experiment at
    most twice as large as before.
    """
    low, high = rig.travel[:, which]
    seen = states[:, which]
    if not np.all((low < seen) & (seen < high)):
        return False
    before, after = np.split(np.abs(seen), [3 * len(seen) // 4])
    return bool(np.all(np.max(after, axis=0) <= 2.0 * np.max(before, axis=0)))


def _on_grid(rig: Rig, magnitudes: Array, where: str) -> Iterator[str]:
    """Lines where steps or outputs over twice the experiment's range are not finite, or differ between both forms."""
    system, random = rig.system, np.random.default_rng(0)
    low, high = rig.limits
    points = 2.0 * magnitudes * random.uniform(-1.0, 1.0, (POINTS, len(magnitudes)))
    inputs = low + (high - low) * random.uniform(size=(POINTS, len(low)))
    functions = {"step": symbolic_step(system, step=rig.step), "output": symbolic_output(system)}
    for x, u in zip(points, inputs, strict=True):
        made = {"step": one_step(system, x, u, step=rig.step), "output": output_of(system, x, u)}
        for kind, values in made.items():
            named = system.states if kind == "step" else system.outputs
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                at = ", ".join(f"{item.name} {value:.3g}" for item, value in zip(system.states, x, strict=True))
                yield f"{where}: {named[bad[0]].name} is not finite at {at}; bound what it is divided or rooted by"
                return
            other = np.array(functions[kind](x, u)).ravel()
            scale = np.maximum(np.abs(values), np.max(np.abs(values)) + 1e-12)
            if np.max(np.abs(values - other) / scale) > FORMS_AGREE:
                yield f"{where}: the compiled {kind} differs from the CasADi form; it must give the same at each call"
                return


def _blind(rig: Rig, states: Array, inputs: Array, magnitudes: Array, where: str) -> Iterator[str]:
    """Lines for states that the outputs do not determine anywhere in the experiment."""
    system, sensitivities = rig.system, Sensitivities(rig.system)
    length = len(inputs) // WINDOWS
    starts = np.array([[0, k * length, length, k * length] for k in range(WINDOWS)])
    x0 = np.ascontiguousarray(states[: WINDOWS * length : length])
    out = np.empty((WINDOWS * length, len(system.outputs), sensitivities.count))
    sensitivities.rollouts(system, starts, x0, inputs, step=rig.step, every=1, out=out)
    begin = len(sensitivities.columns.parameters) + sensitivities.columns.weights
    effects = out[:, :, begin : begin + len(magnitudes)] * magnitudes
    _, outputs = rollouts(system, starts, x0, inputs, step=rig.step)
    effects /= (np.max(np.abs(outputs), axis=0) + 1e-12)[:, None]
    if not np.isfinite(effects).all():
        yield f"{where}: derivatives of the law are not finite in the experiment; smooth terms with an infinite slope"
        return
    _, values, directions = np.linalg.svd(effects.reshape(-1, len(magnitudes)), full_matrices=False)
    for value, direction in zip(values, directions, strict=True):
        if value <= BLIND * values[0]:
            names = [system.states[i].name for i in np.flatnonzero(np.abs(direction) > 0.3)]
            yield (
                f"{where}: the outputs do not determine {' and '.join(names)}: measure more, or leave out states that "
                "nothing depends on"
            )


def _reached(rig: Rig, states: Array) -> Iterator[str]:
    """Lines for outputs beyond their sensors' ranges, and for states that the inputs do not move."""
    for state, item in enumerate(rig.system.states):
        if np.ptp(states[:, state]) == 0.0:
            yield f"{item.name} does not move in the experiment"
    names = [item.name for item in rig.system.states]
    for item, sensor in zip(rig.system.outputs, rig.sensors, strict=True):
        if sensor.quantiser is None or item.name not in names:
            continue
        largest = np.max(np.abs(states[:, names.index(item.name)])) / abs(sensor.scale)
        if largest > sensor.quantiser.range:
            yield f"{item.name} reaches {largest:.3g} {sensor.unit}, beyond its sensor's {sensor.quantiser.range:g}"


def step_responses(rig: Rig, *, seconds: float, samples: int) -> tuple[Array, dict[str, Array]]:
    """Times (samples,) [s], and by input the outputs (samples, outputs) in display units after a step of the input from
    rest to half way to its upper limit.
    """
    steps = max(round(seconds / rig.step / (samples - 1)), 1)
    times = rig.step * steps * np.arange(samples, dtype=np.float64)
    found: dict[str, Array] = {}
    for index, item in enumerate(rig.system.inputs):
        rest = np.array([actuator.rest for actuator in rig.actuators])
        inputs = rest.copy()
        inputs[index] += 0.5 * (rig.actuators[index].high - rest[index])
        plant = Plant(rig, seed=0, noisy=False)
        rows = []
        for _ in range(samples):
            rows.append([float(d.shown(y)) for d, y in zip(rig.display, plant.measure().outputs, strict=True)])
            for _ in range(steps):
                plant.advance(inputs)
        found[item.name] = np.array(rows)
    return times, found

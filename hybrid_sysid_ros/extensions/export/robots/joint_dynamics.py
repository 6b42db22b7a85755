"""What URDF and MJCF can say of a model's joints: inertia, friction, damping, spring and drive; and what is left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.core.friction import Contact, Viscous
from hybrid_sysid_ros.core.symbolic import symbolic_rates
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RUNS, SECONDS, HELD, LEAST = 40, 2.0, 0.25, 200
"""Free runs on which a law is compared with what is linear in it, their length and how long an input is held [s], and
the least number of their points in the range of the training.
"""
COUPLED, MOST = 0.02, 0.25
"""Largest share of another joint in an acceleration, and of what is not linear, with which a joint is written."""
STATED = 0.005
"""Share from which something left out is named."""
FORCES = ("N", "N m")


@dataclass(frozen=True, kw_only=True)
class JointDynamics:
    """A joint: inertia x'' = gain u + offset - spring x - damping x' - friction sgn x'."""

    name: str
    position: str
    """State of it; "" where there is none."""
    velocity: str
    input: str
    slides: bool
    inertia: float
    """[kg m^2] or [kg]; 1 where it is not identified."""
    identified: bool
    """Whether the inertia is: else all numbers are per unit inertia."""
    friction: float
    damping: float
    spring: float
    gain: float
    """Per unit of the input."""
    offset: float
    left_out: tuple[str, ...]
    """Sentences about what has no counterpart."""


def joints_of(rig: Rig, model: Model) -> list[JointDynamics]:
    """The joints of a model whose motion URDF and MJCF can say. Raises UserError where they can't, with the reason."""
    system = model.system
    names = [item.name for item in system.declared_states]
    moving = {name: joint for name, joint in rig.joints.joints.items() if joint.velocity in names}
    covered = {state for joint in moving.values() for state in (joint.position, joint.velocity)}
    if left := [name for name in names if name not in covered]:
        raise UserError(
            f"export: URDF and MJCF have joints alone: {', '.join(left)} of {rig.name} is no position or velocity of a "
            "joint; write an FMU"
        )
    if system.stepper.is_map:
        raise UserError(f"export: {model.structure} is a map from sample to sample: no joint's friction is in it")
    x, u = _points(model)
    rates = symbolic_rates(system)
    found = np.array(rates.map(len(x))(x.T, u.T)[0]).T
    return [
        _joint(rig, model, name, moving[name], (x, u), found[:, names.index(moving[name].velocity)]) for name in moving
    ]


def undelayed(model: Model) -> System:
    """The model's system without the delays of its inputs."""
    system = model.system
    delays = {value for item in system.inputs if isinstance(value := system.delays.get(item.name), str)}
    pairs = zip(system.parameters, system.values.tolist(), strict=True)
    return system.with_values([0.0 if item.name in delays else value for item, value in pairs])


def trial_inputs(model: Model, seconds: float, *, seed: int) -> Array:
    """Inputs (steps, m) of the training range, each held for :data:`HELD`."""
    random, step = np.random.default_rng(seed), model.sampling.step
    ends = np.array([model.training_range.get(item.name, (-1.0, 1.0)) for item in model.system.inputs])
    levels = ends[:, 0] + (ends[:, 1] - ends[:, 0]) * random.uniform(size=(round(seconds / HELD), len(ends)))
    return np.repeat(levels, max(round(HELD / step), 1), axis=0)


def _points(model: Model) -> tuple[Array, Array]:
    """States (samples, n) and inputs (samples, m) of free runs, as far as they are in the range of the training. Where
    they leave it at once, points anywhere in it.
    """
    random, system = np.random.default_rng(0), undelayed(model)
    ends = np.array([model.training_range.get(item.name, (-1.0, 1.0)) for item in system.states])
    fast, found = [*system.kinematics.values()], []
    for run in range(RUNS):
        begin = random.uniform(ends[:, 0], ends[:, 1])
        begin[fast], begin[len(system.declared_states) :] = 0.0, 0.0
        inputs = trial_inputs(model, SECONDS, seed=run)
        states = simulate(system, begin, inputs, step=model.sampling.step)[:-1]
        inside = np.all((states >= ends[:, 0]) & (states <= ends[:, 1]), axis=1)
        found.append(np.column_stack([states, inputs])[inside])
    rows = np.concatenate(found)
    if len(rows) < LEAST:
        spans = np.vstack([ends, [model.training_range.get(item.name, (-1.0, 1.0)) for item in system.inputs]])
        rows = random.uniform(spans[:, 0], spans[:, 1], size=(4 * LEAST, len(spans)))
        rows[:, len(system.declared_states) : len(system.states)] = 0.0
    return rows[:, : len(system.states)], rows[:, len(system.states) :]


def _joint(rig: Rig, model: Model, name: str, joint: Any, points: tuple[Array, Array], rate: Array) -> JointDynamics:
    system, (x, u) = model.system, points
    states, inputs = [item.name for item in system.states], [item.name for item in system.inputs]
    own = [joint.position, joint.velocity, joint.effort]
    columns = [*states[: len(system.declared_states)], *inputs]
    values = np.column_stack([x[:, : len(system.declared_states)], u])
    weights, *_ = np.linalg.lstsq(np.column_stack([values, np.ones(len(x))]), rate, rcond=None)
    offset, by = float(weights[-1]), dict(zip(columns, weights[:-1].tolist(), strict=True))
    size = max(float(np.std(rate)), 1e-12)
    for column, value in zip(columns, values.T, strict=True):
        if column not in own and abs(by[column]) * float(np.std(value)) > COUPLED * size:
            raise UserError(
                f"export: the acceleration of joint {name} depends on {column}, which is not its own: URDF and MJCF "
                "have no such term in a joint; write an FMU"
            )
    rest = float(np.std(rate - values @ weights[:-1] - offset)) / size
    if rest > MOST:
        raise UserError(
            f"export: {rest:.0%} of the acceleration of joint {name} is not linear in its own motion and input, which "
            "URDF and MJCF can't say; write an FMU"
        )
    units = {item.name: item.unit for item in (*system.states, *system.inputs)}
    gain = by.get(joint.effort, 0.0)
    identified = units.get(joint.effort, "") in FORCES and gain > 0.0
    inertia = 1.0 / gain if identified else 1.0
    friction, viscous, left = _friction(system, joint.velocity, states.index(joint.velocity), x, u)
    left += _other_terms(system, model, joint, rest)
    if not identified:
        left.append(f"The inertia of joint {name} is not identified: all its numbers are per unit inertia.")
    return JointDynamics(
        name=name, position=joint.position, velocity=joint.velocity, input=joint.effort,
        slides=units[joint.velocity] == "m/s", inertia=inertia, identified=identified, friction=friction * inertia,
        damping=(viscous - by[joint.velocity]) * inertia, spring=-by.get(joint.position, 0.0) * inertia,
        gain=gain * inertia, offset=offset * inertia, left_out=tuple(left),
    )  # fmt: skip


def _friction(system: System, velocity: str, at: int, x: Array, u: Array) -> tuple[float, float, list[str]]:
    """Mean level of the dry friction and mean viscous rate of a velocity's contacts, and what is left out of them."""
    context, friction, viscous, left = system.step_context(), 0.0, 0.0, list[str]()
    for contact in system.contacts:
        if contact.on != velocity:
            continue
        rates = np.array([float(context.field(contact.viscous, row, inputs)) for row, inputs in _rows(x, u)])
        viscous += float(np.mean(rates))
        if np.ptp(rates) > STATED * abs(np.mean(rates)):
            left.append(f"The viscous friction of {velocity} changes by {np.ptp(rates) / np.mean(rates):.0%}.")
        if isinstance(contact, Viscous) or not hasattr(contact, "level"):
            continue
        levels = np.array([float(context.field(contact.level, row, inputs)) for row, inputs in _rows(x, u)])
        level = float(np.mean(levels))
        friction += level
        still = x.copy()
        still[:, at] = 0.0
        at_rest = float(np.mean([float(context.field(contact.level, row, inputs)) for row, inputs in _rows(still, u)]))
        if abs(at_rest - level) > STATED * level:
            left.append(
                f"The friction of {velocity} at rest is {at_rest / level - 1.0:+.0%} of that in motion (Stribeck)."
            )
        elif np.ptp(levels) > STATED * level:
            left.append(f"The dry friction of {velocity} changes by {np.ptp(levels) / level:.0%} with the state.")
        left += _kind(contact, velocity)
    return friction, viscous, left


def _rows(x: Array, u: Array) -> Any:
    """Some of the points, as lists."""
    return list(zip(x[::20].tolist(), u[::20].tolist(), strict=True))


def _kind(contact: Contact, velocity: str) -> list[str]:
    kind = type(contact).__name__
    known: Mapping[str, str] = {
        "Ageing": "grows with the time at rest",
        "Hysteretic": "differs between speeding up and slowing down",
    }
    if contact.hidden and kind not in known:
        return [
            f"The friction of {velocity} has hidden states ({', '.join(contact.hidden)}): it slides from the start."
        ]
    return [f"The friction of {velocity} {known[kind]}."] if kind in known else []


def _other_terms(system: System, model: Model, joint: Any, rest: float) -> list[str]:
    left = []
    if rest > STATED:
        what = "network and curved terms" if system.design else "curved terms"
        left.append(f"{rest:.1%} of the acceleration is not linear ({what}, such as a dead zone).")
    delays = dict(zip((item.name for item in system.inputs), system.input_delays.tolist(), strict=True))
    if delays.get(joint.effort):
        left.append(f"The input {joint.effort} acts after {1e3 * delays[joint.effort]:.3g} ms.")
    return left

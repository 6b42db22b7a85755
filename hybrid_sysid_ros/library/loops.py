"""Closed loops of a simulated rig, without a clock, so that they repeat bit by bit under any load."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.control import Controller, ControlProblem, MpcSolution, Status
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, OutputReference
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.library import arguments
from hybrid_sysid_ros.library.arguments import RigLike
from hybrid_sysid_ros.library.compiling import announce_compiling
from hybrid_sysid_ros.library.models import Model, load_model, sealed
from hybrid_sysid_ros.models import Model as AnyModel
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import controller_model, defaults, mpc_problem, shipped
from hybrid_sysid_ros.runtime.configuration import parameters as parameters_of
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.parameters import NothingShippedError, check_rules, grow, unknown
from hybrid_sysid_ros.runtime.references import KINDS, signal_of
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, shown, warn
from hybrid_sysid_ros.support.text_table import text_table

ReferenceLike: TypeAlias = str | float | ArrayLike | Callable[[Array], ArrayLike]
"""A kind of reference, set-points, or outputs over time."""

CONTROLLERS = ("exact", "network", "supervised")
NODES = ("controller", "estimator", "reference")
"""Nodes whose parameters a loop has."""
METHODS = ("horizon", "period", "control", "prepare", "reset")
"""Attributes of a controller."""
LONGEST = 3600.0
"""Longest loop [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop(ClosedLoop):
    """The course of a closed loop, a row for each sample, in SI units: n states of the model, m inputs, p outputs."""

    rig: Rig
    problem: ControlProblem
    """The problem by whose stage cost the loop is judged."""
    system: System
    """The model of that problem."""

    @property
    def reference(self) -> Array:
        """(samples, p)."""
        return self.references

    @property
    def estimate(self) -> Array:
        """States that the controller received, (samples, n)."""
        return self.estimates

    @cached_property
    def cost(self) -> float:
        """Sum of the stage costs of the controller's problem."""
        return self.cost_by(self.problem, self.system)

    @property
    def score(self) -> dict[str, float]:
        """Root mean square of output - reference of each tracked output, by its name, in its display unit."""
        errors = np.sqrt(np.mean((self.outputs - self.reference) ** 2, axis=0))
        return {
            item.name: float(display.shown(error))
            for item, display, error, weight in zip(
                self.rig.system.outputs, self.rig.display, errors, self.problem.output_weights, strict=True
            )
            if weight > 0.0
        }

    def __repr__(self) -> str:
        return f"Loop({self.rig.name}: {len(self.time)} samples, cost {self.cost:.6g})"

    def __str__(self) -> str:
        units = {item.name: shown.unit for item, shown in zip(self.rig.system.outputs, self.rig.display, strict=True)}
        rows = [(f"tracking error of {name}", f"{error:.4g}", units[name], "rms") for name, error in self.score.items()]
        rows += [
            (f"largest {item.name}", f"{np.abs(column).max():.4g}", item.unit, "")
            for item, column in zip(self.rig.system.inputs, self.inputs.T, strict=True)
        ]
        rows.append(("cost", f"{self.cost:.6g}", "", "as the controller weighs it"))
        rows += [(f"answers: {status.value}", str(count), "", "") for status, count in self.statuses.items()]
        title = f"loop of {self.rig.name}, {len(self.time)} samples"
        return text_table(title, ("quantity", "value", "unit", ""), rows, most=8, rest="loop.score and loop.statuses")

    def plot(self) -> Any:
        """Draw outputs, references and inputs over time: a plotly figure (extra ``report``)."""
        figure = extensions.one("figures", "loop", "plot needs the extension report")
        return figure(self.rig, self.time, self.outputs, self.reference, self.inputs)


class _Checked:
    """A controller of the user. Its errors name it, and its answers are checked."""

    def __init__(self, own: Controller, inputs: int) -> None:
        self.horizon = arguments.whole_of(own.horizon, "controller.horizon", low=1, high=10**6)
        self.period = arguments.number_of(own.period, "controller.period", low=0.0, above=True, unit="s")
        self.prepare = arguments.guarded(own.prepare, "controller.prepare", "the elapsed time")
        self.reset = arguments.guarded(own.reset, "controller.reset", "nothing")
        instance = "state, disturbance, previous_input, preview"
        self._control, self._inputs = arguments.guarded(own.control, "controller.control", instance), inputs

    def control(self, *instance: Array) -> MpcSolution:
        found: MpcSolution = self._control(*instance)
        answer: tuple[Any, Any] = getattr(found, "input", None), getattr(found, "status", None)
        if not isinstance(answer[1], Status) or np.shape(answer[0]) != (self._inputs,):
            raise UserError(
                f"controller.control gives {shown(found)}; give an MpcSolution whose input has shape ({self._inputs},)"
            )
        arguments.array_of(answer[0], "input of controller.control")
        return found


def simulate(
    rig: RigLike,
    model: AnyModel | None = None,
    *,
    controller: str | Policy | Controller = "exact",
    reference: ReferenceLike = "",
    seconds: float | None = None,
    policy: Policy | None = None,
    plant: AnyModel | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
) -> Loop:
    """Close the loop of a simulated rig, its estimator and a controller, from rest.

    model: the model of estimator and controller, by default the one that comes with the package. plant: the model that
    is simulated as the plant, by default the rig's system with the values of its file; both have the noise of the rig's
    sensors and the limits of its actuators. controller: "exact", the MPC; "network", a policy alone;
    "supervised", a policy while its plans pass a check, else the MPC; a policy, which drives alone; or an object with
    the methods of :class:`hybrid_sysid_ros.control.Controller`. reference: "constant", "steps", "sine", "multisine",
    one of the rig's by name (the first by default); a set-point for each output; or a function of times (samples,) [s]
    that gives the outputs (samples, p). References are in display units. policy: the
    policy of "network" or "supervised", by default the one that comes with the package. seconds: length of the loop, by
    default that of the rig's reference, or 10 s. seed: random seed of the noise. parameters: values of nodes, such as
    {"controller.horizon": 10, "estimator.gate": 4.0, "reference.hold": 2.0}.

    No clock is read and no answer is late, so a loop repeats bit by bit. Raises UserError where rig, model, policy and
    parameters don't fit each other.
    """
    announce_compiling()
    described = arguments.rig_of(rig)
    used = used_model(described, model)
    values = settings_of(described, parameters)
    problem, driver = _controller(described, used, controller, policy, values["controller"])
    signal, length = _reference(described, reference, values["reference"])
    duration = (
        length
        if seconds is None
        else arguments.number_of(seconds, "seconds", low=0.0, high=LONGEST, above=True, unit="s")
    )
    if duration < problem.period:
        raise UserError(f"seconds is {duration:g}; give at least the controller's period, {problem.period:g} s")
    loop = simulated_loop(
        described,
        used,
        driver,
        signal,
        duration=duration,
        plant=_plant(described, plant, arguments.seed_of(seed)),
        settings=values["estimator"],
    )
    return Loop(rig=described, problem=problem, system=controller_model(described, used.system), **vars(loop))


def used_model(rig: Rig, model: AnyModel | None) -> Model:
    """A model of the rig, by default the one that comes with the package. Where none does, the equations of the rig's
    class stand for one, with the values there, and a warning says so.
    """
    if model is not None:
        return sealed(arguments.given_model(model, rig))
    try:
        return load_model(shipped(rig.name, "model"), rig=rig.source)
    except NothingShippedError:
        warn(f"no model of {rig.name} is given: the equations of its class stand for one, with the values there")
    return Model(
        rig=rig.name,
        place=rig.source,
        structure="gray",
        system=rig.system,
        sampling=Sampling(),
        names=(),
        covariance=np.zeros((0, 0)),
        training_range={},
    ).sealed()


def _plant(rig: Rig, plant: AnyModel | None, seed: int) -> Plant:
    if plant is None:
        return Plant(rig, seed=seed, bias=rig.bias)
    return predicted_plant(
        rig, arguments.given_model(plant, rig, "plant").system, disturbance=rig.bias, seed=seed, noisy=True
    )


ARGUMENTS = {"policy": "controller", "policy_path": "policy", "model": "model"}
"""Arguments of :func:`simulate` by the parameters of nodes in whose place they are."""


def settings_of(rig: Rig, given: Mapping[str, Any] | None) -> dict[str, dict[str, Any]]:
    """Values of the nodes' parameters, in lockstep, since nothing is late here."""
    known = {node: parameters_of(rig, node) for node in NODES}
    chosen = {node: dict[str, Any]() for node in NODES}
    for name, value in arguments.mapping_of(given, "parameters", '{"controller.horizon": 10}').items():
        node, _, key = str(name).partition(".")
        arguments.choice_of(node, f"the node of parameters[{name!r}]", NODES)
        with arguments.within(f"parameters[{name!r}]"):
            if key not in known[node]:
                raise unknown(key, known[node])
            if key in ARGUMENTS:
                raise UserError(f"has no effect here: give it as the argument {ARGUMENTS[key]} of simulate")
            chosen[node][key] = known[node][key].checked(value)
    values = {node: {**defaults(rig, node), **chosen[node], "lockstep": True} for node in NODES}
    for node in NODES:
        grow(known[node], values[node], chosen[node])
        with arguments.within(f"parameters of {node}"):
            check_rules(known[node], values[node])
    return values


def _controller(
    rig: Rig, model: Model, controller: str | Policy | Controller, policy: Policy | None, settings: Mapping[str, Any]
) -> tuple[ControlProblem, Controller]:
    """The controller, and the problem by which its loop is judged."""
    if not isinstance(controller, str | Policy):
        missing = [name for name in METHODS if not hasattr(controller, name)]
        if missing or isinstance(controller, type):
            raise UserError(
                f"controller is {shown(controller)}; give one of {', '.join(CONTROLLERS)}, a policy, or an object that "
                f"has {', '.join(METHODS)}"
            )
        of = getattr(controller, "system", None)
        if isinstance(of, System) and [*map(str, of.inputs)] != [*map(str, rig.system.inputs)]:
            inputs = ", ".join(map(str, of.inputs))
            raise UserError(f"controller is of another rig, with the inputs {inputs}; make one of {rig.name}")
        problem = getattr(controller, "problem", None)
        judged = problem if isinstance(problem, ControlProblem) else mpc_problem(settings, rig, model.system)
        return judged, controller if isinstance(controller, Cascade) else _Checked(controller, len(rig.system.inputs))
    if isinstance(controller, Policy):
        policy, controller = controller, "network"
    name = arguments.choice_of(controller, "controller", CONTROLLERS)
    if policy is not None:
        if not isinstance(policy, Policy) or name == "exact":
            raise UserError(
                f"policy is {shown(policy)} with controller {name!r}; a policy drives as 'network' or 'supervised'"
            )
        if policy.rig != rig.name or policy.model != model.seal:
            raise UserError(
                f"policy is for another model of {policy.rig}; train it for this one: train_policy(rig, model)"
            )
    warn = _warn if policy is None else lambda line: None
    given = {**settings, "policy": name, "certificate": "ignore"}  # a simulation harms nobody
    made = controller_of(rig, model, given, warn, network=policy)
    return made.problem, made.controller


def _reference(rig: Rig, reference: ReferenceLike, settings: Mapping[str, Any]) -> tuple[OutputReference, float]:
    """The reference in display units, and the default length of a loop along it [s]."""
    outputs = len(rig.system.outputs)
    if isinstance(reference, str):
        kind = arguments.choice_of(reference or rig.reference, "reference", (*KINDS, *rig.references))
        schedule = rig.references.get(kind)
        with arguments.within("reference"):
            return signal_of(kind, settings, rig), schedule.duration if schedule else 10.0
    if callable(reference):
        asked = arguments.guarded(reference, "reference", f"times (samples,) that returns outputs (samples, {outputs})")
        return _checked(rig, asked), 10.0
    levels = np.atleast_1d(arguments.array_of(reference, "reference"))
    if levels.shape != (outputs,):
        raise UserError(
            f"reference has shape {levels.shape}; give a set-point for each output, ({outputs},), a kind such as "
            "'steps', or a function of time"
        )
    return _checked(rig, lambda times: np.tile(levels, (len(times), 1))), 10.0


def _checked(rig: Rig, asked: Callable[[Array], ArrayLike]) -> OutputReference:
    """A reference that is checked against the rig at each call, and for the first time here."""
    low, high = np.sort(rig.reach / np.array([display.scale for display in rig.display]), axis=0)

    def outputs(times: Array) -> Array:
        found = arguments.array_of(asked(times), f"reference from {times[0]:.6g} s on")
        if found.shape != (wanted := (len(times), len(low))):
            raise UserError(
                f"reference gives an array of shape {found.shape} for {len(times)} times; it needs {wanted}, a column "
                "for each output"
            )
        if (beyond := (found < low) | (found > high)).any():
            row, column = np.argwhere(beyond)[0]
            name, unit = rig.system.outputs[column].name, rig.display[column].unit
            raise UserError(
                f"reference of {name} is {found[row, column]:g} {unit} at {times[row]:.6g} s; "
                f"give {low[column]:.4g} to {high[column]:.4g} {unit}, which the rig can do"
            )
        return found

    outputs(np.linspace(0.0, 1.0, 3))
    return outputs


def _warn(line: str) -> None:
    """Warn at the caller of :func:`simulate`."""
    warnings.warn(line, stacklevel=5)

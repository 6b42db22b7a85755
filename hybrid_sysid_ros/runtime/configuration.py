"""Configuration of estimators, controllers and set-points from node parameters and the rig's file."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import Controller, ControlProblem
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.safety.failsafe import Ladder
from hybrid_sysid_ros.control.safety.guard import GuardSettings, acting_alike
from hybrid_sysid_ros.control.safety.guarding import RECENT
from hybrid_sysid_ros.control.safety.supervisor import Tolerances
from hybrid_sysid_ros.control.waiting_inputs import WaitingInputs
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import step_with_jacobian
from hybrid_sysid_ros.core.wrappers import RateDisturbanceModel, Stabilised, feedback_of, offset_of
from hybrid_sysid_ros.estimation import SensorChannel, Tuning
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import mpc_section
from hybrid_sysid_ros.runtime.limits import FREE, input_rates, least_prices, state_bounds, stops_of
from hybrid_sysid_ros.runtime.parameters import (
    TRAINED,
    NodeParameter,
    check_rules,
    defaults,
    parameters,
    settings,
    shipped,
)
from hybrid_sysid_ros.runtime.set_points import set_point_ranges
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers

__all__ = [
    "CAMERA", "TRAINED", "NodeParameter", "check_rules", "check_tolerances", "controller_model",
    "defaults", "estimator_model", "estimator_tuning", "guard_settings", "mpc_problem", "parameters",
    "settings", "shipped", "wrap_for_rig",
]  # fmt: skip

CAMERA = "camera"
"""Channel of an estimator for a second sensor of the rig's first output."""
OWN_NOISE = 0.05
"""Process noise of a state without a unit that a model has beside the rig's [1/sqrt(s)]."""
AT_FIRST = 10.0
"""Initial deviation of a state or an offset, in units of its drift in one second: as much as it drifts in 100 s."""
FINEST, EXACT = 100, 10_000
"""Most steps in an interval of a prediction, and as many as show what the model itself does."""
NONE = 1e9
"""A bound of a state that is at least this large counts as no bound."""
RESUME_SECONDS = 1.0
"""Time [s] in which a reference that comes back crosses the whole range of set-points, where no rate is given."""


def estimator_model(rig: Rig, model: Model) -> Model:
    """The model that estimators and controllers use: with the input offsets that the rig's file declares."""
    return replace(model, system=drifting(rig, model.system))


def drifting(rig: Rig, system: System) -> System:
    """A system of the rig with the input offsets that the rig's file declares."""
    if isinstance(system, RateDisturbanceModel) or not rig.offsets:
        return system
    return RateDisturbanceModel(physics=system, on=tuple(rig.offsets))


def controller_model(rig: Rig, system: System) -> System:
    """The system that a controller predicts: with the rig's offsets, and with its stabiliser where it has one.

    Raises UserError for a rig with a stabiliser whose inputs have different delays.
    """
    system = drifting(rig, system)
    if rig.experiments.stabiliser is None:
        return system
    if np.ptp(system.input_delays):
        raise UserError(
            f"rig {rig.name}: its inputs have different delays, {system.input_delays.tolist()} s, and its stabiliser "
            "can't wait for the slowest: delay the faster inputs as much"
        )
    return Stabilised(physics=system, gains=tuple(map(tuple, feedback_of(system, rig.experiments.stabiliser).tolist())))


def wrap_for_rig(rig: Rig, system: System, controller: Controller) -> Controller:
    """Wrap a controller of a :func:`controller_model` so that it gives the inputs of the rig, each when it is due."""
    if isinstance(system, Stabilised):
        return Cascade(controller, system, rig.limits)
    if np.ptp(system.input_delays):
        return WaitingInputs(controller, system, step=system.sampling_time or rig.step)
    return controller


def in_si(values: Sequence[float], rig: Rig) -> tuple[float, ...]:
    """Numbers of the outputs in SI, from their display units."""
    return tuple(display.scale * value for display, value in zip(rig.display, values, strict=True))


def estimator_tuning(values: Mapping[str, Any], rig: Rig, system: System | None = None) -> Tuning:
    """Tuning of the estimators from the parameters of the node `estimator`, with outputs in SI.

    system: the estimator's model, by default the rig's system. Among states that only the model has, offsets drift as
    the rig declares, states without a unit, such as hidden units of a network, by OWN_NOISE, and others don't drift.
    A state that a disturbance of the rig moves stays within what that reaches.
    Raises UserError where `followed` is no list of NAME=DRIFT.
    """
    system, camera = system or rig.system, rig.display[0].scale * values["camera_noise"]
    states, inputs, outputs = len(rig.system.states), len(rig.actuators), len(rig.sensors)

    def of_inputs(name: str) -> tuple[float, ...]:
        return listed(values, name, "parameter", inputs)

    def of_outputs(name: str) -> tuple[float, ...]:
        return in_si(listed(values, name, "parameter", outputs), rig)

    noise = listed(values, "process_noise", "parameter", states)
    names = [item.name for item in rig.system.states]
    drifts = dict(zip(names, noise, strict=True)) | offset_drifts(rig)
    process = [drifts.get(item.name, 0.0 if item.unit else OWN_NOISE) for item in system.states]
    first = dict(zip(names, listed(values, "initial_deviation", "parameter", states), strict=True))
    reaches = {rig.system.declared_states[k].name: item.largest for k, item in rig.disturbances.items()}
    return Tuning(
        measurement_noise=of_outputs("measurement_noise"),
        process_noise=tuple(process),
        initial_deviation=tuple(
            first.get(item.name) or AT_FIRST * drift for item, drift in zip(system.states, process, strict=True)
        ),
        state_limit=tuple(reaches.get(item.name, math.inf) for item in system.states),
        disturbance_noise=of_inputs("disturbance_noise"),
        disturbance_limit=of_inputs("disturbance_limit"),
        hum_hertz=listed(values, "hum_hertz", "parameter", outputs),
        hum_amplitude=of_outputs("hum_amplitude"),
        hum_noise=of_outputs("hum_noise"),
        gate=values["gate"],
        patience=values["patience"],
        input_noise=of_inputs("input_noise"),
        followed=_drifts(values["followed"], [item.name for item in system.parameters if not item.fixed]),
        channels={CAMERA: SensorChannel(of=rig.system.outputs[0].name, noise=camera)} if camera else {},
        window=values["window"],
        horizon=values["horizon"],
    )


def _drifts(text: str, known: Sequence[str]) -> dict[str, float]:
    """Drifts by name from NAME=DRIFT NAME=DRIFT...; a name with a * stands for all that match, such as level_rule_*."""
    found: dict[str, float] = {}
    for item in text.split():
        name, _, drift = item.partition("=")
        try:
            found.update(dict.fromkeys(fnmatch.filter(known, name) or [name], float(drift)))
        except ValueError as error:
            raise UserError(f"parameter followed: {item!r} is no NAME=DRIFT, as in coulomb=0.1") from error
    return found


def mpc_problem(
    values: Mapping[str, Any],
    rig: Rig,
    system: System | None = None,
    *,
    further: Mapping[str, Any] | None = None,
    model: Model | None = None,
) -> ControlProblem:
    """Problem of the exact MPC from the parameters of the node `controller`; outputs are weighted in display units.

    system: the MPC's model, by default the rig's system. States that only the model has are unbounded. Where `limits`
    is `rig`, the rig's travel and validity bound the states softly, and the rates of its actuators the changes of
    inputs, unless a stabiliser has a part in these. The section mpc of the rig's file declares further terms, and
    ``further`` is a section that is added to it, for a model: see :func:`~.mpc_section.extended`. Raises UserError for
    a number that makes no valid problem, and for a problem that asks for nothing.
    """
    system = system or rig.system
    kept = values["limits"] == "rig"
    of_rig = state_bounds(rig) if kept else {}
    states, inputs, outputs = len(rig.system.states), len(rig.actuators), len(rig.sensors)

    def of_inputs(name: str) -> tuple[float, ...]:
        return listed(values, name, "parameter", inputs)

    def of_states(name: str, other: float, end: int | None = None) -> tuple[float, ...]:
        """end: 0 for lower bounds, 1 for upper ones, which the rig has where the parameters have none."""
        given = zip((item.name for item in rig.system.states), listed(values, name, "parameter", states), strict=True)
        own = {state: value for state, value in given if end is None or abs(value) < NONE}
        others = {} if end is None else {state: ends[end] for state, ends in of_rig.items()}
        return tuple({**others, **own}.get(item.name, other) for item in system.states)

    prices = of_states("soft_quadratic", 1.0)
    least = least_prices(listed(values, "output_weight", "parameter", outputs), rig, of_rig)
    prices = tuple(max(price, least.get(item.name, 0.0)) for price, item in zip(prices, system.states, strict=True))
    rates = input_rates(of_inputs("input_rate"), rig if kept and not isinstance(system, Stabilised) else None)
    low, high = rig.limits
    plain = ControlProblem(
        horizon=values["horizon"],
        period=values["period"],
        substeps=_substeps(values, rig, system),
        output_weights=listed(values, "output_weight", "parameter", outputs),
        rate_weights=of_inputs("rate_weight"),
        input_low=tuple(np.maximum(low, of_inputs("input_low")).tolist()),
        input_high=tuple(np.minimum(high, of_inputs("input_high")).tolist()),
        output_scales=tuple(display.scale for display in rig.display),
        smoothing=values["smoothing"],
        max_iterations=values["max_iterations"],
        input_weights=of_inputs("input_weight"),
        rate_limits=tuple((values["period"] * rates).tolist()),
        state_low=of_states("state_low", -math.inf, 0),
        state_high=of_states("state_high", math.inf, 1),
        soft_linear=of_states("soft_linear", 0.0),
        soft_quadratic=prices,
    )
    problem = mpc_section.declared(rig, system, plain)
    if further:
        problem = mpc_section.extended(system, problem, further, model)
    if not (any(problem.output_weights) or problem.terms):
        raise UserError(
            "mpc: all output_weights are 0, so there is nothing to track; give one a weight, or the problem a term"
        )
    return problem


def _substeps(values: Mapping[str, Any], rig: Rig, system: System) -> int:
    """Steps in an interval: a whole number of the model's own steps where it has them, else the fewest from `substeps`
    on in which nothing grows that does not grow in EXACT ones: an explicit step is stable only where it is short
    beside the fastest mode (Hairer and Wanner 1996, Solving ODEs II, section IV.2). That is asked about zero, and about
    each end of the range of a set-point, of another state of the rig, or of an input.

    Raises UserError where that takes more than FINEST steps.
    """
    if system.sampling_time is not None:
        return max(1, round(values["period"] / system.sampling_time))
    count, n = int(values["substeps"]), len(system.states)

    def growth(point: Array, steps: int) -> float:
        """Logarithm of the largest growth over an interval; infinite where a step has no derivatives."""
        step = values["period"] / steps
        _, jacobian = step_with_jacobian(system, point[:n], point[n:], step=step, smoothing=values["smoothing"])
        finite = np.isfinite(jacobian).all()
        return steps * math.log(max(np.abs(np.linalg.eigvals(jacobian[:, :n])).max(), 1e-300)) if finite else math.inf

    for where, point in _range_ends(rig, system):
        bound = math.log(1.1) + max(growth(point, EXACT), 0.0)
        held = next((steps for steps in range(count, FINEST + 1) if growth(point, steps) <= bound), None)
        if held is None and count <= FINEST:
            raise UserError(
                f"parameter substeps: about {where} the model's fastest mode is too fast for {FINEST} steps in an "
                f"interval of {values['period']:g} s; shorten period, raise smoothing, or correct the model there"
            )
        count = held or count
    return count


def _range_ends(rig: Rig, system: System) -> list[tuple[str, Array]]:
    """Zero, and each finite end of a range where all else is zero: its name, and states and inputs (n + m,) of the
    system. A state's range is that of its set-points, or else the rig's travel and validity.
    """
    asked = zip(rig.system.outputs, set_point_ranges(rig), strict=True)
    bounds = {item.name: (of.scale * of.low, of.scale * of.high) for item, of in asked if of.moves}
    bounds = {**state_bounds(rig), **bounds}
    ends = [bounds.get(item.name, FREE) for item in system.states] + list(zip(*rig.limits, strict=True))
    points = [("zero", np.zeros(len(ends)))]
    for k, (item, values) in enumerate(zip((*system.states, *system.inputs), ends, strict=True)):
        for value in values:
            if math.isfinite(value) and abs(value) < NONE:
                points.append((f"{item.name} = {value:g}", np.where(np.arange(len(ends)) == k, value, 0.0)))
    return points


def check_tolerances(values: Mapping[str, Any], rig: Rig, problem: ControlProblem) -> Tolerances:
    """Tolerances of the online check from the parameters of the node `controller`.

    The cost of the sensors' noise is insignificant: a plan may cost more by errors of that size at every sample of the
    horizon.
    """
    return Tolerances(
        cost=values["check_cost"],
        floor=problem.horizon * noise_cost(rig, problem),
        violation=_violation(values, rig),
        disturbance=tuple(values["check_disturbance"]),
        patience=values["check_patience"],
        step=tuple(value or math.inf for value in values["check_step"]),
        noise=values["check_noise"],
    )


def guard_settings(values: Mapping[str, Any], rig: Rig, system: System) -> GuardSettings:
    """What makes a loop slow down, hold and rest, from the parameters of the node `controller` and the rig's limits.

    system: whose states the controller is given.
    """
    ranges = set_point_ranges(rig)
    crossing = [item.scale * (item.high - item.low) / RESUME_SECONDS if item.moves else NONE for item in ranges]
    rates = in_si(listed(values, "resume_rate", "parameter", len(ranges)), rig)
    ends = [[item.scale * end if item.moves else math.nan for end in (item.low, item.high)] for item in ranges]
    reach = np.where(np.array(rates) != 0.0, math.nan, np.transpose(ends))  # a given rate holds from anywhere
    low, high = rig.limits
    known = state_bounds(rig)
    state_low, state_high = np.array([known.get(item.name, FREE) for item in system.states]).T
    stops, stabiliser = stops_of(rig), rig.experiments.stabiliser
    return GuardSettings(
        act=values["distrust"] == "act",
        stabilised=stabiliser is not None,
        ladder=Ladder(values["slow_after"], values["hold_after"], values["rest_after"]),
        slow_share=values["slow_share"],
        resume_rate=np.array([abs(rate) or cross for rate, cross in zip(rates, crossing, strict=True)]),
        reach=(reach[0], reach[1]),
        recent=RECENT + rig.system.delay,
        tolerance=values["actuator_tolerance"],
        low=low,
        high=high,
        rate=input_rates(listed(values, "input_rate", "parameter", len(rig.actuators)), rig),
        state_low=state_low,
        state_high=state_high,
        alike=acting_alike(np.zeros((len(low), 1)) if stabiliser is None else stabiliser, high - low),
        stops=np.array([float(item.name in stops) for item in system.states]),
    )


def _violation(values: Mapping[str, Any], rig: Rig) -> float:
    """The least noise of the measured states that have bounds, or of all outputs if none of these is measured."""
    limits = zip(rig.system.states, values["state_low"], values["state_high"], strict=True)
    bounded = {item.name for item, low, high in limits if max(low, -high) > -NONE}
    bounded |= state_bounds(rig).keys() if values["limits"] == "rig" else set()
    noise = dict(zip((item.name for item in rig.system.outputs), _noise(rig).tolist(), strict=True))
    return min(value for name, value in noise.items() if name in bounded or not bounded & noise.keys())


def _noise(rig: Rig) -> Array:
    """Deviation (p,) of the noise of each output's sensor."""
    return np.array([sensor.scale * sensor.noise for sensor in rig.sensors])


def noise_cost(rig: Rig, problem: ControlProblem) -> float:
    """Cost of an error as large as the sensors' noise, at one sample."""
    noise = _noise(rig)
    return float(np.sum(problem.stage_weights.outputs[0, : len(noise)] * noise**2))  # those of terms follow


def offset_drifts(rig: Rig) -> dict[str, float]:
    """Drifts of the rig's offsets, by the names of the offsets' states."""
    return {offset_of(name): drift for name, drift in rig.offsets.items()}


def listed(content: Mapping[str, Any], key: str, where: str, count: int) -> tuple[float, ...]:
    """``count`` numbers from a section. Raises UserError where they are missing or wrong."""
    if key not in content:
        raise UserError(f"{where}: {key} is missing: it needs {count} numbers, or one for all")
    return numbers(content[key], f"{where}.{key}", count=count)

"""The online check and the certificate of a policy, by the numbers of its rig's configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control import Problem
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.certified_loops import Certification, Criteria, Distribution
from hybrid_sysid_ros.control.safety.online_check import Tolerances
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import Model, storage
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.augmented_model import controlled
from hybrid_sysid_ros.runtime.configuration import NONE, by_state, listed


def check_tolerances(values: Mapping[str, Any], rig: Rig, problem: Problem) -> Tolerances:
    """Tolerances of the online check from the parameters of the node `controller`.

    What the sensors' noise costs can't be told from nothing: a plan may be costlier by an error of that size at every
    sample of the horizon.
    """
    return Tolerances(
        cost=values["check_cost"],
        floor=problem.horizon * _noise_cost(rig, problem),
        violation=_violation(values, rig),
        disturbance=tuple(values["check_disturbance"]),
        patience=values["check_patience"],
    )


def certification_of(folder: Path, model: Path | None, *, seed: int = 0, seconds: float | None = None) -> Certification:
    """A policy on the plant of its rig, as it is certified.

    model: folder of the model it imitates, the shipped one by default. seconds: of a loop. The plant is the rig's own
    system where that has the states of the model, else the model's. Raises UserError where policy and model don't fit,
    or the section policy_certificate lacks a number.
    """
    seal = storage.digest(folder, kind="policy")
    rig = policy.load(folder, certified=False).rig
    loaded = load_model(model or configuration.shipped(load_rig(rig).name, "model"))
    imitation = policy.load(folder, model=loaded, certified=False)
    return certification(imitation, seal, loaded, seed=seed, seconds=seconds)


def certification(
    imitation: Policy, seal: str, loaded: Model, *, seed: int = 0, seconds: float | None = None
) -> Certification:
    """The same of a policy of this seal and its model, which are loaded."""
    rig = load_rig(imitation.rig)
    alike = [item.name for item in rig.system.states] == [item.name for item in loaded.system.states]
    plant, words = (rig.system, f"the rig {rig.name}") if alike else (loaded.system, "the model")
    system = controlled(rig, loaded.system)
    distribution, criteria = _certified(rig, system, imitation.problem, plant=f"{words}, its parameters spread")
    return Certification(
        policy=imitation,
        seal=seal,
        plant=controlled(rig, plant),
        model=system,
        distribution=distribution if seconds is None else replace(distribution, seconds=seconds),
        criteria=criteria,
        tolerances=check_tolerances(configuration.defaults(rig.name, "controller"), rig, imitation.problem),
        seed=seed,
    )


def _certified(rig: Rig, model: System, problem: Problem, *, plant: str) -> tuple[Distribution, Criteria]:
    """What the loops of a certificate are made of, and what they must keep; plant: what stands for it, in words.

    Raises UserError where the section policy_certificate lacks a number.
    """
    section, where = rig.section("policy_certificate"), f"{rig.file}: policy_certificate"
    states, inputs = len(rig.system.states), len(rig.system.inputs)
    distribution = Distribution(
        spread=configuration.spread_of(rig, model),
        seconds=listed(section, "seconds", where, 1)[0],
        state_error=by_state(listed(section, "state_error", where, states), rig, model),
        disturbance_error=listed(section, "disturbance_error", where, inputs),
        plant=plant,
    )
    criteria = Criteria(
        input_error=listed(section, "input_error", where, inputs),
        cost_share=listed(section, "cost_share", where, 1)[0],
        cost_floor=_noise_cost(rig, problem),
    )
    return distribution, criteria


def _violation(values: Mapping[str, Any], rig: Rig) -> float:
    """The least noise of the outputs that are states with bounds, of all outputs where no such one is measured."""
    limits = zip(rig.system.states, values["state_low"], values["state_high"], strict=True)
    bounded = {item.name for item, low, high in limits if max(low, -high) > -NONE}
    noise = dict(zip((item.name for item in rig.system.outputs), _noise(rig).tolist(), strict=True))
    return min(value for name, value in noise.items() if name in bounded or not bounded & noise.keys())


def _noise(rig: Rig) -> NDArray[np.float64]:
    """Deviation (p,) of the noise of each output's sensor."""
    return np.array([sensor.scale * sensor.noise for sensor in rig.sensors])


def _noise_cost(rig: Rig, problem: Problem) -> float:
    """Cost of an error as large as the sensors' noise, at one sample."""
    return float(np.sum(problem.stage_weights.outputs[0] * _noise(rig) ** 2))

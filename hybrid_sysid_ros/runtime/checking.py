"""The online check and the certificate of a policy, by the numbers of its rig's configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.bags.signals import configuration_of, load_configuration
from hybrid_sysid_ros.control import Problem
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.safety.certified_policy import Criteria, Distribution, Subject
from hybrid_sysid_ros.control.safety.online_check import Tolerances
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError


def check_tolerances(values: Mapping[str, Any], rig: Rig, problem: Problem) -> Tolerances:
    """Tolerances of the online check from the parameters of the node `controller`.

    What the sensor's noise costs can't be told from nothing: a plan may be costlier by an error of that size at every
    sample of the horizon.
    """
    return Tolerances(
        cost=values["check_cost"],
        floor=problem.horizon * _noise_cost(rig, problem),
        violation=rig.sensor.radians_per_volt * rig.sensor.noise_volts,
        disturbance=values["check_disturbance"],
        patience=values["check_patience"],
    )


def certification(rig: Rig, problem: Problem, *, plant: str) -> tuple[Distribution, Criteria]:
    """What the loops of a certificate are made of, and what they must keep; plant: what stands for it, in words.

    Raises UserError where the section policy_certificate lacks a number.
    """
    path = configuration_of(rig.name)
    scale = rig.sensor.radians_per_volt
    try:
        section = load_configuration(path)["policy_certificate"]
        distribution = Distribution(
            spread=configuration.sampling_spread(rig),
            seconds=section["seconds"],
            state_error=tuple(scale * value for value in section["state_error"]),
            disturbance_error=section["disturbance_error"],
            plant=plant,
        )
        criteria = Criteria(
            input_error=section["input_error"],
            cost_share=section["cost_share"],
            cost_floor=_noise_cost(rig, problem),
        )
    except (KeyError, TypeError) as error:
        needed = "seconds, state_error, disturbance_error, input_error and cost_share"
        raise UserError(f"{path}: policy_certificate: needs {needed}") from error
    return distribution, criteria


def subject_of(folder: Path, model: Path | None, *, seed: int = 0, seconds: float | None = None) -> Subject:
    """A policy on the plant of its rig, as it is certified.

    model: folder of the model it imitates, the shipped one by default. seconds: of a loop. The plant is the rig's own
    equation where that has the states of the model, else the model's. Raises UserError where policy and model don't
    fit.
    """
    seal = storage.digest(folder, kind="policy")
    rig = load_rig(policy.load(folder, certified=False).rig)
    loaded = load_model(model or configuration.shipped(rig.name, "model"))
    imitation = policy.load(folder, model=loaded, certified=False)
    alike = [item.name for item in rig.system.states] == [item.name for item in loaded.system.states]
    plant, words = (rig.system, f"the rig {rig.name}") if alike else (loaded.system, "the model")
    distribution, criteria = certification(rig, imitation.problem, plant=f"{words}, its parameters spread")
    return Subject(
        policy=imitation,
        seal=seal,
        plant=plant,
        model=loaded.system,
        distribution=distribution if seconds is None else replace(distribution, seconds=seconds),
        criteria=criteria,
        tolerances=check_tolerances(configuration.defaults(rig.name, "controller"), rig, imitation.problem),
        seed=seed,
    )


def _noise_cost(rig: Rig, problem: Problem) -> float:
    """Cost of an error as large as the sensor's noise, at one sample."""
    noise = rig.sensor.radians_per_volt * rig.sensor.noise_volts / problem.output_scales[0]
    return problem.output_weights[0] * noise**2

"""Controllers from the parameters of the node `controller`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import Controller, ControlProblem, ExactMpc
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.certificate import doubt as certificate_doubt
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import (
    check_tolerances,
    controller_model,
    mpc_problem,
    shipped,
    wrap_for_rig,
)
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError

Warn = Callable[[str], object]
"""Receives warnings for the user."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ConfiguredController:
    """A controller with its problem and, if it has them, its network and supervisor."""

    controller: Controller
    problem: ControlProblem
    network: Policy | None = None
    supervisor: Supervisor | None = None
    doubt: str = ""
    """What the certificate of its network leaves in doubt."""
    estimates: str = ""
    """What makes estimates in the place of the node estimator, as "module:attribute": a class that is made of this
    controller, the rig and the model; "": the node does. See :class:`hybrid_sysid_ros.nodes.adapters.EstimateSource`.
    """


def policy_folder(rig: Rig, settings: Mapping[str, Any]) -> Path | None:
    """Folder of the network that drives; None where the exact MPC drives alone. Raises UserError where no network comes
    with the package and none is given.
    """
    if settings["policy"] == "exact":
        return None
    return Path(settings["policy_path"] or shipped(rig.name, "policy"))


def controller_of(
    rig: Rig,
    model: Model,
    settings: Mapping[str, Any],
    warn: Warn = lambda line: None,
    *,
    network: Policy | None = None,
) -> ConfiguredController:
    """The controller that the settings choose, for a model. In lockstep it has no time limit, so that a run repeats.

    A setting that has the name of an extension's controller chooses that controller. network: a loaded policy; by
    default it is read from its folder. Raises UserError where model, policy and settings don't fit each other.
    """
    for name, target in extensions.targets("controllers").items():
        if settings.get(name):
            further: ConfiguredController = extensions.loaded(target)(rig, model, settings)
            return further
    system = controller_model(rig, model.system)
    if np.ptp(system.input_delays):
        delays = zip(system.inputs, system.input_delays, strict=True)
        listed = ", ".join(f"{item.name} {delay:g} s" for item, delay in delays)
        warn(f"the delays of the inputs differ ({listed}): the faster ones wait for the slowest")
    asked, interior = mpc_problem(settings, rig, system), settings["solver"] == "ipopt"
    path = policy_folder(rig, settings) if network is None else Path("policy")
    if path is None or settings["policy"] == "exact":
        if settings["policy_path"]:  # a later change to it must not fail
            policy.load(Path(settings["policy_path"]), model=model)
        alone = _interior_point(system, asked, settings, warn) if interior else _exact(system, asked, settings)
        return ConfiguredController(controller=wrap_for_rig(rig, system, alone), problem=asked)
    if interior:
        raise UserError(f"parameter solver is ipopt, policy {settings['policy']}: ipopt needs policy:=exact")
    if network is None:
        network = policy.load(path, model=model)
    doubt = _look_at(network, path, system, asked, settings, warn)
    if settings["policy"] == "network":
        return ConfiguredController(
            controller=wrap_for_rig(rig, system, network), problem=network.problem, network=network, doubt=doubt
        )
    tolerances = check_tolerances(settings, rig, network.problem)
    supervisor = Supervisor(network, _exact(system, network.problem, settings), tolerances)
    return ConfiguredController(
        controller=wrap_for_rig(rig, system, supervisor),
        problem=network.problem,
        network=network,
        supervisor=supervisor,
        doubt=doubt,
    )


def _exact(system: System, problem: ControlProblem, settings: Mapping[str, Any]) -> ExactMpc:
    return ExactMpc(system, problem, **pace(settings))


def pace(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments real_time, time_limit and clock of an exact MPC."""
    limit = math.inf if settings["lockstep"] else settings["time_limit"] or math.inf
    clock = None if math.isinf(limit) else perf_counter
    return {"real_time": settings["real_time"], "time_limit": limit, "clock": clock}


def _interior_point(system: System, problem: ControlProblem, settings: Mapping[str, Any], warn: Warn) -> Controller:
    """IPOPT on the exact MPC's problem. It is slow, so it is for lockstep, and it is loaded only on request."""
    if not settings["lockstep"]:
        warn("solver ipopt takes longer than a measurement's period: it is for lockstep")
    made: Controller = extensions.one("solvers", "ipopt")(system, problem)
    return made


def _look_at(
    network: Policy, path: Path, system: System, asked: ControlProblem, settings: Mapping[str, Any], warn: Warn
) -> str:
    """Warn of a network's deficiencies; return the doubt that its certificate leaves, in words.

    A network alone needs a certificate that is good enough; a supervised one, which the exact MPC stands behind, needs
    it where that is required. Raises UserError where it has none.
    """
    driver, asks = settings["policy"], settings["certificate"]
    found = "" if asks == "ignore" else certificate_doubt(network.certificate, driver, settings["certificate_rate"])
    if found and (asks == "require" or driver == "network"):
        raise UserError(f"{path}: {found}; certificate:=ignore uses it all the same")
    if found:
        warn(f"{path}: {found}")
    made = network.problem.sized(system)
    names = [item.name for item in fields(ControlProblem) if getattr(asked, item.name) != getattr(made, item.name)]
    if names:
        warn(f"{path}: was trained with other values of {', '.join(names)} than the parameters have, and keeps them")
    return found

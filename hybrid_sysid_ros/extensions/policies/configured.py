"""Policies as a rig's file configures them: how one is trained, and how it is tried for its certificate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.control.safety.certificate import Certificate
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.policies.counting import certify
from hybrid_sysid_ros.extensions.policies.criteria import SETTLED, Criteria
from hybrid_sysid_ros.extensions.policies.mixture import Mixture
from hybrid_sysid_ros.extensions.policies.trial import Trial
from hybrid_sysid_ros.extensions.shared import drawn_scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import by_state
from hybrid_sysid_ros.extensions.shared.parallel import Store
from hybrid_sysid_ros.models import Model, storage
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import (
    check_tolerances,
    controller_model,
    in_si,
    listed,
    noise_cost,
)
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

TRACKING_SHARE = 0.05
"""Of the amplitude of a reference: by how much the tracking may be worse than the exact MPC's in the end."""


def train_configured_policy(
    model: Model,
    settings: Settings | None = None,
    *,
    seed: int = 0,
    samples: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Policy:
    """Train a policy that imitates the exact MPC on a model; see :mod:`hybrid_sysid_ros.extensions.policies.training`.

    samples: folder where finished closed loops are kept until the end, so that an interrupted training goes on.
    progress: gets the stage, how much of it is done, and how much there is. Raises UserError where torch is missing.
    """
    with extra("train"):
        from hybrid_sysid_ros.extensions.policies.training import train
    if not model.seal:
        raise UserError("policy: the model was never saved; save it first, for the policy belongs to what is on disk")
    rig = rigs.load(model.rig)
    model = replace(model, system=controller_model(rig, model.system))
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig, model.system)
    settings = settings or Settings()
    spread = drawn_scenarios.spread_of(rig, model.system)
    purpose = f"{model.seal} {problem} {spread} {replace(settings, workers=0, cluster='')}"
    store: Store[Any] | None = Store(samples, purpose) if samples is not None else None
    trained: Policy = train(model, problem, spread, settings, seed=seed, store=store, progress=progress)
    if store is not None:
        store.remove()
    return trained


def trial_of(folder: Path, model: Path | None, *, seed: int = 0, seconds: float | None = None) -> Trial:
    """A policy on the plant of its rig, as it is tried.

    model: folder of the model it imitates, the shipped one by default. seconds: of a loop. The plant is the rig's own
    system where that has the states of the model, else the model's. Raises UserError where policy and model don't fit,
    or the section policy_certificate lacks a number.
    """
    seal = storage.digest(folder, kind="policy")
    rig = rigs.load(policy.load(folder, certified=False).rig)
    loaded = load_model(model or configuration.shipped(rig.name, "model"))
    imitation = policy.load(folder, model=loaded, certified=False)
    return trial_with(imitation, seal, loaded, seed=seed, seconds=seconds)


def trial_with(imitation: Policy, seal: str, loaded: Model, *, seed: int = 0, seconds: float | None = None) -> Trial:
    """The same of a policy of this seal and its model, which are loaded."""
    rig = rigs.load(imitation.rig)
    system = controller_model(rig, loaded.system)
    mixture, plant = _mixture(rig, loaded.system, system)
    mixture = mixture if seconds is None else replace(mixture, seconds=seconds)
    periods = round(mixture.seconds / imitation.period)
    if round(SETTLED * periods) >= periods:
        wanted = f"three of the policy's periods of {imitation.period:g} s or more"
        raise UserError(f"seconds is {mixture.seconds:g}, without a settled part; give {wanted}")
    return Trial(
        policy=imitation,
        seal=seal,
        plant=controller_model(rig, plant),
        model=system,
        mixture=mixture,
        criteria=_criteria(rig, system, imitation.problem),
        tolerances=check_tolerances(configuration.defaults(rig.name, "controller"), rig, imitation.problem),
        seed=seed,
    )


def certified(
    imitation: Policy,
    seal: str,
    loaded: Model,
    *,
    seed: int = 0,
    seconds: float | None = None,
    **counted: Any,
) -> Certificate:
    """The certificate of that; counted: see :func:`~.counting.certify`."""
    return certify(trial_with(imitation, seal, loaded, seed=seed, seconds=seconds), **counted)


def _mixture(rig: Rig, model: System, system: System) -> tuple[Mixture, System]:
    """What the loops of a certificate are made of, and their plant. Raises UserError where a number is missing."""
    section, where = rig.section("policy_certificate"), f"{rig.file}: policy_certificate"
    names = [item.name for item in rig.system.states]
    alike = names == [item.name for item in model.states]
    plant, words = (rig.system, f"the rig {rig.name}") if alike else (model, "the model")
    mixture = Mixture(
        spread=drawn_scenarios.spread_of(rig, system),
        seconds=listed(section, "seconds", where, 1)[0],
        state_error=by_state(listed(section, "state_error", where, len(names)), rig, system),
        disturbance_error=listed(section, "disturbance_error", where, len(rig.system.inputs)),
        plant=f"{words}, its parameters spread",
        declared={names[index]: item for index, item in rig.disturbances.items()} if alike else {},
    )
    return mixture, plant


def _criteria(rig: Rig, system: System, problem: ControlProblem) -> Criteria:
    """What they must keep. Raises UserError where the section policy_certificate lacks a number."""
    section, where = rig.section("policy_certificate"), f"{rig.file}: policy_certificate"
    outputs, tracking = len(rig.system.outputs), "tracking_error"
    if tracking in section:
        allowed = in_si(listed(section, tracking, where, outputs), rig)
    else:
        allowed = tuple(TRACKING_SHARE * size for size in drawn_scenarios.spread_of(rig, system).amplitude)
    for index, item in enumerate(rig.system.outputs):
        if problem.output_weights[index] > 0.0 and not allowed[index] > 0.0:
            raise UserError(f"{where}: {tracking} of {item.name} is {allowed[index]:g}; it needs more than 0")
    return Criteria(
        input_error=listed(section, "input_error", where, len(rig.system.inputs)),
        cost_share=listed(section, "cost_share", where, 1)[0],
        cost_floor=noise_cost(rig, problem),
        tracking_error=allowed,
        travel=_limits(rig, system, rig.travel),
        validity=_limits(rig, system, rig.validity),
    )


def _limits(rig: Rig, system: System, limits: Array | None) -> tuple[Numbers, Numbers] | None:
    """Lowest and highest values of the rig's states for those of a model; None where there are none."""
    if limits is None or not np.isfinite(limits).any():
        return None
    names = [item.name for item in rig.system.states]
    found = []
    for side, none in zip(limits.tolist(), (-math.inf, math.inf), strict=True):
        known = dict(zip(names, side, strict=True))
        found.append(tuple(known.get(item.name, none) for item in system.states))
    return found[0], found[1]

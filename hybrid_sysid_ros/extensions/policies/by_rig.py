"""Policies: how one is trained and how it is certified, by the numbers of its rig's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.control.safety.certificate import Certificate
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.policies.certification import StageProgress, certify
from hybrid_sysid_ros.extensions.policies.certified_loops import Certification, Criteria, Distribution
from hybrid_sysid_ros.models import Model, storage
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import by_state, check_tolerances, controller_model, listed, noise_cost
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.parallel import Store


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
    spread = configuration.spread_of(rig, model.system)
    purpose = f"{model.seal} {problem} {spread} {settings}"
    store: Store[Any] | None = Store(samples, purpose) if samples is not None else None
    trained: Policy = train(model, problem, spread, settings, seed=seed, store=store, progress=progress)
    if store is not None:
        store.remove()
    return trained


def certification_of(folder: Path, model: Path | None, *, seed: int = 0, seconds: float | None = None) -> Certification:
    """A policy on the plant of its rig, as it is certified.

    model: folder of the model it imitates, the shipped one by default. seconds: of a loop. The plant is the rig's own
    system where that has the states of the model, else the model's. Raises UserError where policy and model don't fit,
    or the section policy_certificate lacks a number.
    """
    seal = storage.digest(folder, kind="policy")
    rig = rigs.load(policy.load(folder, certified=False).rig)
    loaded = load_model(model or configuration.shipped(rig.name, "model"))
    imitation = policy.load(folder, model=loaded, certified=False)
    return certification(imitation, seal, loaded, seed=seed, seconds=seconds)


def certification(
    imitation: Policy, seal: str, loaded: Model, *, seed: int = 0, seconds: float | None = None
) -> Certification:
    """The same of a policy of this seal and its model, which are loaded."""
    rig = rigs.load(imitation.rig)
    alike = [item.name for item in rig.system.states] == [item.name for item in loaded.system.states]
    plant, words = (rig.system, f"the rig {rig.name}") if alike else (loaded.system, "the model")
    system = controller_model(rig, loaded.system)
    distribution, criteria = _certified(rig, system, imitation.problem, plant=f"{words}, its parameters spread")
    return Certification(
        policy=imitation,
        seal=seal,
        plant=controller_model(rig, plant),
        model=system,
        distribution=distribution if seconds is None else replace(distribution, seconds=seconds),
        criteria=criteria,
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
    loops: int,
    delta: float,
    workers: int,
    store: Path | None,
    progress: StageProgress | None,
) -> Certificate:
    """The certificate of that: see :func:`~.certification.certify`."""
    made = certification(imitation, seal, loaded, seed=seed, seconds=seconds)
    return certify(made, loops=loops, delta=delta, workers=workers, store=store, progress=progress)


def _certified(rig: Rig, model: System, problem: ControlProblem, *, plant: str) -> tuple[Distribution, Criteria]:
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
        cost_floor=noise_cost(rig, problem),
    )
    return distribution, criteria

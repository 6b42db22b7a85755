"""A policy for a model, by the numbers of its rig's configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.augmented_model import controlled
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.parallel import Store


def train_policy(
    model: Model,
    settings: Settings | None = None,
    *,
    seed: int = 0,
    samples: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Policy:
    """Train a policy that imitates the exact MPC on a model; see :mod:`hybrid_sysid_ros.control.policy.training`.

    samples: folder where finished closed loops are kept until the end, so that an interrupted training goes on.
    progress: gets the stage, how much of it is done, and how much there is. Raises UserError where torch is missing.
    """
    with extra("train"):
        from hybrid_sysid_ros.control.policy.training import train
    if not model.seal:
        raise UserError("policy: the model was never saved; save it first, for the policy belongs to what is on disk")
    rig = load(model.rig)
    model = replace(model, system=controlled(rig, model.system))
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig, model.system)
    settings = settings or Settings()
    spread = configuration.spread_of(rig, model.system)
    purpose = f"{model.seal} {problem} {spread} {settings}"
    store: Store[Any] | None = Store(samples, purpose) if samples is not None else None
    policy = train(model, problem, spread, settings, seed=seed, store=store, progress=progress)
    if store is not None:
        store.remove()
    return policy

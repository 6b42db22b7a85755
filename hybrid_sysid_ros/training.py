"""A policy for a model, by the numbers of its rig's configuration."""

from __future__ import annotations

from collections.abc import Callable

from hybrid_sysid_ros import configuration
from hybrid_sysid_ros.control.policy import Policy
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import load

EPISODES, ROUNDS, EPOCHS = 70, 3, 300
"""Closed loops in each round, rounds, epochs of training in each: some five minutes on two cores."""


def train_policy(
    model: Model,
    *,
    seed: int = 0,
    episodes: int = EPISODES,
    rounds: int = ROUNDS,
    epochs: int = EPOCHS,
    progress: Callable[[str, int, int], None] | None = None,
) -> Policy:
    """Train a policy that imitates the exact MPC on a model; see :mod:`hybrid_sysid_ros.control.policy_training`.

    progress: gets the stage, how much of it is done, and how much there is. Raises UserError where torch is missing.
    """
    try:
        from hybrid_sysid_ros.control.policy_training import Settings, train
    except ModuleNotFoundError as error:
        raise UserError(f"{error.name} is missing; install the extra: pip install 'hybrid_sysid_ros[train]'") from error
    rig = load(model.rig)
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig)
    settings = Settings(episodes=(episodes,) * rounds, epochs=epochs)
    return train(model, problem, configuration.sampling_spread(rig), settings, seed=seed, progress=progress)

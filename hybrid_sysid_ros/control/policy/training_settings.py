"""How a policy is trained."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hybrid_sysid_ros.support.errors import UserError

MOST_EPISODES = 10_000
"""Most closed loops in a round; each round's loops have seeds of their own."""

WIDEST, DEEPEST = 4096, 8
"""Largest width and number of layers: far more than a real-time network has, and still within memory."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """episodes: number of closed loops in each round; the MPC drives the first round, the policy so far later ones
    (DAgger). hidden: widths of the tanh layers. epochs, batch, rate: settings of SOAP, whose rate falls along a cosine;
    earlier rounds train for a third of the epochs. workers: processes that sample, 0 for one per core. cluster:
    address of a Dask scheduler in their place, or local.

    sequence: the network gives the whole plan, not only its first input. plan_weight: weight of all later inputs
    together; the first one has weight 1. followed: parameters for whose estimates the policy learns a correction, with
    their expected deviations from the model's values, in their units.

    margin: share of the range of each state that has bounds on both sides, by which the MPC that is imitated has them
    tighter at each end, so that a network which is never exact keeps the bounds themselves.
    """

    episodes: tuple[int, ...] = (800, 800, 800)
    hidden: tuple[int, ...] = (96, 96, 96)
    epochs: int = 30
    batch: int = 512
    rate: float = 3e-3
    workers: int = 0
    cluster: str = ""
    sequence: bool = True
    plan_weight: float = 0.3
    followed: Mapping[str, float] = field(default_factory=dict)
    margin: float = 0.0

    def __post_init__(self) -> None:
        if not self.episodes or min(self.episodes) < 2:
            raise UserError(f"policy: episodes {self.episodes}: needs at least 2 closed loops in every round")
        if max(self.episodes) > MOST_EPISODES:
            raise UserError(f"policy: episodes {self.episodes}: takes at most {MOST_EPISODES} closed loops in a round")
        if not self.hidden or min((self.epochs, self.batch, *self.hidden)) < 1:
            raise UserError("policy: epochs, batch and the widths of the layers must be above 0")
        if max(self.hidden) > WIDEST or len(self.hidden) > DEEPEST:
            widths = ", ".join(map(str, self.hidden))
            raise UserError(f"policy: layers of {widths}: takes at most {DEEPEST}, each of at most {WIDEST}")
        if not 0 <= self.plan_weight < math.inf:
            raise UserError("policy: weights must be numbers that are not negative")
        if not 0.0 <= self.margin < 0.5:
            raise UserError(f"policy: a margin of {self.margin:g} leaves nothing of the bounds; take less than 0.5")
        for name, spread in self.followed.items():
            if not 0.0 < spread < math.inf:
                raise UserError(f"policy: {name} can't be followed by {spread:g}: give a spread above 0, in its unit")

"""How a policy is trained."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hybrid_sysid_ros.support.errors import UserError

MOST_EPISODES = 10_000
"""In a round; each round's loops have seeds of their own."""

WIDEST, DEEPEST = 4096, 8
"""Layer, and number of layers: far above what answers in time, below what fills the memory."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """episodes: closed loops of each round; the first is driven by the MPC, later ones by the policy so far (DAgger).
    hidden: widths of the tanh layers. epochs, batch, rate: of SOAP, the rate falling along a cosine; earlier rounds
    train for a third of the epochs. workers: processes that sample, 0 for one per core.

    levelling: samples count by the mean stage cost of their loop to the power of -levelling. At 0 an error counts the
    same everywhere, at 1 in the share that it adds to its loop's cost, so that little is left for the lively ones.

    sequence: the network gives the whole plan and not its first input alone. plan_weight: of all inputs after the first
    together, which has weight 1. followed: parameters for whose estimates the policy learns a correction,
    and how far from the model's they are expected [their unit].
    """

    episodes: tuple[int, ...] = (800, 800, 800)
    hidden: tuple[int, ...] = (96, 96, 96)
    epochs: int = 30
    batch: int = 512
    rate: float = 3e-3
    workers: int = 0
    sequence: bool = True
    levelling: float = 0.3
    plan_weight: float = 0.3
    followed: Mapping[str, float] = field(default_factory=dict)

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
        if not all(0 <= weight < math.inf for weight in (self.levelling, self.plan_weight)):
            raise UserError("policy: weights must be numbers that are not negative")
        for name, spread in self.followed.items():
            if not 0.0 < spread < math.inf:
                raise UserError(f"policy: {name} can't be followed by {spread:g}: give a spread above 0, in its unit")

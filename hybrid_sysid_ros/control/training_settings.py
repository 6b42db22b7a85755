"""How a policy is trained."""

from __future__ import annotations

from dataclasses import dataclass, field

from hybrid_sysid_ros.control.adaptation import Adaptation
from hybrid_sysid_ros.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Settings:
    """episodes: closed loops of each round; the first is driven by the MPC, later ones by the policy so far (DAgger).
    hidden: widths of the tanh layers. epochs, batch, rate: of Adam, the rate falling along a cosine; earlier rounds
    train for a third of the epochs. workers: processes that sample, 0 for one per core.

    sequence: the network gives the whole plan and not its first input alone. plan_weight: of all inputs after the first
    together, which has weight 1. slope_weight: of the first input's derivatives by the standardised features, in input
    limits (Sobolev training: Czarnecki et al. 2017, NeurIPS); slope_share: share of the samples that have them.
    adaptation: parameters for whose estimates the policy learns a correction.
    """

    episodes: tuple[int, ...] = (300, 300, 300)
    hidden: tuple[int, ...] = (64, 64, 64)
    epochs: int = 60
    batch: int = 512
    rate: float = 5e-3
    workers: int = 0
    sequence: bool = True
    plan_weight: float = 0.3
    slope_weight: float = 0.0
    slope_share: float = 0.2
    adaptation: Adaptation = field(default_factory=Adaptation)

    def __post_init__(self) -> None:
        if not self.episodes or min(self.episodes) < 2:
            raise UserError(f"policy: episodes {self.episodes}: needs at least 2 closed loops in every round")
        if not self.hidden or min((self.epochs, self.batch, *self.hidden)) < 1:
            raise UserError("policy: epochs, batch and the widths of the layers must be above 0")
        if not (min(self.plan_weight, self.slope_weight) >= 0 and 0 <= self.slope_share <= 1):
            raise UserError("policy: weights must not be negative, and shares must be within 0 and 1")

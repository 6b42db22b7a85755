"""What a model predictive controller minimises, and within which bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Minimise  sum_{i=1}^{N} output_weight ((y_i - q_i) / output_scale)^2
    + sum_{i=0}^{N-1} rate_weight (u_i - u_{i-1})^2 + input_weight u_i^2  +  sum of soft_linear s + soft_quadratic s^2
    over |u_i| <= input_limit, |u_i - u_{i-1}| <= rate_limit, x_{i+1} = step(x_i, u_i + d); s is by how much a state
    (divided by output_scale) at i = 1..N is outside of its bounds.

    horizon: N. period: length of one interval [s]. substeps: integration steps in it. output_scale: the unit that the
    output is weighed in [rad] (a volt of the sensor). smoothing: of stick-slip [rad/s]. max_iterations: of the solver.
    state_bounds: (lower, upper) of each state, or none. literal: the cost as the lecture prints it, which weighs x_k to
    x_{k+N-1} and leaves the first change of the input free.
    """

    horizon: int
    period: float
    substeps: int
    output_weight: float
    rate_weight: float
    input_limit: float
    output_scale: float
    smoothing: float
    max_iterations: int
    input_weight: float = 0.0
    rate_limit: float = math.inf
    state_bounds: tuple[tuple[float, float], ...] = ()
    soft_linear: float = 0.0
    soft_quadratic: float = 1e4
    literal: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "state_bounds", tuple((float(low), float(high)) for low, high in self.state_bounds))
        for name in ("horizon", "period", "substeps", "output_weight", "input_limit", "output_scale", "max_iterations"):
            if not (getattr(self, name) > 0 and math.isfinite(getattr(self, name))):
                raise UserError(f"mpc: {name} is {getattr(self, name)}; it must be above 0")
        for name in ("rate_weight", "smoothing", "input_weight", "soft_linear"):
            if not (getattr(self, name) >= 0 and math.isfinite(getattr(self, name))):
                raise UserError(f"mpc: {name} is {getattr(self, name)}; it must not be negative")
        if not (self.rate_limit > 0 and self.soft_quadratic > 0):
            raise UserError("mpc: rate_limit and soft_quadratic must be above 0")
        if any(not low < high for low, high in self.state_bounds):
            raise UserError(f"mpc: state_bounds {self.state_bounds}: a lower bound is not below its upper one")
        if self.literal and self.horizon < 2:
            raise UserError("mpc: the literal cost weighs nothing on a horizon of 1")

    @property
    def weights(self) -> Array:
        """Weights (3, horizon) of y_1..y_N [1/rad^2], u_0 - u_-1..u_{N-1} - u_{N-2} and u_0..u_{N-1}."""
        weights = np.ones((3, self.horizon))
        weights *= np.array([[self.output_weight / self.output_scale**2], [self.rate_weight], [self.input_weight]])
        if self.literal:
            weights[0, -1] = weights[1, 0] = 0.0
        return weights

    def bounds(self, states: int) -> tuple[Array, Array]:
        """Lower and upper bounds of the states, (states,) each. Raises UserError where they are not as many."""
        if not self.state_bounds:
            return np.full(states, -np.inf), np.full(states, np.inf)
        if len(self.state_bounds) != states:
            raise UserError(f"mpc: state_bounds has {len(self.state_bounds)} entries; the model has {states} states")
        low, high = np.array(self.state_bounds).T
        return low.copy(), high.copy()

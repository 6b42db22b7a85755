"""A record as a fit takes it, and what a fit finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedRecord:
    """A record on the grid of a simulation."""

    name: str
    sampling: Sampling
    inputs: Array
    """Mean inputs over each step, (steps, inputs)."""
    outputs: Array
    """Raw outputs at the scored samples, (samples, outputs)."""
    states: Array
    """States from raw outputs and their Savitzky-Golay rates, (samples, states); used only as initial states."""
    measured: NDArray[np.bool_] | None = None
    """Which samples were measured, (samples,); None for all."""
    noise: Array | None = None
    """Noise of each output, rms as the record shows it, (outputs,); None where it is not known."""
    alias: Array | None = None
    """Offset of each output at the scored samples by a hum whose periods fit in between, (outputs,)."""
    lag: Array | None = None
    """Age of the readings of each output [s], (outputs,), by its sensor's delay and window, which no model knows."""
    windows: Array | None = None
    """Windows over which they are means [s], (outputs,)."""
    bends: Array | None = None
    """What lines through the inputs' samples of the same means would add, (steps, inputs); None where samples hold."""
    deviations: Array | None = None
    """How well the record shows each state at its first sample, as standard deviations (states,), 1 for states that it
    does not show; None where the states that it shows are exact.
    """

    @property
    def scored(self) -> NDArray[np.bool_]:
        """Which samples are scored, (samples,): measured ones after the warm-up. Raises UserError where none is."""
        found = np.ones(self.samples, dtype=bool) if self.measured is None else self.measured.copy()
        found[: self.sampling.warm_up] = False
        if not found.any():
            raise UserError(
                f"{self.name}: none of its {self.samples} samples is left after a warm-up of {self.sampling.warm_up} "
                "(--warm-up)"
            )
        return found

    @property
    def followed(self) -> Array:
        """What a fit follows: the outputs without what the samples alias, (samples, outputs)."""
        return self.outputs if self.alias is None else self.outputs - self.alias

    @property
    def samples(self) -> int:
        return len(self.outputs)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted system, and the uncertainty of its numbers."""

    system: System
    names: tuple[str, ...] = ()
    """Names of the free parameters: physical ones, then weights."""
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Robust covariance of the free parameters, (free, free), in their units."""
    by_cost: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Their covariance from the curvature of the cost alone, as if errors were independent with deviation one."""
    step_error: Array = field(default_factory=lambda: np.zeros(0))
    """What the integration step moves each free parameter by, as part of their covariance, (free,) or empty."""
    effective: float = 0.0
    """How many free numbers, initial states included, the data determined, since priors hold the others."""
    block_spread: Array = field(default_factory=lambda: np.zeros(0))
    """Standard errors by the spread of blocks of the records, (free,) or empty."""
    nuisances: Mapping[str, Array] = field(default_factory=dict)
    """Fitted corrections of initial states, (records,) by the state's name."""
    relative_error: float
    """Root mean square of the free-run errors, relative to the outputs' deviation."""
    seconds: float
    """Time of the optimisation [s], without compilation."""
    evaluations: int
    """Number of simulations of all records, with or without derivatives."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """What else was fitted, as plain data by name, such as the bias of each input in each record."""
    chi_squared: float | None = None
    """Mean squared error, in units of the sensors' noise; only a fit over windows with free initial states, as for an
    unstable rig, has it.
    """

    @property
    def spreads(self) -> Array:
        """Deviations of the free parameters by the cost alone, (free,), with which another fit is anchored."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.by_cost), 0.0, None)))

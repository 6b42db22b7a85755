"""What the fit of a structure is given, and what it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.support.arrays import Array

if TYPE_CHECKING:
    from hybrid_sysid_ros.models.structure import Magnitudes, Structure
    from hybrid_sysid_ros.rigs.rig import Rig


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedRecord:
    """A record on the grid of a simulation."""

    name: str
    sampling: Sampling
    inputs: Array
    """Over each step, (steps, inputs)."""
    outputs: Array
    """Raw ones at the scored samples, (samples, outputs)."""
    states: Array
    """As far as the raw outputs and their Savitzky-Golay rates show them, (samples, states): initial states only."""
    measured: NDArray[np.bool_] | None = None
    """Which samples are scored, (samples,): those that were measured; None for all."""

    @property
    def samples(self) -> int:
        return len(self.outputs)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted system, and how sure its numbers are."""

    system: System
    names: tuple[str, ...] = ()
    """The free parameters, physical ones first, then weights."""
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Of them, (free, free), in their units."""
    by_cost: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """The same by the curvature of the cost alone, as if errors were independent of deviation one."""
    nuisances: Mapping[str, Array] = field(default_factory=dict)
    """What was added to initial states, (records,) by the state's name."""
    relative_error: float
    """Root mean square of the free-run errors, as part of the outputs' deviation."""
    seconds: float
    """Of the optimisation, without compilation."""
    evaluations: int
    """Simulations of all records, with or without derivatives."""
    biases: Mapping[str, Array] = field(default_factory=dict)
    """Constant bias of an input in each record, (records,) by the input's name, where they were fitted."""
    chi_squared: float | None = None
    """Mean squared error in the sensors' noise; None where the fit was not over windows with initial states of their
    own, as that of an unstable rig is.
    """

    @property
    def spreads(self) -> Array:
        """Deviations of the free parameters by the cost alone, (free,): what another fit is anchored with."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.by_cost), 0.0, None)))


class FitContext(Protocol):
    """The records, which are resampled once, and all else that the fit of a structure depends on."""

    @property
    def rig(self) -> Rig: ...

    @property
    def sampling(self) -> Sampling:
        """What :meth:`~.structure.Structure.sampling` gave."""

    @property
    def options(self) -> Mapping[str, float | int]:
        """All options of the structure, defaults included."""

    @property
    def seed(self) -> int: ...

    @property
    def progress(self) -> Any:
        """Called with stage, evaluations and relative error, or None."""

    @property
    def magnitudes(self) -> Magnitudes:
        """Of the states and inputs of the rig in the records."""

    def experiments(self, system: System) -> list[PreparedRecord]:
        """The records with the states that a system would have in them."""

    def fit(self, system: System, **settings: Any) -> Fit:
        """Least squares on free runs over the records, from where a system stands.

        settings: of :func:`hybrid_sysid_ros.identification.fitting.fit`; ``experiments`` instead of the records'.
        """

    def fit_physics(self, systems: Sequence[System], **settings: Any) -> Fit:
        """The best fit of those that begin at several systems, as the options ``starts``, ``ridge`` and ``input_bias``
        say; on a rig that needs a stabiliser over short windows.
        """

    def of(self, structure: Structure) -> FitContext:
        """The same for a part of the structure, with the options that this part has."""

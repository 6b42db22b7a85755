"""Fit context: the records of a fit, resampled once, and everything else on which the fit depends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.experiment import ResampledRecord, resample
from hybrid_sysid_ros.identification.fitting import Biased, FitProgress, fit
from hybrid_sysid_ros.identification.initial_values import magnitudes
from hybrid_sysid_ros.identification.shooting import (
    UnstableFitSettings,
    fastest_growth,
    growth_along,
    open_windows,
    parts_from,
    runs_away,
    unstable_settings,
)
from hybrid_sysid_ros.identification.starts import unshown_states
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.fit import Fit, PreparedRecord
from hybrid_sysid_ros.models.structure import Magnitudes, Structure
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserError

LOST = 0.3
"""Error of free runs, in the outputs' deviation, above which a fit has lost the way past an unstable point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Context:
    """The context of a fit, see :class:`~hybrid_sysid_ros.models.structure.FitContext`."""

    rig: Rig
    sampling: Sampling
    options: Mapping[str, float | int]
    seed: int
    progress: FitProgress | None = None
    criterion: str = "simulation"
    """Of physics: "simulation", or one of the ``criteria`` that extensions provide."""
    records: Sequence[Record]
    resampled: Sequence[ResampledRecord] = field(default=())
    """The records at the sampling; by default they are resampled here."""

    def __post_init__(self) -> None:
        if not self.resampled:
            object.__setattr__(self, "resampled", [resample(record, self.sampling) for record in self.records])

    @cached_property
    def magnitudes(self) -> Magnitudes:
        return replace(magnitudes(self.rig.system, self.experiments(self.rig.system)), sensors=self.rig.sensors)

    def experiments(self, system: System) -> list[PreparedRecord]:
        return [item.experiment(system) for item in self.resampled]

    def of(self, structure: Structure) -> Context:
        known = structure.options
        return replace(self, options={name: value for name, value in self.options.items() if name in known})

    def fit(self, system: System, *, experiments: Sequence[PreparedRecord] | None = None, **settings: Any) -> Fit:
        used, sensing = self.experiments(system) if experiments is None else experiments, system.sensing
        if sensing is not None and settings.get("anchor") is None and settings.get("unstable") is None:
            held = (*settings.get("hold", ()), *sensing.names)
            system = fit(system, used, progress=self.progress, **{**settings, "hold": held}).system
            settings |= {"stages": (None,), "starts": 1}
        return fit(system, used, progress=self.progress, **settings)

    def fit_physics(self, systems: Sequence[System], **settings: Any) -> Fit:
        given: dict[str, Any] = {
            "starts": int(self.options.get("starts", 1)),
            "ridge": float(self.options.get("ridge", 1.0)),
            "seed": self.seed,
            "unstable": self.unstable,
            **settings,
        }
        if given["unstable"] is not None and self.options.get("input_bias"):
            raise UserError(f"input_bias: {self.rig.name} is unstable, and short windows show no bias: leave it out")
        if self.criterion != "simulation" and (self.unstable is not None or self.options.get("input_bias")):
            reason = (
                "a rig with a stabiliser is fitted over windows" if self.unstable else "input_bias is for free runs"
            )
            raise UserError(f"criterion {self.criterion}: {reason}: take the criterion simulation")
        fits, reasons = [], []
        for system in systems:
            try:
                fits.append(self._unbiased_fit(system, **given))
            except UserError as error:
                reasons.append(error)
        if not fits:
            raise reasons[0]
        best = min(fits, key=lambda item: item.relative_error)
        return replace(
            best, seconds=sum(item.seconds for item in fits), evaluations=sum(item.evaluations for item in fits)
        )

    @property
    def unstable(self) -> UnstableFitSettings | None:
        """Settings of the fit of a rig that needs a stabiliser; None for other rigs."""
        return unstable_settings(self.rig)

    def _unbiased_fit(self, system: System, **settings: Any) -> Fit:
        """The fit of a system, with a bias of the inputs in each record where the option asks for it."""
        spreads = float(self.options.get("input_bias", 0.0)) * np.diff(self.rig.limits, axis=0)[0]
        if not np.any(spreads):
            return self._by_criterion(self._over_windows(self.fit(system, **settings), system, settings), settings)
        biased = Biased(physics=system, spreads=tuple(spreads.tolist()))
        found = self.fit(biased, **settings)
        assert isinstance(found.system, Biased)
        biases = biased.biases(found.nuisances)
        names = [record.name for record in self.records]
        noted = {name: dict(zip(names, values.tolist(), strict=True)) for name, values in biases.items()}
        return replace(found, system=found.system.physics, notes={"input_bias": noted})

    def _over_windows(self, found: Fit, system: System, settings: Mapping[str, Any]) -> Fit:
        """The fit over open windows in the place of one of free runs that failed: where errors of an unstable system
        grow too far, and nobody named its stabiliser, or where runs part.
        """
        if settings["unstable"] is not None or unshown_states(system):
            return found
        laws, experiments = (system, found.system), self.experiments(system)
        lost = found.relative_error > LOST and any(runs_away(law, item) for law in laws for item in experiments)
        if not lost and all(parts_from(found.system, item) is None for item in experiments):
            return found
        given = {key: value for key, value in settings.items() if key != "stages"}
        return self.fit(system, **{**given, "unstable": self.windows(system if lost else found.system)})

    def windows(self, system: System) -> UnstableFitSettings:
        """Open windows in which an error grows little, also where a system is unstable away from rest alone."""
        if fastest_growth(system):
            return open_windows(self.rig)
        return open_windows(self.rig, max(growth_along(system, item) for item in self.experiments(system)))

    def _by_criterion(self, found: Fit, settings: Mapping[str, Any]) -> Fit:
        """The fit of physics by the chosen criterion, from that of free runs; a network is fitted to free runs."""
        if self.criterion == "simulation" or len(found.system.weights):
            return found
        criterion = extensions.one("criteria", self.criterion, f"criterion {self.criterion}")
        fitted: Fit = criterion(found.system, self.experiments(found.system), found, settings.get("hold", ()))
        return fitted

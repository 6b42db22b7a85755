"""How each structure is fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.identification.biased import Biased
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.fitting import STAGES, Fit, Progress, fit
from hybrid_sysid_ros.identification.fuzzy import tuned
from hybrid_sysid_ros.identification.gradient_training import train
from hybrid_sysid_ros.identification.residual import Leftover, beginning, check_forgets
from hybrid_sysid_ros.identification.selection.link_selection import select_links
from hybrid_sysid_ros.identification.selection.rule_selection import select_rules
from hybrid_sysid_ros.identification.selection.term_selection import select_terms
from hybrid_sysid_ros.identification.shooting import windows_of
from hybrid_sysid_ros.identification.starting import begun, magnitudes, placed
from hybrid_sysid_ros.models import Sampling, build
from hybrid_sysid_ros.models.hybrid import Hybrid
from hybrid_sysid_ros.models.hybrid import averaged as averaged_hybrid
from hybrid_sysid_ros.models.lagged import Lagged
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.options import Options, complete
from hybrid_sysid_ros.models.recurrent import step_within
from hybrid_sysid_ros.models.residual import ResidualHybrid, averaged
from hybrid_sysid_ros.models.structures import corrected_by, options_of, structure_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

NARX_RIDGE = 1e-6
"""Its terms are chosen already: nothing pulls their coefficients to zero."""

RESIDUAL_TOLERANCE, RESIDUAL_ITERATIONS = 1e-4, 80
"""Of a residual's fit: its feedback makes the cost's valleys long and narrow."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """A structure and all that its fit depends on but the records."""

    rig: Rig
    structure: str
    sampling: Sampling
    options: Options
    seed: int
    progress: Progress | None = None

    @property
    def chosen(self) -> dict[str, float | int]:
        """All options, defaults included."""
        known = options_of(self.structure, self.rig.system, self.rig.structures)
        return complete(self.options, known, self.structure)

    def fit(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """The fit, and the sampling that it holds at. Raises UserError as the parts of it do."""
        if self.structure == "narx":
            return self._narx(records)
        if self.structure == "takagi_sugeno":
            return self._takagi_sugeno(records)
        if self.structure == "difnn":
            return self._difnn(records)
        if self.structure == "recurrent":
            return self._recurrent(records)
        row, box = structure_of(self.structure, self.rig.structures)
        if row.network == "anchored":
            return self._anchored(box, records), self.sampling
        if row.network == "residual":
            return self._residual(box, records), self.sampling
        if row.network == "frozen":
            first = self._one(box, records)
            return self._one(self.structure, records, start=first, hold=first.names), self.sampling
        return self._one(self.structure, records), self.sampling

    def _anchored(self, box: str, records: Sequence[Record]) -> Fit:
        """The gray box first; then networks of several seeds about it, averaged into one, so that they learn what the
        physics leaves and no single seed decides. Closures that are corrected leave no room for its parameters to
        move in: these stay as they are.
        """
        gray = self._one(box, records)
        frozen = bool(corrected_by(gray.system, self.chosen))
        members = [
            self._one(
                self.structure,
                records,
                start=gray,
                anchor=None if frozen else gray,
                hold=gray.names if frozen else (),
                stages=STAGES[-2:],
                member=member,
            )
            for member in range(int(self.chosen["members"]))
        ]
        hybrids = [member.system for member in members if isinstance(member.system, Hybrid)]
        return replace(
            gray,
            system=averaged_hybrid(hybrids),
            relative_error=float(np.mean([member.relative_error for member in members])),
            chi_squared=None if gray.chi_squared is None else float(np.mean([m.chi_squared for m in members])),
            seconds=gray.seconds + sum(member.seconds for member in members),
            evaluations=gray.evaluations + sum(member.evaluations for member in members),
        )

    def _residual(self, box: str, records: Sequence[Record]) -> Fit:
        """The gray box first; then models of what it leaves, by their own free run beside the gray box as it is: with
        networks of several seeds, averaged into one, so that no single seed decides.
        """
        gray = self._one(box, records)
        leftovers = [Leftover.of(gray.system, prepare(record, gray.system, self.sampling)) for record in records]
        start, units = beginning(gray.system, leftovers, self.chosen), int(self.chosen["units"])
        seeds = [self.seed + 1000 * member for member in range(int(self.chosen["members"]) if units else 1)]
        fits = [self._beside(start.with_network(units, seed=seed), leftovers) for seed in seeds]
        system = averaged([item.system for item in fits if isinstance(item.system, ResidualHybrid)])
        check_forgets(system, leftovers)
        return replace(
            gray,
            system=system,
            relative_error=float(np.mean([item.relative_error for item in fits])),
            seconds=gray.seconds + sum(item.seconds for item in fits),
            evaluations=gray.evaluations + sum(item.evaluations for item in fits),
        )

    def _beside(self, system: ResidualHybrid, leftovers: Sequence[Leftover]) -> Fit:
        """A model of the residual, while the gray box stays as it is."""
        return fit(
            system,
            [leftover.begun(system) for leftover in leftovers],
            ridge=float(self.chosen["ridge"]),
            hold=[item.name for item in system.physics.parameters],
            tolerance=RESIDUAL_TOLERANCE,
            iterations=RESIDUAL_ITERATIONS,
            progress=self.progress,
        )

    def _one(
        self,
        structure: str,
        records: Sequence[Record],
        *,
        start: Fit | None = None,
        anchor: Fit | None = None,
        hold: Sequence[str] = (),
        stages: Sequence[int | None] = STAGES,
        member: int = 0,
    ) -> Fit:
        """One fit by least squares on compiled rollouts; start: of the physics."""
        known = options_of(structure, self.rig.system, self.rig.structures)
        options = {name: value for name, value in self.chosen.items() if name in known}
        seed = self.seed + 1000 * member
        systems, neutral = self._built(structure, records, options, seed)
        if start is not None:
            systems = [replace(item, physics=start.system) for item in systems if isinstance(item, Hybrid)]
        windows = windows_of(self.rig)
        if windows is not None and options.get("input_bias"):
            raise UserError(f"input_bias: {self.rig.name} is unstable, and windows tell no bias: leave it out")
        fits, reasons = [], []
        for plain in systems:
            system = self._biased(plain, options)
            try:
                found = fit(
                    system,
                    [prepare(record, system, self.sampling) for record in records],
                    stages=stages,
                    anchor=anchor,
                    ridge=float(options.get("ridge", 1.0)),
                    hold=(*neutral, *hold),
                    starts=int(options.get("starts", 1)) if start is None else 1,
                    seed=seed,
                    windows=windows,
                    progress=self.progress,
                )
                fits.append(_unbiased(found))
            except UserError as error:
                reasons.append(error)
        if not fits:
            raise reasons[0]
        best = min(fits, key=lambda item: item.relative_error)
        seconds, evaluations = (sum(values) for values in zip(*((f.seconds, f.evaluations) for f in fits), strict=True))
        return replace(best, seconds=seconds, evaluations=evaluations)

    def _biased(self, system: System, options: Options) -> System:
        """The system with a bias of each record's inputs, where that is asked for."""
        spans = np.diff(self.rig.limits, axis=0)[0]
        spreads = float(options.get("input_bias", 0.0)) * spans
        return Biased(physics=system, spreads=tuple(spreads.tolist())) if np.any(spreads) else system

    def _built(
        self, structure: str, records: Sequence[Record], options: Options, seed: int
    ) -> tuple[Sequence[System], tuple[str, ...]]:
        """The system where fits begin: a linear one at what regression tells of it, and at the rig's own guess; and the
        names of parameters that are held.
        """
        experiments = [prepare(record, self.rig.system, self.sampling) for record in records]
        sizes = magnitudes(self.rig.system, experiments)
        system, neutral = build(
            structure,
            self.rig.system,
            scales=sizes.scales,
            centre=sizes.centre,
            features=sizes.features,
            unshown=sizes.unshown,
            seed=seed,
            options=options,
            boxes=self.rig.structures,
        )
        first = begun(system, experiments)
        if isinstance(first, Hybrid):
            first = placed(first, experiments, seed=seed)
        alike = np.array_equal(first.values, system.values)
        return [first, system] if isinstance(system, Linear) and not alike else [first], neutral

    def _narx(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """Terms by error reduction, then their coefficients by the error of the simulation."""
        sampling = replace(self.sampling, step=self.sampling.period)
        options = {name: int(value) for name, value in self.chosen.items()}
        chosen = select_terms(
            [prepare(record, self.rig.system, sampling) for record in records],
            outputs=self.rig.system.outputs,
            inputs=self.rig.system.inputs,
            output_lags=options["output_lags"],
            input_lags=options["input_lags"],
            degree=options["degree"],
            terms=options["terms"] or None,
        )
        experiments = [prepare(record, chosen, sampling) for record in records]
        return fit(chosen, experiments, ridge=NARX_RIDGE, progress=self.progress), sampling

    def _takagi_sugeno(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """Rules from clusters and least squares, then all of their numbers by the error of the simulation."""
        options, system = {name: int(value) for name, value in self.chosen.items()}, self.rig.system
        lags = options["output_lags"], options["input_lags"]
        regressors = lags[0] * len(system.outputs) + lags[1] * len(system.inputs)
        choose = partial(
            select_rules,
            rules=options["rules"] or None,
            premises=range(regressors) if options["all_premises"] else None,
            ellipsoids=bool(options["gustafson_kessel"]),
        )
        return self._fuzzy(choose, records)

    def _difnn(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """Terms from clusters and links from counts, then all centres and widths by the error of the simulation."""
        options = {name: int(value) for name, value in self.chosen.items()}
        return self._fuzzy(partial(select_links, terms=options["terms"], least=options["least"]), records)

    def _fuzzy(self, choose: Callable[..., Lagged], records: Sequence[Record]) -> tuple[Fit, Sampling]:
        sampling, system = replace(self.sampling, step=self.sampling.period), self.rig.system
        chosen = choose(
            [prepare(record, system, sampling) for record in records],
            outputs=system.outputs,
            inputs=system.inputs,
            output_lags=int(self.chosen["output_lags"]),
            input_lags=int(self.chosen["input_lags"]),
            seed=self.seed,
        )
        experiments = [prepare(record, chosen, sampling) for record in records]
        return tuned(chosen, experiments, progress=self.progress), sampling

    def _recurrent(self, records: Sequence[Record]) -> tuple[Fit, Sampling]:
        """Gradients through time."""
        period = self.sampling.period
        sampling = replace(self.sampling, step=step_within(period) if self.sampling.input == "averaged" else period)
        units, system = int(self.chosen["units"]), self.rig.system
        return train(records, system, sampling, units=units, seed=self.seed, progress=self.progress), sampling


def _unbiased(found: Fit) -> Fit:
    """A fit of the system without its biases, which are told beside it."""
    system = found.system
    return (
        replace(found, system=system.physics, biases=system.biases(found.nuisances))
        if isinstance(system, Biased)
        else found
    )

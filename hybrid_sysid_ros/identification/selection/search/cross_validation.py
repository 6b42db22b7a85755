"""What a search maximises: how well a structure predicts records that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part, Validation, cross_validate, identify
from hybrid_sysid_ros.identification.fitting import alone
from hybrid_sysid_ros.models import Model, Option, Options, Sampling, options_of
from hybrid_sysid_ros.rigs.rig import Rig

COSTLY = ("members", "starts")
"""Options that only buy less chance with more time: there is nothing to search in them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CrossValidation:
    """The cross-validated free run of a structure over parts of records, as a function of the structure's options."""

    records: Sequence[Record]
    rig: Rig
    structure: str
    sampling: Sampling
    part: Part
    seed: int = 0
    folds: int = 3

    def __post_init__(self) -> None:
        # Workers are sent what is fitted only.
        object.__setattr__(self, "records", tuple(replace(record, channels={}) for record in self.records))

    def __call__(self, options: Options) -> Validation:
        """As a worker does it: in one thread, beside others."""
        with alone():
            return cross_validate(
                self.records,
                self.rig,
                self.structure,
                sampling=self.sampling,
                part=self.part,
                options=options,
                seed=self.seed,
                folds=self.folds,
            )

    @property
    def space(self) -> Mapping[str, Option]:
        """The options that are searched. Raises UserError for an unknown structure."""
        known = options_of(self.structure, self.rig.system)
        return {name: option for name, option in known.items() if name not in COSTLY}

    @property
    def problem(self) -> dict[str, Any]:
        """Everything that the scores depend on."""
        return {
            "rig": self.rig.name,
            "structure": self.structure,
            "records": {record.name: record.fingerprint for record in self.records},
            "sampling": asdict(self.sampling),
            "part": f"{self.part.start:g}:{self.part.stop:g}",
            "seed": self.seed,
            "folds": self.folds,
            "options": {name: [option.kind, option.low, option.high] for name, option in self.space.items()},
        }

    def fit(self, options: Options) -> Model:
        """The structure fitted to the parts of all records."""
        return identify(
            self.records,
            self.rig,
            self.structure,
            sampling=self.sampling,
            part=self.part,
            options=options,
            seed=self.seed,
        )

"""What an experiment has shown: a model's deviations before its record, as expected of it, and after a fit to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.experiment_design.information import Fisher, Knowledge
from hybrid_sysid_ros.identification.identify import experiment_of, identify
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.structure import structure_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class InformationGain:
    """Values and standard deviations of a model's free numbers, (free,) each, in their units."""

    names: tuple[str, ...]
    values: Array
    """Of the model."""
    found: Array
    """Of a fit to the record alone."""
    before: Array
    expected: Array
    """What the inputs of the record should have shown by the model's sensitivities."""
    after: Array
    """Of the model and the record together."""

    @property
    def moved(self) -> Array:
        """How far each number is from that of the model, in the deviation of the difference, (free,)."""
        alone = 1.0 / np.sqrt(np.maximum(self.after**-2.0 - self.before**-2.0, 1e-300))
        return np.asarray(np.abs(self.found - self.values) / np.hypot(self.before, alone))


def gained(model: Model, rig: Rig, record: Record) -> InformationGain:
    """What a record has shown. Raises UserError for a record that the model's structure can't be fitted to, and for a
    model whose structure has other options or free numbers by now.
    """
    knowledge = Knowledge.of(model)
    experiment = experiment_of(model, record)
    alone = _fitted_alone(model, rig, record)
    fisher = Fisher.of(model, rig, knowledge.sizes)
    new = Knowledge.of(alone)
    ratio = np.outer(knowledge.sizes / new.sizes, knowledge.sizes / new.sizes)
    return InformationGain(
        names=model.names,
        values=_numbers(model),
        found=_numbers(alone),
        before=knowledge.deviations(),
        expected=knowledge.deviations(fisher.information(model.system, experiment.inputs, experiment.states[0])),
        after=knowledge.deviations(new.information * ratio),
    )


def _fitted_alone(model: Model, rig: Rig, record: Record) -> Model:
    """A fit of a model's structure to a record, with the same options and free numbers."""
    options, structure = model.fit.get("options", {}), model.structure
    known = structure_of(structure, rig.system, rig.structures).options
    if gone := [name for name in options if name not in known]:
        raise UserError(
            f"the model was fitted with option {', '.join(gone)}, which {structure} no longer has: identify it again"
        )
    alone = identify([record], rig, structure, sampling=model.sampling, options=options)
    if alone.names != model.names:
        raise UserError(
            f"{record.name}: a fit of {structure} to it has {len(alone.names)} free numbers, which are not the model's "
            f"{len(model.names)}: identify the model again"
        )
    return alone


def _numbers(model: Model) -> Array:
    """Values of the free numbers, (free,)."""
    known = {**{f"weight_{k}": float(v) for k, v in enumerate(model.system.weights)}, **model.system.named}
    return np.array([known[name] for name in model.names])

"""Notes of the training records of a model that was made when less was noted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.identification.identify import checked, scores_of, training_notes
from hybrid_sysid_ros.identification.part import parts_of, without_gaps
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

ALIKE = 0.01
"""Difference of scores by which a record is the same: another rule for the start of a run makes some thousandths."""


def notes_of(model: Model, records: Sequence[Record], rig: Rig) -> dict[str, Any]:
    """What :func:`~hybrid_sysid_ros.identification.identify` notes of training records, by name.

    records: those that it was fitted to, in any order, and maybe more. One is known by its digest, or by the model's
    score over it, since the same record may be written as bag anew. Raises UserError where one is missing or another.
    """
    given = {record.name: record for record in records}
    if lacking := [entry["name"] for entry in model.records if entry["name"] not in given]:
        raise UserError(f"the model was fitted to {', '.join(lacking)} as well: give all bags that it was fitted to")
    noted = []
    for entry in model.records:
        record, (start, stop) = given[entry["name"]], entry.get("part", (0.0, 1.0))
        used = without_gaps(parts_of([record], Part(start=start, stop=stop), model.sampling), model.sampling)
        experiments = [checked(each, rig, model.sampling).experiment(model.system) for each in used]
        if record.digest != entry.get("sha256"):
            for item in experiments:
                then, now = model.scores[item.name]["r2"], scores_of(model.system, item, rig).r2
                if not abs(now - then) <= ALIKE:
                    raise UserError(
                        f"{item.name}: the model scored {then:.4f} over it, and now {now:.4f}: not the same"
                    )
        noted += experiments
    return training_notes(rig, model, model.fit.get("options", {}), noted, model.training_range, leave_out=True)

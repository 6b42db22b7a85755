"""The scores of the loop that is done again, under the rig's feedback or its loops of one output."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.shared.feedback_resimulation import follow_again
from hybrid_sysid_ros.extensions.shared.resimulation import resimulate
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig


def scores_again(model: Model, record: Record, rig: Rig, part: Part) -> dict[str, Any]:
    """Plain data, as the scores of a free run. Raises UserError where the loop can't be done again."""
    given: dict[str, Any] = {"sampling": model.sampling, "part": part}
    if rig.experiments.feedback is None:
        return resimulate(model.system, record, rig, **given).output.content
    return follow_again(model.system, record, rig, **given).scores.content

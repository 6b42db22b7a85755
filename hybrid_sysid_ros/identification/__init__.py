"""Identification: models are fitted to records, scored and validated."""

from hybrid_sysid_ros.identification.experiment import PreparedRecord, prepare
from hybrid_sysid_ros.identification.identify import evaluate, identify, notes_of
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.selection.cross_validation import Validation, cross_validate
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score

__all__ = [
    "Part",
    "PreparedRecord",
    "Scores",
    "Validation",
    "cross_validate",
    "evaluate",
    "free_run",
    "identify",
    "notes_of",
    "prepare",
    "score",
]

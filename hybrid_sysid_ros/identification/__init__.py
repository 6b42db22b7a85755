"""Identification: models are fitted to records, scored and validated."""

from hybrid_sysid_ros.identification.experiment import PreparedRecord, prepare
from hybrid_sysid_ros.identification.identify import evaluate, identify
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.validation.scores import Scores, free_run, score

__all__ = [
    "Part",
    "PreparedRecord",
    "Scores",
    "evaluate",
    "free_run",
    "identify",
    "prepare",
    "score",
]

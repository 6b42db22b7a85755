"""Records out of bags, fitting, scores, judgement."""

from hybrid_sysid_ros.identification.experiment import Experiment, prepare
from hybrid_sysid_ros.identification.identify import evaluate, identify
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.scores import Scores, free_run, score
from hybrid_sysid_ros.identification.validation import Validation, cross_validate

__all__ = [
    "Experiment",
    "Part",
    "Scores",
    "Validation",
    "cross_validate",
    "evaluate",
    "free_run",
    "identify",
    "prepare",
    "score",
]

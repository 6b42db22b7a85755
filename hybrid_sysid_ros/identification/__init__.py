"""Records out of bags, fitting, scores."""

from hybrid_sysid_ros.identification.experiment import Experiment, prepare
from hybrid_sysid_ros.identification.identify import Part, evaluate, identify
from hybrid_sysid_ros.identification.scores import Scores, free_run, score

__all__ = ["Experiment", "Part", "Scores", "evaluate", "free_run", "identify", "prepare", "score"]

"""Searches for the options of a structure: what is searched, the study that keeps it, the workers that evaluate it."""

from hybrid_sysid_ros.search.cluster import Cluster
from hybrid_sysid_ros.search.cross_validation import CrossValidation
from hybrid_sysid_ros.search.evaluation import Objective, Outcome
from hybrid_sysid_ros.search.search import search
from hybrid_sysid_ros.search.study import Study, Trial, opened
from hybrid_sysid_ros.search.workers import Processes, Workers

__all__ = [
    "Cluster",
    "CrossValidation",
    "Objective",
    "Outcome",
    "Processes",
    "Study",
    "Trial",
    "Workers",
    "opened",
    "search",
]

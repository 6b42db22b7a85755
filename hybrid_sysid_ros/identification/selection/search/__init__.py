"""Searches for the options of a structure: what is searched, the study that keeps it, the workers that evaluate it."""

from hybrid_sysid_ros.identification.selection.search.cluster import Cluster
from hybrid_sysid_ros.identification.selection.search.cross_validation import CrossValidation
from hybrid_sysid_ros.identification.selection.search.evaluation import Objective, Outcome
from hybrid_sysid_ros.identification.selection.search.search import search
from hybrid_sysid_ros.identification.selection.search.study import Study, Trial, opened
from hybrid_sysid_ros.identification.selection.search.workers import Processes, Workers

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

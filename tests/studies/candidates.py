"""Candidates of a comparison with scores that a test chooses."""

import numpy as np

from hybrid_sysid_ros.extensions.search.cross_validation import Validation
from hybrid_sysid_ros.models import Model, Sampling
from studies.beam_lecture.candidate import Candidate
from tests.one_joint import Linear


def candidate(structure, scores, *, parameters):
    """A structure with these held-out scores and so many parameters."""
    names = tuple(f"number_{i}" for i in range(parameters))
    model = Model(
        rig="cam_beam",
        structure="linear",
        system=Linear(),
        sampling=Sampling(),
        names=names,
        covariance=np.eye(parameters),
        training_range={},
        fit={"seconds": 1.0},
    )
    found = Validation(scores={str(i): score for i, score in enumerate(scores)}, seconds=1.0)
    return Candidate(structure=structure, models=[model], r2=[{"test": 0.5}], validation=found)

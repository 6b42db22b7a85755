"""What a record has shown, by a fit to it alone, which must be of the same free numbers as the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.experiment_design.gain import gained
from hybrid_sysid_ros.extensions.experiment_design.tests.test_design import GAIN, LAG, STEP, model, rig
from hybrid_sysid_ros.extensions.experiment_design.tests.test_remarks import recorded
from hybrid_sysid_ros.support.errors import UserError


def test_a_record_shows_its_parameters_and_knows_them_better_than_before() -> None:
    """The record's level answers the valve a step early, which a lag without a delay takes for itself."""
    found = gained(model(), rig(), recorded(np.sign(np.sin(np.arange(2001) * 0.005))))
    np.testing.assert_allclose(found.found, [GAIN, LAG - STEP], rtol=0.01)
    assert np.all(found.after < found.before)


def test_a_model_whose_structure_has_changed_since_is_refused() -> None:
    record = recorded(np.sign(np.sin(np.arange(1001) * 0.02)))
    older = replace(model(), fit={"options": {"shifts": 0.0}})
    with pytest.raises(UserError, match="the model was fitted with option shifts, which gray no longer has"):
        gained(older, rig(), record)
    fewer = replace(model(), names=("gain",), covariance=np.array([[0.01]]))
    with pytest.raises(UserError, match="lag: a fit of gray to it has 2 free numbers, which are not the model's 1"):
        gained(fewer, rig(), record)

"""Records that can't be used: each is named, with the reason."""

from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.search.cross_validation import cross_validate
from hybrid_sysid_ros.identification import evaluate, identify
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_bench import bench, record_of
from tests.structures import FURTHER

REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "constant output": ({"y": np.full((2001, 1), 0.1)}, {}, "output position is constant"),
    "no input": ({"u": np.zeros((2001, 1))}, {}, "bench: input drive is constant: no excitation"),
    "constant input": ({"u": np.full((2001, 1), 3.0)}, {}, "bench: input drive is constant: no excitation"),
    "too short": ({"samples": 60}, {}, r"bench: 0\.2\d s are too short: at least 0\.45 s"),
    "period": ({}, {"step": 0.012, "period": 0.012}, r"bench: the scored period of 12 ms is no multiple of 5 ms"),
    "step": (
        {},
        {"step": 0.002, "period": 0.05},
        r"sampling time of 5 ms is no multiple of 2 ms, the integration step",
    ),
}


@pytest.mark.parametrize("structure", ["gray", "black_box"])
@pytest.mark.parametrize("case", REFUSED)
def test_a_record_that_cannot_be_used_is_named_with_the_reason(rig, case, structure):
    changes, sampling, reason = REFUSED[case]
    with pytest.raises(UserError, match=reason) as raised:
        identify([bench(**changes)], rig, structure, sampling=Sampling(**sampling))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "structure",
    ["linear", "gray", "hybrid", "black_box", *(name for name in FURTHER if name not in ("recurrent", "residual"))],
)
def test_a_record_in_degrees_among_others_is_named(rig, structure):
    """The linear model would take both, and fit neither."""
    degrees = bench(name="degrees", y=30 * np.sin(np.arange(2001) / 50.0)[:, None])
    reason = r"^degrees: range_low would be -[\d.]+ rad .*, outside of \[-1, 1\]; its unit or scale is probably wrong"
    with pytest.raises(UserError, match=reason):
        identify([bench(), degrees], rig, structure, sampling=Sampling())
    with pytest.raises(UserError, match=reason):
        cross_validate([bench(), degrees], rig, structure, sampling=Sampling())


def test_a_record_at_another_rate_than_the_model_s_says_what_goes_for_fit_and_score(rig):
    """Who scores a model has no say in its steps."""
    model = identify([bench()], rig, "linear", sampling=Sampling())
    other = record_of(bench().input, bench().output, 0.027, name="other")
    known = "other: the scored period of 50 ms is no multiple of 27 ms, the record's sampling time"
    for use in (lambda: evaluate(model, other), lambda: identify([other], rig, "linear", sampling=Sampling())):
        with pytest.raises(UserError, match=f"{known}; fit the model with a step and period that are .*, or sample"):
            use()


def test_no_record_is_nothing_to_fit(rig):
    with pytest.raises(UserError, match="no record"):
        identify([], rig, "linear", sampling=Sampling())


def test_one_record_at_rest_among_others_is_named(rig):
    """It has no R2, so it can't stand in the table of scores."""
    still = bench(name="still", y=np.full((2001, 1), 0.1))
    with pytest.raises(UserError, match="still: output position is constant"):
        identify([bench(), still], rig, "linear", sampling=Sampling())
    model = identify([bench()], rig, "linear", sampling=Sampling())
    with pytest.raises(UserError, match="still: the measured output is constant"):
        evaluate(model, still)


def test_a_record_of_other_channels_does_not_fit_a_model(rig):
    model = identify([bench()], rig, "linear", sampling=Sampling())
    both = bench()
    wide = record_of(np.hstack([both.input, both.input]), both.output, 0.005, name="wide")
    with pytest.raises(UserError, match="wide: 2 inputs and 1 outputs, but the model has 1 and 1"):
        evaluate(model, wide)
    with pytest.raises(UserError, match="wide: 2 inputs and 1 outputs"):
        identify([wide], rig, "linear", sampling=Sampling())

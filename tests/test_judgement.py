"""A free run is judged in a word, and the reason is what decides it."""

from __future__ import annotations

import pytest

from hybrid_sysid_ros.identification.validation.judgement import judgement, noise_floors
from hybrid_sysid_ros.rigs.rig import load

RIG, PERIOD = load("cam_beam"), 0.05


@pytest.mark.parametrize(
    ("r2", "noises", "held", "words"),
    [
        (0.98, 1.5, 0.9, "good: it explains 98.0 % of the variance, its error is 1.5 times the sensor's noise alone"),
        (0.7, 12.0, 0.4, "fair: it explains 70.0 % of the variance, its error is 12 times the sensor's noise, its 90 % "
         "band holds 40 %: the model is too sure of itself, or the record differs in rig, scale or time"),
        (0.95, 99.0, 0.02, "fair: it explains 95.0 % of the variance, its error is 99 times the sensor's noise, its 90 "
         "% band holds 2 %: the model is too sure of itself, or the record differs in rig, scale or time"),
        (-79.0, 300.0, 0.9, "useless: the mean of the record would be nearer (R2 -79.00)"),
    ],
)  # fmt: skip
def test_a_run_is_judged_by_variance_noise_and_bands(r2, noises, held, words):
    scores = {"r2": r2, "rmse": noises * noise_floors(RIG, PERIOD)["position"], "fit_percent": 0.0}
    found = judgement(scores, RIG, PERIOD, {"0.9": {"position": {"held": held, "half": 1.0}}})
    assert found == {"position": words}


def test_a_limit_holds_however_well_a_run_fits():
    scores = {"r2": 0.99, "rmse": 1e-9, "fit_percent": 90.0}
    (words,) = judgement(scores, RIG, PERIOD, {}, ["its law is a guess"]).values()
    assert words.startswith("fair: ")
    assert words.endswith(", its law is a guess")


def test_a_hum_is_no_noise_where_its_periods_fit_into_the_sampling():
    """The beam's sensor has 60 Hz, .048 V, and .02 V of white noise (rig.yaml)."""
    scale = RIG.sensors[0].scale
    assert noise_floors(RIG, 0.05)["position"] == pytest.approx(0.02 * scale, rel=0.02)
    assert noise_floors(RIG, 0.005)["position"] == pytest.approx(0.052 * scale, rel=0.02)

"""Ensembles: the mean of free runs and their spread, on numbers that can be seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.extensions.ensemble.ensemble import Ensemble, ensemble
from hybrid_sysid_ros.identification import evaluate
from hybrid_sysid_ros.identification.validation.unstable import UnstableError
from hybrid_sysid_ros.models import Model, Sampling, load
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.parameters import shipped
from hybrid_sysid_ros.support.errors import UserError
from tests.shared import exact_model

BAGS = Path(__file__).parents[4] / "bags"
MULTISINE = BAGS / "beam_multisine"


def test_members_that_err_to_either_side_make_a_mean_without_error() -> None:
    """Two that are off by -1 and +1: the mean is exact, their deviation sqrt 2, and the band holds all samples."""
    measured = np.sin(np.arange(50.0))[:, None]
    found = Ensemble(names=["y"], measured=measured, members=np.stack([measured - 1.0, measured + 1.0]))
    *members, mean = found.scores
    assert mean.r2 == pytest.approx(1.0)
    assert [score.rmse for score in members] == pytest.approx([1.0, 1.0])
    np.testing.assert_allclose(found.spread, np.sqrt(2.0))
    assert found.covered.tolist() == [1.0]


def test_members_that_err_alike_do_not_hold_the_measurement() -> None:
    measured = np.sin(np.arange(50.0))[:, None]
    found = Ensemble(names=["y"], measured=measured, members=np.stack([measured + 1.0, measured + 1.1]))
    assert found.scores[-1].rmse == pytest.approx(1.05)
    assert found.covered.tolist() == [0.0]


@pytest.fixture(scope="module")
def beams() -> list[Model]:
    """The beam itself, and one whose drive is weaker by a tenth."""
    rig = rigs.load("cam_beam")
    model = exact_model(rig)
    weaker = [0.9 * value if name == "gain" else value for name, value in rig.system.named.items()]
    return [model, replace(model, system=rig.system.with_values(weaker))]


def test_its_members_are_the_models_own_free_runs(beams: list[Model]) -> None:
    rig = rigs.load("cam_beam")
    record = bags.read(MULTISINE, rig.signals)
    found = ensemble(beams, record)
    assert [score.r2 for score in found.scores[:2]] == [evaluate(model, record).r2 for model in beams]
    np.testing.assert_allclose(found.mean, found.members.mean(axis=0))


def test_models_that_do_not_go_together_are_refused(beams: list[Model]) -> None:
    record = bags.read(MULTISINE, rigs.load("cam_beam").signals)
    with pytest.raises(UserError, match="two models or more"):
        ensemble(beams[:1], record)
    with pytest.raises(UserError, match=r"several periods, 0\.05 s, 0\.1 s"):
        ensemble([beams[0], replace(beams[1], sampling=Sampling(period=0.1))], record)


def test_open_free_runs_of_an_unstable_rig_are_refused() -> None:
    model = load(shipped("winged_cone", "model"))
    record = bags.read(BAGS / "winged_cone_flight", rigs.load("winged_cone").signals)
    with pytest.raises(UnstableError, match="is meaningless for an unstable system"):
        ensemble([model, model], record)

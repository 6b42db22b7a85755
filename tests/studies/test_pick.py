"""Which structure a comparison picks: the simplest within one standard error of the best."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling, build
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture import candidate as candidates
from studies.beam_lecture.candidate import Candidate
from studies.beam_lecture.comparison import RULE, Comparison, choose, compare
from tests.studies.candidates import candidate


def test_the_simplest_within_one_standard_error_of_the_best_is_chosen():
    # The best has mean 0.9 and standard error sqrt((0.04 + 0 + 0.04) / 2 / 3) = 0.1155.
    best = candidate("best", [0.7, 0.9, 1.1], parameters=50)
    assert best.validation.standard_error == pytest.approx(0.1155, abs=1e-4)
    inside = candidate("inside", [0.79] * 3, parameters=20)
    outside = candidate("outside", [0.78] * 3, parameters=5)
    assert choose([best, outside]) == "best"
    assert choose([best, inside, outside]) == "inside"
    assert choose([outside, inside, best]) == "inside"  # the order of asking is no matter


def test_it_is_the_best_one_s_error_that_counts():
    """A structure that is wide of it does not get in by its own uncertainty."""
    best = candidate("best", [0.9, 0.901, 0.899], parameters=50)
    unsure = candidate("unsure", [-0.5, 0.9, 0.9], parameters=5)
    assert choose([best, unsure]) == "best"


def test_of_equally_simple_ones_the_better_is_chosen():
    best = candidate("best", [0.7, 0.9, 1.1], parameters=50)
    twins = [candidate("a", [0.85] * 3, parameters=7), candidate("b", [0.86] * 3, parameters=7)]
    assert choose([best, *twins]) == "b"


def test_tests_have_no_say():
    """What is chosen stays so whatever the scores on the test records are."""
    pair = [candidate("simple", [0.89, 0.9, 0.91], parameters=5), candidate("rich", [0.89, 0.9, 0.92], parameters=9)]
    assert choose(pair) == "simple"
    assert choose([replace(pair[0], r2=[{"test": -9.0}]), replace(pair[1], r2=[{"test": 1.0}])]) == "simple"


def test_a_structure_whose_test_cannot_be_simulated_stays_a_candidate(linear_records, rig, monkeypatch):
    def refused(model, record, part):
        raise UserError("an open free run means nothing")

    monkeypatch.setattr(candidates, "evaluate", refused)
    tests = [(linear_records[2], Part(stop=0.2))]
    found = compare(linear_records[:2], tests, rig, ["linear"], sampling=Sampling(), part=Part(stop=0.2), jobs=1)
    assert found.chosen == "linear"
    assert found.candidates[0].r2 == [{linear_records[2].name: -np.inf}]


def test_failed_candidates_are_not_chosen():
    failed = Candidate(structure="failed", error="no")
    assert choose([failed]) == ""
    assert choose([]) == ""
    assert choose([failed, candidate("only", [-1.0, -1.0], parameters=3)]) == "only"
    undefined = candidate("undefined", [np.nan, 0.9], parameters=1)
    assert choose([undefined, candidate("only", [0.1, 0.2], parameters=3)]) == "only"


def test_weights_count_as_parameters_once():
    """A fit that names its weights, as a black box's does, and one that does not, as a recurrent network's."""
    system, _ = build("black_box", CamBeam(), scales=np.ones(3), seed=0, options={"units": 2})
    weights = tuple(f"weight_{i}" for i in range(len(system.weights)))
    plain = candidate("black_box", [0.9, 0.9], parameters=0)
    for names, expected in ((("gain", "damping", *weights), 12), (("gain",), 11), ((), 10)):
        model = replace(plain.models[0], system=system, names=names)
        assert replace(plain, models=[model]).parameters == expected


def test_the_pick_records_how_it_was_picked():
    chosen, other = candidate("a", [0.8, 0.9], parameters=3), candidate("b", [0.7, 0.9], parameters=5)
    failed = Candidate(structure="c", error="no")
    model = Comparison(candidates=[other, failed, chosen], chosen="a", seconds=1.0).model()
    assert model.fit["choice"]["rule"] == RULE
    assert model.fit["choice"]["structures"] == {
        "a": {"r2": pytest.approx(0.85), "standard_error": pytest.approx(0.05), "parameters": 3},
        "b": {"r2": pytest.approx(0.8), "standard_error": pytest.approx(0.1), "parameters": 5},
    }
    assert model.fit["seconds"] == 1.0

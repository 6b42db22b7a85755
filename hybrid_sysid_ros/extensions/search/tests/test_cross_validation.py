"""Blocked cross-validation: what is held out is never seen, and no block decides about all the rest."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.search.cross_validation import (
    BLOCKS,
    WORST,
    Validation,
    blocks_of,
    cross_validate,
)
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.structures.gray_box import GrayBox
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear


@pytest.fixture
def records(linear_records):
    """Records whose input tells which sample of which record it is."""
    return [
        replace(record, input=1e6 * i + np.arange(record.samples, dtype=float)[:, None])
        for i, record in enumerate(linear_records)
    ]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_blocks_share_no_sample_and_leave_none_out(records, count):
    blocks = blocks_of(records[:count], Sampling())
    assert len(blocks) == BLOCKS
    samples = np.concatenate([block.input[:, 0] for block in blocks])
    expected = np.concatenate([record.input[:, 0] for record in records[:count]])
    np.testing.assert_array_equal(np.sort(samples), np.sort(expected))
    for block in blocks:
        assert np.all(np.diff(block.input[:, 0]) == 1.0)  # in one piece


def test_blocks_are_sorted_from_calm_to_wide(records):
    deviations = [np.std(block.output) for block in blocks_of(records, Sampling())]
    assert deviations == sorted(deviations)
    assert deviations[-1] > 3 * deviations[0]


def test_blocks_are_named_by_their_record_and_place(records):
    assert {block.name for block in blocks_of(records[:1], Sampling())} == {f"linear_6V {i}/6" for i in range(1, 7)}
    many = [replace(records[i % 3], name=f"record {i}") for i in range(7)]
    assert sorted(block.name for block in blocks_of(many, Sampling())) == [
        f"record {i}" for i in range(7)
    ]  # enough as they are


@pytest.fixture
def watched(monkeypatch):
    """The blocks that every fit was given, in turn."""
    given = []
    plain = GrayBox.fit

    def fit(structure, context):
        given.append(list(context.records))
        return plain(structure, context)

    monkeypatch.setattr(GrayBox, "fit", fit)
    return given


@pytest.mark.parametrize("folds", [2, 3, 6])
def test_no_fit_sees_what_it_is_scored_on(linear_records, rig, watched, folds):
    found = cross_validate(linear_records, rig, "linear", sampling=Sampling(), folds=folds)
    blocks = blocks_of(linear_records, Sampling())
    names = {block.name for block in blocks}
    assert len(watched) == folds
    held = [names - {block.name for block in given} for given in watched]
    assert sorted(name for group in held for name in group) == sorted(names)  # each is held out once
    assert set(found.scores) == names
    by_name = {block.name: block for block in blocks}
    for group, given in zip(held, watched, strict=True):
        for name in group:
            # Positions of a motion hardly ever repeat to the last bit, but all records begin at 0.
            out = set(by_name[name].output.ravel()) - {0.0}
            assert not any(out & set(block.output.ravel()) for block in given)


def test_the_groups_go_from_the_calmest_to_the_widest(linear_records, rig, watched):
    cross_validate(linear_records, rig, "linear", sampling=Sampling(), folds=3)
    order = [block.name for block in blocks_of(linear_records, Sampling())]
    for i, given in enumerate(watched):
        assert [block.name for block in given] == order[: 2 * i] + order[2 * i + 2 :]


def test_a_linear_beam_is_predicted_by_a_linear_model(linear_records, rig):
    found = cross_validate(linear_records, rig, "linear", sampling=Sampling())
    assert min(found.scores.values()) > 0.9999
    assert found.value == pytest.approx(np.mean(list(found.scores.values())))
    assert found.standard_error < 1e-4
    assert found.seconds > 0


def test_only_the_part_that_is_asked_for_is_used(linear_records, rig, watched):
    cross_validate(linear_records, rig, "linear", sampling=Sampling(), part=Part(stop=0.5))
    first_halves = np.concatenate([record.part(0.0, 0.5).output for record in linear_records])
    used = np.concatenate([block.output for given in watched for block in given])
    assert set(used.ravel()) == set(first_halves.ravel())


def test_a_structure_that_diverges_scores_at_worst_minus_one_a_block(linear_records, rig, monkeypatch):
    plain = GrayBox.fit

    def diverging(structure, context):
        unstable = Linear(gain=5.0, centre=0.9, stiffness=-500.0, damping=0.0)
        return replace(plain(structure, context), system=unstable)

    monkeypatch.setattr(GrayBox, "fit", diverging)
    found = cross_validate(linear_records, rig, "linear", sampling=Sampling())
    assert max(found.scores.values()) < -1e6
    assert found.value == WORST == -1.0
    assert found.standard_error == 0.0


def test_one_block_that_diverges_does_not_decide_about_the_rest():
    found = Validation(scores={"a": 0.9, "b": -np.inf, "c": 0.8, "d": -5e9}, seconds=1.0)
    assert found.value == pytest.approx((0.9 - 1.0 + 0.8 - 1.0) / 4)
    assert found.standard_error == pytest.approx(np.std([0.9, -1.0, 0.8, -1.0], ddof=1) / 2)


@pytest.mark.parametrize("folds", [0, 1, 7])
def test_folds_are_two_at_least_and_not_more_than_blocks(linear_records, rig, folds):
    with pytest.raises(UserError, match=f"{folds} folds; choose 2 to 6"):
        cross_validate(linear_records, rig, "linear", sampling=Sampling(), folds=folds)


def test_a_block_in_which_nothing_moves_is_not_scored_and_stops_nothing(rig, linear_records):
    record = linear_records[0]
    output = record.output.copy()
    output[: len(output) // 6 + 1] = output[0]
    resting = replace(record, name="resting", output=output)
    validation = cross_validate([resting], rig, "linear", sampling=Sampling())
    assert set(validation.scores) == {f"resting {i}/6" for i in range(2, 7)}


def test_records_that_can_not_be_cross_validated_are_refused(linear_records, rig):
    with pytest.raises(UserError, match="no record"):
        cross_validate([], rig, "linear", sampling=Sampling())
    with pytest.raises(UserError, match=r"linear_6V \d/6: .* too short"):
        cross_validate([linear_records[0].part(0.0, 0.2)], rig, "linear", sampling=Sampling())
    still = replace(linear_records[0], name="still", input=np.ones_like(linear_records[0].input))
    with pytest.raises(UserError, match=r"still: input drive is constant"):
        cross_validate([still, *linear_records[1:]], rig, "linear", sampling=Sampling())
    with pytest.raises(UserError, match="structure 'magic' is unknown"):
        cross_validate(linear_records, rig, "magic", sampling=Sampling())


def test_blocks_are_cut_at_scored_samples(linear_records):
    """A grid that begins elsewhere reads a sampled input at other instants: a jump then comes a period earlier."""
    numbered = [replace(record, output=np.arange(record.samples, dtype=float)[:, None]) for record in linear_records]
    for period, every in ((0.05, 10), (0.035, 7)):
        blocks = blocks_of(numbered[:1], Sampling(period=period))
        assert len(blocks) == BLOCKS
        assert all(block.output[0, 0] % every == 0 for block in blocks)


def test_alike_folds_hold_out_a_third_of_every_record(linear_records, rig, watched):
    """So that what only one record shows is trained on in each fold, and scored in each."""
    found = cross_validate(linear_records, rig, "linear", sampling=Sampling(), folds=3, alike=True)
    names = {f"{record.name} {i}/3" for record in linear_records for i in (1, 2, 3)}
    assert set(found.scores) == names
    for i, given in enumerate(watched, 1):
        assert names - {block.name for block in given} == {f"{record.name} {i}/3" for record in linear_records}

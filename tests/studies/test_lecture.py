"""The lecture's protocols, names and published tables."""

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.models import structure_names
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture import lecture
from studies.beam_lecture.lecture import (
    COLUMNS,
    FIRST_HALF,
    PUBLISHED,
    SECOND_HALF,
    WHOLE,
    arrange,
    published,
    table_name,
)

MULTISINES = ["05_multisine_01", "06_multisine_02"]
STEPS = [f"03_random_steps_0{i}" for i in range(1, 5)]
SWEPT = "04_swept_sine"


def record(name):
    return Record(name=name, time=np.arange(10, dtype=np.float64), input=np.zeros((10, 1)), output=np.zeros((10, 1)))


@pytest.fixture
def author_s():
    """In the order in which a folder lists them."""
    return [record(name) for name in sorted([*MULTISINES, *STEPS, SWEPT])]


def test_protocol_1_trains_on_whole_multisines_and_tests_on_all_records(author_s):
    protocol = arrange(author_s, 1)
    assert [item.name for item in protocol.training] == MULTISINES
    assert protocol.part == WHOLE
    assert [(item.name, part) for item, part in protocol.tests] == [
        (name, WHOLE) for name in (*MULTISINES, *STEPS, SWEPT)
    ]


def test_protocol_2_trains_on_first_halves_and_tests_on_what_no_model_has_seen(author_s):
    protocol = arrange(author_s, 2)
    assert [item.name for item in protocol.training] == [*MULTISINES, *STEPS]
    assert protocol.part == FIRST_HALF
    assert [(item.name, part) for item, part in protocol.tests] == [
        *((name, SECOND_HALF) for name in (*MULTISINES, *STEPS)),
        (SWEPT, WHOLE),
    ]
    assert (FIRST_HALF.start, FIRST_HALF.stop, SECOND_HALF.start, SECOND_HALF.stop) == (0.0, 0.5, 0.5, 1.0)


@pytest.mark.parametrize("number", [1, 2])
def test_tests_stand_in_the_order_of_the_tables(author_s, number):
    protocol = arrange(author_s, number)
    assert tuple(table_name(item.name) for item, _ in protocol.tests) == COLUMNS
    assert protocol.about.startswith("Trained on")


def test_bags_of_other_names_are_arranged_by_their_kind():
    names = ["beam_swept_sine", "beam_random_steps", "beam_multisine"]
    protocol = arrange([record(name) for name in names], 1)
    assert [item.name for item in protocol.training] == ["beam_multisine"]
    assert [item.name for item, _ in protocol.tests] == ["beam_multisine", "beam_random_steps", "beam_swept_sine"]
    assert [table_name(name) for name in names] == names


@pytest.mark.parametrize("kind", ["multisine", "random_steps"])
@pytest.mark.parametrize("number", [1, 2])
def test_a_kind_of_record_that_is_missing_is_named(author_s, number, kind):
    with pytest.raises(UserError, match=f"protocol {number}: no record has {kind} in its name"):
        arrange([item for item in author_s if kind not in item.name], number)


def test_protocol_3_adds_the_whole_slow_ramp_to_the_halves_of_protocol_2(author_s):
    protocol = arrange([record("02_rampa_negativa"), *author_s], 3)
    assert [item.name for item in protocol.training] == [*MULTISINES, *STEPS, "02_rampa_negativa"]
    assert protocol.parts == [FIRST_HALF] * 6 + [WHOLE]
    assert [table_name(item.name) for item, _ in protocol.tests] == [*COLUMNS, "ramp_02"]
    assert protocol.tests[:-1] == arrange([*protocol.training[:-1], protocol.tests[6][0]], 2).tests
    with pytest.raises(UserError, match="protocol 3: no record has ramp in its name"):
        arrange(author_s, 3)


@pytest.mark.parametrize("number", [0, 4, -1])
def test_there_are_three_protocols(author_s, number):
    with pytest.raises(UserError, match=f"protocol {number}: there are protocols 1 and 2"):
        arrange(author_s, number)


@pytest.mark.parametrize(
    ("name", "short"),
    [
        ("05_multisine_01", "ms_05"),
        ("06_multisine_02", "ms_06"),
        ("03_random_steps_01", "rs_01"),
        ("03_random_steps_04", "rs_04"),
        ("04_swept_sine", "swept"),
        ("my_multisine", "my_multisine"),
        ("bench", "bench"),
    ],
)
def test_records_have_the_names_of_the_tables(name, short):
    assert table_name(name) == short


def test_published_values_are_those_of_the_tables():
    """Spot values of tables 1 and 2: corners, the best, and the worst."""
    assert published(1, "linear") == dict(
        zip(COLUMNS, (0.8511, 0.8404, 0.7439, 0.6846, 0.58, 0.3755, 0.8637), strict=True)
    )
    values = {
        (1, "stribeck", "rs_04"): 0.4907,
        (1, "hybrid_frozen", "ms_05"): 0.9821,
        (1, "hybrid_frozen", "rs_03"): 0.3235,
        (2, "linear", "ms_05"): 0.4025,
        (2, "black_box", "ms_05"): -3.973,
        (2, "hybrid_joint", "swept"): 0.9532,
        (2, "hybrid_frozen", "swept"): 0.5814,
    }
    for (number, structure, column), value in values.items():
        row = published(number, structure)
        assert row is not None
        assert row[column] == value


def test_what_the_lecture_has_not_is_not_published():
    assert published(1, "gray") is None
    assert published(2, "lugre") is None
    for rows in PUBLISHED.values():
        assert set(rows) <= set(structure_names())
        assert all(len(row) == len(COLUMNS) and max(row) < 1.0 for row in rows.values())


def test_a_folder_without_records_gets_one_line(tmp_path):
    with pytest.raises(UserError, match="no such folder"):
        lecture.read_folder(tmp_path / "nowhere")
    with pytest.raises(UserError, match=r"neither \.mat files nor bags are there"):
        lecture.read_folder(tmp_path)


@pytest.mark.slow
def test_the_author_s_folder_holds_both_protocols(author_records):
    """His .mat files are found in the folder or in bab below it, and read as they are."""
    assert sorted(item.name for item in author_records) == sorted([*MULTISINES, *STEPS, SWEPT])
    for number in PUBLISHED:
        assert len(arrange(author_records, number).tests) == 7
    assert {round(item.sampling_time, 9) for item in author_records} == {0.001}

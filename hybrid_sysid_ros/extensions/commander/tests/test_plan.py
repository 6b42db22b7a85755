"""Plans: their shapes by closed forms, units by their definitions, and files that are columns of numbers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.commander.language import grammar
from hybrid_sysid_ros.extensions.commander.language.files import Files
from hybrid_sysid_ros.extensions.commander.language.plan import plan_of
from hybrid_sysid_ros.extensions.commander.language.reference_plan import Ability, ReferencePlan, needed
from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary, slips
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs import units
from hybrid_sysid_ros.support.errors import UserError

BEAM = Vocabulary.of(rigs.load("cam_beam"))
FAST = Ability(speed=np.array([1e3]), acceleration=np.array([1e5]))


def plan(text: str, ability: Ability = FAST, folder: str = "", start: float = 0.0) -> ReferencePlan:
    sentence = grammar.read(text, BEAM, Files(folder=folder))
    return plan_of(sentence.commands, np.array([start]), BEAM, ability, stops=sentence.stops)


def test_a_smooth_move_has_the_peaks_of_minimum_jerk() -> None:
    """15/8 d/T and 10/sqrt(3) d/T^2, by differences of the plan itself."""
    made = plan("go to 4 V in 2 s")
    speeds = np.diff(made.values[:, 0]) / np.diff(made.times)
    assert speeds.max() == pytest.approx(15.0 / 8.0 * 4.0 / 2.0, rel=2e-3)
    accelerations = np.diff(speeds) / np.diff(made.times)[1:]
    assert np.abs(accelerations).max() == pytest.approx(10.0 / math.sqrt(3.0) * 4.0 / 2.0**2, rel=5e-3)
    assert made.duration == pytest.approx(2.0)


def test_a_move_takes_the_time_that_speed_and_acceleration_leave() -> None:
    """By the slower of the two: d 15/8 / v, and sqrt(d 10/sqrt(3) / a)."""
    slow = Ability(speed=np.array([2.0]), acceleration=np.array([1e5]))
    assert plan("go to 4 V quickly", slow).duration == pytest.approx(4.0 * 15.0 / 8.0 / (0.8 * 2.0))
    heavy = Ability(speed=np.array([1e5]), acceleration=np.array([3.0]))
    assert plan("go to 4 V quickly", heavy).duration == pytest.approx(math.sqrt(4.0 * 10 / math.sqrt(3) / (0.8 * 3.0)))


def test_a_swing_is_a_cosine_from_its_first_value() -> None:
    made = plan("swing between -1 and 3 V at 0.25 Hz for 8 s")
    begin = made.duration - 8.0
    times = np.linspace(0.0, 8.0, 500)
    wanted = 1.0 - 2.0 * np.cos(2.0 * np.pi * 0.25 * times)
    np.testing.assert_allclose(made(begin + times)[:, 0], wanted, atol=0.01)


@pytest.mark.parametrize("hertz", [0.5, 1.0, 3.0])
def test_a_swing_is_refused_from_where_its_peaks_are_out_of_reach(hertz: float) -> None:
    """Pi f (b - a) of speed: at the limit it goes, above it not."""
    peak = math.pi * hertz * 2.0
    enough = Ability(speed=np.array([1.001 * peak]), acceleration=np.array([1e5]))
    short = Ability(speed=np.array([0.999 * peak]), acceleration=np.array([1e5]))
    text = f"swing between -1 and 1 V at {hertz} Hz for 2 s"
    assert plan(text, enough).duration > 2.0
    with pytest.raises(UserError, match="reaches"):
        plan(text, short)


def test_steps_stand_for_half_a_period_each() -> None:
    made = plan("step between -1 and 1 V every 2 s for 8 s")
    assert made.jumps
    np.testing.assert_allclose(made([1.0, 3.0, 5.0, 7.0])[:, 0], [-1.0, 1.0, -1.0, 1.0])


def test_straight_lines_stay_within_their_tolerance() -> None:
    times = np.linspace(0.0, 10.0, 4001)
    rows = np.stack([np.sin(times), np.where(times > 4.0, 1.0, 0.0)], axis=1)
    kept = needed(times, rows, [1e-3, 1e-3])
    for column in rows.T:
        assert np.abs(np.interp(times, times[kept], column[kept]) - column).max() <= 1e-3 + 1e-12
    assert len(kept) < 400


@pytest.mark.parametrize(
    ("text", "base", "per", "factor"),
    [
        ("deg", "rad", 0, math.pi / 180), ("rpm", "rad", 1, math.pi / 30), ("mV", "V", 0, 1e-3), ("km", "m", 0, 1e3),
        ("deg/s", "rad", 1, math.pi / 180), ("m/s^2", "m", 2, 1.0), ("turns/min", "rad", 1, 2 * math.pi / 60),
        ("millivolts", "V", 0, 1e-3), ("ms", "s", 0, 1e-3), ("hours", "s", 0, 3600.0), ("kHz", "Hz", 0, 1e3),
        ("DEGREES", "rad", 0, math.pi / 180), ("km/h", "m", 1, 1 / 3.6),
    ],
)  # fmt: skip
def test_units_are_what_the_si_says(text: str, base: str, per: int, factor: float) -> None:
    found = units.named(text)
    assert found is not None
    assert (found.base, found.per) == (base, per)
    assert found.factor == pytest.approx(factor)


def test_what_is_no_unit_is_none() -> None:
    assert [units.named(text) for text in ("", "bananas", "V/m", "/s", "s//", "v/w")] == [None] * 6


@pytest.mark.parametrize(
    ("word", "other", "count"),
    [("hold", "hold", 0), ("hodl", "hold", 1), ("hol", "hold", 1), ("hoold", "hold", 1), ("bold", "hold", 1),
     ("kitten", "sitting", 3), ("ca", "abc", 3)],  # the last two by Wagner and Fischer, and by optimal alignment
)  # fmt: skip
def test_slips_are_counted_as_damerau_did(word: str, other: str, count: int) -> None:
    assert slips(word, other, 5) == count
    assert slips(other, word, 5) == count


def test_a_file_is_followed_in_its_own_units(tmp_path: Path) -> None:
    (tmp_path / "moves.csv").write_text("time, position [deg]\n0, 0\n1, 1.3\n3, -2.6\n", encoding="utf-8")
    made = plan("follow moves.csv", folder=str(tmp_path))
    np.testing.assert_allclose(made([0.0, 0.5, 1.0, 2.0, 3.0])[:, 0], [0.0, 0.5, 1.0, -0.5, -2.0], atol=0.02)


@pytest.mark.parametrize(
    "content",
    [
        "", "time\n0\n1\n", "a, b\n1, 2\n3, 4\n", "time, position\n0, 0\n", "time, position\n0, x\n1, 2\n",
        "time, position\n0, nan\n1, 2\n", "time, position\n0, 0\n0, 1\n", "time, position\n0, 0\n1\n",
        "time, velocity\n0, 0\n1, 1\n", "time, position [m]\n0, 0\n1, 1\n", "time, position\n0, 0\n1e-9, 5\n",
        "time, position\n0, 0\n1, 500\n", "time, position\n0, 0\n1e9, 1\n",
    ],
)  # fmt: skip
def test_a_file_that_is_no_plan_is_refused_in_a_line(tmp_path: Path, content: str) -> None:
    (tmp_path / "moves.csv").write_text(content, encoding="utf-8")
    with pytest.raises(UserError) as refusal:
        plan("follow moves.csv", folder=str(tmp_path))
    assert "\n" not in str(refusal.value)


def test_no_file_outside_of_the_folder_is_read(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "secret.csv").write_text("time, position\n0, 0\n1, 1\n", encoding="utf-8")
    (inside / "link.csv").symlink_to(tmp_path / "secret.csv")
    for name in ("'../secret.csv'", "link.csv", "nothing.csv", f"'{tmp_path / 'secret.csv'}'"):
        with pytest.raises(UserError, match="folder"):
            plan(f"follow {name}", folder=str(inside))


@pytest.mark.parametrize(
    "text", ["go to 2 V, wait 1 s, then go back to where you were", "jump to 2 V and back", "vá para 2 V e volte"]
)
def test_back_in_a_sentence_is_where_that_sentence_began(text: str) -> None:
    made = plan(text, start=1.0)
    assert made.values[:, 0].max() == pytest.approx(2.0)
    assert made.values[-1, 0] == pytest.approx(1.0)


def test_back_is_asked_about_where_there_are_two_places() -> None:
    with pytest.raises(UserError, match=r"back to 1 V or to 2 V of position\?"):
        plan("go to 2 V, then 3 V, then go back", start=1.0)


def test_peak_to_peak_is_twice_the_amplitude() -> None:
    made = plan("swing 4 Vpp at 0.5 Hz for 10 s")
    assert (made.values[:, 0].min(), made.values[:, 0].max()) == pytest.approx((-2.0, 2.0), abs=1e-3)


def test_the_maximum_is_the_upper_end_of_the_set_points() -> None:
    assert plan("go to the maximum").values[-1, 0] == pytest.approx(BEAM.outputs[0].high)


def test_values_in_a_row_have_a_time_each() -> None:
    made = plan("hold 1 V for 5 s, 2 V for 5 s, 0 V")
    assert [made(np.array([seconds]))[0, 0] for seconds in (3.0, 8.0)] == pytest.approx([1.0, 2.0], abs=1e-6)


def test_a_portuguese_a_says_how_fast_where_a_rate_follows() -> None:
    assert plan("suba até 3 V a meio volt por segundo").duration == pytest.approx(15.0 / 8.0 * 3.0 / 0.5)


def test_repeat_before_a_colon_is_asked_about() -> None:
    with pytest.raises(UserError, match="repeat what follows, or what was carried out before"):
        plan("repeat: go to 1 V, go to -1 V")


@pytest.mark.parametrize("text", ["double the speed", "go to speed -10 m/s then double the speed"])
def test_a_share_of_a_speed_that_counts_from_elsewhere_is_refused(text: str) -> None:
    """Twice -10 m/s is slower, and of 0 nothing."""
    cone = Vocabulary.of(rigs.load("winged_cone"))
    sentence = grammar.read(text, cone, Files())
    with pytest.raises(UserError, match="say by how much"):
        plan_of(sentence.commands, np.zeros(2), cone, Ability(speed=np.full(2, 1e6), acceleration=np.full(2, 1e6)))

"""A film's time found in a bag's, and the lamp's onset, against the shifts that were put in."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.reading.lamp import brightness, onset
from hybrid_sysid_ros.extensions.vision.reading.synchronisation import synchronise
from hybrid_sysid_ros.extensions.vision.scene import Lamp
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


def _times(begin: float, end: float, step: float) -> Array:
    return np.arange(begin, end, step, dtype=np.float64)


def _motion(times: Array, seed: int = 0) -> Array:
    random = np.random.default_rng(seed)
    lines = [(random.uniform(0.1, 2.0), random.uniform(0, 6.3)) for _ in range(12)]
    return np.asarray(np.sum([0.02 * np.sin(2 * np.pi * f * times + phase) for f, phase in lines], axis=0))


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_shift_rate_scale_and_offset_come_back(seed: int) -> None:
    random = np.random.default_rng(seed)
    shift, rate, scale, offset = random.uniform(-4, 4), random.uniform(-1e-4, 1e-4), 1.03, -0.02
    bag = _times(0.0, 50.0, 0.005)
    hum = 1e-3 * np.sin(2 * np.pi * 60.0 * bag)
    positions = _motion(bag, seed) + hum + 4e-4 * random.standard_normal(len(bag))
    true = _times(1.0, 48.0, 1 / 30.002)
    angles = (_motion(true, seed) - offset) / scale + 7e-5 * random.standard_normal(len(true))
    found = synchronise((true - shift) / (1 + rate), angles, bag, positions)
    assert np.abs(found.time((true - shift) / (1 + rate)) - true).max() < 3e-4
    assert found.rate == pytest.approx(rate, abs=5e-6)
    assert found.scale == pytest.approx(scale, abs=1e-3)
    assert found.offset == pytest.approx(offset, abs=1e-4)
    errors = np.array([found.shift - shift, found.rate - rate, found.scale - scale, found.offset - offset])
    assert (np.abs(errors) < 5 * found.deviations).all()


def test_a_long_exposure_changes_no_scale() -> None:
    """The mean over an exposure e of a motion of frequency w is smaller by sin(w e / 2) / (w e / 2): .7 % at 2 Hz."""
    bag, film, exposure, turn = _times(0.0, 20.0, 0.005), _times(0.5, 19.0, 1 / 30), 0.033, 4.0 * np.pi
    smaller = np.sinc(turn * exposure / 2.0 / np.pi)
    found = synchronise(film, 0.1 * smaller * np.sin(turn * film), bag, 0.1 * np.sin(turn * bag), exposure=exposure)
    assert found.scale == pytest.approx(1.0, abs=2e-4)
    assert synchronise(film, 0.1 * np.sin(turn * film), bag, 0.1 * np.sin(turn * bag)).scale == pytest.approx(
        1.0, abs=2e-4
    )


@pytest.mark.parametrize("side", [0.0, 0.5])
def test_a_view_from_the_side_bends_the_angles_by_what_is_reported(side: float) -> None:
    """A bar that is looked at from the side by s: tan(seen) = tan(true) / cos(s), about a true angle of .6 rad."""
    bag, film = _times(0.0, 40.0, 0.005), _times(0.5, 39.0, 1 / 30)
    noise = 7e-5 * np.random.default_rng(0).standard_normal(len(film))
    true = 0.6 + _motion(film)
    seen = np.arctan(np.tan(true) / np.cos(side))
    bent = np.polynomial.Polynomial.fit(seen, true, 1)(seen) - true
    found = synchronise(film, seen + noise, bag, 0.6 + _motion(bag))
    assert found.bend == pytest.approx(np.sqrt(np.mean(bent**2)), rel=0.1, abs=1e-5)


@pytest.mark.parametrize("held", [0.0, 3e-3])
def test_what_a_film_is_off_by_for_some_pictures_is_told_by_the_bag(held: float) -> None:
    """A codec that keeps a picture until the joint is a step farther: a uniform error, which no picture tells."""
    random = np.random.default_rng(0)
    bag, film = _times(0.0, 40.0, 0.005), _times(0.5, 39.0, 1 / 30)
    positions = _motion(bag) + 1e-3 * random.standard_normal(len(bag)) + 1e-3 * np.sin(2 * np.pi * 60.0 * bag)
    angles = _motion(film)
    seen = held * np.round(angles / held) if held else angles
    noise = np.full(len(film), 7e-5)
    found = synchronise(film, seen + noise * random.standard_normal(len(film)), bag, positions)
    assert found.unexplained(noise) == pytest.approx(held / np.sqrt(12.0), rel=0.15)


def test_film_and_bag_of_two_motions_are_refused() -> None:
    bag, film = _times(0.0, 40.0, 0.005), _times(0.0, 40.0, 1 / 30)
    with pytest.raises(UserError, match="not the bag's"):
        synchronise(film, _motion(film, 1), bag, _motion(bag, 2))


@pytest.mark.parametrize(("taken", "written"), [(30, 25), (60, 30), (30, 60), (120, 30)])
def test_a_film_with_times_of_another_rate_is_refused(taken: int, written: int) -> None:
    """As it comes about where pictures are numbered instead of timed."""
    bag = _times(0.0, 40.0, 0.005)
    true = _times(0.5, 39.0, 1 / taken)
    noise = 7e-5 * np.random.default_rng(0).standard_normal(len(true))
    with pytest.raises(UserError, match=f"runs {written / taken:.3g} times as fast as the bag"):
        synchronise(np.arange(len(true)) / written, _motion(true) + noise, bag, _motion(bag))


@pytest.mark.parametrize("share", [1 / 40, 1 / 12])
def test_a_film_that_lost_pictures_and_numbers_the_others_is_refused(share: float) -> None:
    """Here and there one is missing, so that its times run unevenly beside the bag's, and are no other rate's."""
    random = np.random.default_rng(0)
    bag, true = _times(0.0, 20.0, 0.005), _times(0.5, 19.5, 1 / 30)
    true = true[random.random(len(true)) > share]
    angles = _motion(true) + 7e-5 * random.standard_normal(len(true))
    with pytest.raises(UserError, match="pictures missing"):
        synchronise(np.arange(len(true)) / 30, angles, bag, _motion(bag))


def test_a_mirrored_film_is_refused() -> None:
    bag, film = _times(0.0, 20.0, 0.005), _times(0.5, 19.0, 1 / 30)
    with pytest.raises(UserError, match="mirrored"):
        synchronise(film, -_motion(film), bag, _motion(bag))


@pytest.mark.parametrize("off", [0.0, 2e-3])
def test_times_that_wander_are_reported_by_how_much(off: float) -> None:
    """By some milliseconds, as those of a screen that was recorded, which angles are uncertain by, too."""
    random = np.random.default_rng(0)
    bag, film = _times(0.0, 40.0, 0.005), _times(0.5, 39.0, 1 / 30)
    late, noise = off * random.standard_normal(len(film)), 7e-5 * random.standard_normal(len(film))
    found = synchronise(film, _motion(film + late) + noise, bag, _motion(bag))
    assert found.wander == pytest.approx(off, rel=0.15, abs=2e-4)


def test_a_motion_that_is_none_is_refused() -> None:
    bag, film = _times(0.0, 40.0, 0.005), _times(0.0, 40.0, 1 / 30)
    with pytest.raises(UserError, match="nothing moves"):
        synchronise(film, np.zeros(len(film)), bag, _motion(bag))


def _lamp(times: Array, start: float, exposure: float) -> Array:
    return np.asarray(20.0 + 150.0 * np.clip((times + exposure / 2 - start) / exposure, 0.0, 1.0))


@pytest.mark.parametrize("start", [2.0, 2.003, 2.01, 2.0166, 2.02, 2.03])
def test_the_onset_lies_where_its_deviation_says(start: float) -> None:
    exposure, times = 0.008, _times(0.0, 6.0, 1 / 30)
    noise = 0.3 * np.random.default_rng(0).standard_normal(len(times))
    found = onset(times, _lamp(times, start, exposure) + noise, exposure=exposure)
    assert abs(found.time - start) < 2.0 * found.deviation
    assert found.deviation < 0.01


@pytest.mark.parametrize("start", [-1.0, 100.0])
def test_a_lamp_that_was_lit_before_or_never_tells_no_time(start: float) -> None:
    times = _times(0.0, 6.0, 1 / 30)
    noise = 0.3 * np.random.default_rng(0).standard_normal(len(times))
    with pytest.raises(UserError, match="no lamp goes on"):
        onset(times, _lamp(times, start, 0.008) + noise, exposure=0.008)


def test_somebody_who_walks_by_is_no_lamp() -> None:
    """What becomes brighter there for a second, and dark again."""
    times = _times(0.0, 6.0, 1 / 30)
    seen = _lamp(times, 2.0, 0.008) + 20.0 - _lamp(times, 3.0, 0.008)
    with pytest.raises(UserError, match="no lamp goes on"):
        onset(times, seen, exposure=0.008)


def test_the_brightness_is_that_of_the_disc() -> None:
    picture = np.full((360, 640), 30, dtype=np.uint8)
    picture[295:307, 58:70] = 200
    assert brightness(picture, Lamp(at=(0.1, 0.47), radius=0.005)) == 200.0

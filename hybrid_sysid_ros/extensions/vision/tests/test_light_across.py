"""Light that leans from side to side, against the lean that was put in."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.light_across import light_across
from hybrid_sysid_ros.support.arrays import Array

WALL: Array = np.random.default_rng(0).uniform(60.0, 140.0, (90, 320))
ACROSS: Array = np.linspace(-1.0, 1.0, 320)


def _film(leans: Array, light: float = 1.0) -> Iterator[tuple[float, Picture]]:
    """A wall under lights that lean, before which somebody dark walks by."""
    random = np.random.default_rng(1)
    for number, lean in enumerate(leans):
        shown = light * WALL * (1.0 + lean * ACROSS) + 2.0 * random.standard_normal(WALL.shape)
        shown[:, 3 * number : 3 * number + 50] = 30.0
        yield number / 30.0, np.clip(shown + 0.5, 0.0, 255.0).astype(np.uint8)


def test_a_lean_is_found_and_taken_out() -> None:
    leans = 0.2 * np.sin(2.0 * np.pi * np.arange(80) / 40.0)
    found = light_across(lambda: _film(leans), WALL)
    assert found is not None
    assert found.leans == pytest.approx(leans, abs=0.02)
    even = found.taken_out(list(_film(leans))[10][1], 10)
    assert np.median(even[:, 250:] / WALL[:, 250:]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("light", [1.0, 0.5])
def test_light_that_does_not_lean_is_left_as_it_is(light: float) -> None:
    assert light_across(lambda: _film(np.zeros(80), light)) is None


def test_what_is_white_stays_white() -> None:
    found = light_across(lambda: _film(0.2 * np.ones(80)), WALL)
    assert found is not None
    assert (found.taken_out(np.full((90, 320), 255, dtype=np.uint8), 0) == 255).all()

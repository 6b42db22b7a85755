"""A picture out of focus is known by its edges, not by its light or by who walks by."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("cv2", reason="needs the extra video")

import cv2

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.focus import sharpness, soft_pictures


def _picture(seed: int, *, light: float = 1.0, blur: float = 0.7, walker: float | None = None) -> Picture:
    """Shelves and boxes, with the noise of a camera; walker: the brightness of one who hides a third of it."""
    random, picture = np.random.default_rng(3), np.full((180, 320), 120.0, dtype=np.float32)
    for _ in range(60):
        x, y, size = random.integers(0, 300), random.integers(0, 160), random.integers(8, 40)
        picture[y : y + size, x : x + 2 * size] = random.uniform(20.0, 220.0)
    if walker is not None:
        picture[20:, 90:200] = walker
    seen = light * cv2.GaussianBlur(picture, (0, 0), blur)
    return np.clip(seen + np.random.default_rng(seed).normal(0.0, 1.0, seen.shape), 0, 255).astype(np.uint8)


def test_pictures_out_of_focus_are_found_and_no_others() -> None:
    sharp = [_picture(k) for k in range(20)]
    others = [_picture(30, light=0.4), _picture(31, light=1.3), _picture(32, walker=30.0), _picture(33, walker=200.0)]
    soft = [_picture(40 + k, blur=blur) for k, blur in enumerate((3.0, 4.0, 7.0))]
    found = soft_pictures(np.array([sharpness(each) for each in [*sharp, *others, *soft]]))
    assert np.flatnonzero(found).tolist() == [24, 25, 26]

"""How a camera turns, by features that stand."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import motion_of_camera
from hybrid_sysid_ros.extensions.vision.reading.feature_tracker import (
    FeatureTracker,
    moved,
    standing_features,
    tell_lens,
)
from hybrid_sysid_ros.support.errors import UserError

ROWS, COLUMNS, FOCAL = 180, 320, 0.9 * 320


def _turned(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    lens = np.array([[FOCAL, 0.0, COLUMNS / 2], [0.0, FOCAL, ROWS / 2], [0.0, 0.0, 1.0]])
    pose = lens @ cv2.Rodrigues(vector)[0] @ np.linalg.inv(lens)
    return np.asarray(pose / pose[2, 2])


@pytest.fixture(scope="module")
def wall() -> Picture:
    cells = np.random.default_rng(0).uniform(20, 230, (45, 80)).astype(np.float32)
    return np.asarray(cv2.resize(cells, (COLUMNS, ROWS), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8))


def test_the_lens_of_a_camera_that_turns_is_told_by_its_pictures(wall: Picture) -> None:
    turns = np.random.default_rng(1).normal(0.0, [0.03, 0.03, 0.01], (9, 3))
    turns[4] = 0.0
    few = [
        np.asarray(
            cv2.warpPerspective(wall, _turned(turn), (COLUMNS, ROWS), borderMode=cv2.BORDER_REFLECT), dtype=np.uint8
        )
        for turn in turns
    ]
    standing = standing_features(cv2, few[4], few, 0.5)
    assert standing is not None
    features, tripod = standing
    assert not tripod
    tracker = FeatureTracker(cv2, few[4], features)
    tell_lens(tracker, few, 0.5)
    assert not tracker.flat
    assert tracker.focal == pytest.approx(FOCAL, rel=0.1)
    pose, _ = tracker.pose(few[0], np.eye(3), 0.5)
    ends = np.array([[80.0, 90.0], [240.0, 90.0], [160.0, 20.0], [160.0, 160.0]])
    assert np.abs(moved(pose[None], ends) - moved(_turned(turns[0])[None], ends)).max() < 0.05


@pytest.mark.parametrize("light", [0.5, 1.4])
def test_features_are_followed_under_another_light(wall: Picture, light: float) -> None:
    few = [np.clip(wall * gain, 0.0, 255.0).astype(np.uint8) for gain in np.linspace(light, 1.0, 9)]
    standing = standing_features(cv2, few[8], few, 0.5)
    assert standing is not None
    assert standing[1]  # a tripod
    assert len(standing[0]) > 50


def test_features_beside_something_that_passes_do_not_roll_the_camera() -> None:
    """All of the lower right quarter are half a pixel off, which a homography would follow there."""
    random = np.random.default_rng(2)
    features = random.uniform([5, 5], [COLUMNS - 5, ROWS - 5], (120, 2)).astype(np.float32)
    there = moved(_turned(np.array([0.01, -0.02, 0.005]))[None], features)[0]
    there += 0.05 * random.standard_normal(there.shape)
    there[(features[:, 0] > COLUMNS / 2) & (features[:, 1] > ROWS / 2), 1] += 0.5
    tracker = FeatureTracker(cv2, np.zeros((ROWS, COLUMNS), dtype=np.uint8), features)
    tracker.flat, tracker.focal = False, FOCAL
    pose, _ = tracker.fitted(there.astype(np.float32), np.ones(len(features), dtype=bool), 1.0)
    turned = pose @ np.linalg.inv(_turned(np.array([0.01, -0.02, 0.005])))
    one, two = moved(turned[None], np.array([[COLUMNS * 0.6, 150.0], [COLUMNS * 0.9, 150.0]]))[0]
    assert math.degrees(math.atan2(two[1] - one[1], two[0] - one[0])) == pytest.approx(0.0, abs=0.03)


def test_a_camera_that_shakes_while_rows_are_read_tears_pictures(wall: Picture) -> None:
    """The lower half lies 1.5 pixels beside the upper one there, also in the one that others are compared with."""
    random, film = np.random.default_rng(0), list[Picture]()
    for k in range(40):
        x, y = random.normal(0.0, 1.0, 2)
        places = np.indices((ROWS, COLUMNS)).astype(np.float32)
        beside = np.where(np.arange(ROWS) > ROWS / 2, 1.5, 0.0)[:, None] * (k in (7, 20, 33))
        seen = cv2.remap(
            wall, places[1] + np.float32(x) + beside.astype(np.float32), places[0] + np.float32(y), cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REFLECT,
        )  # fmt: skip
        film.append(np.asarray(seen))
    motion = motion_of_camera(lambda: iter([(k / 30.0, picture) for k, picture in enumerate(film)]))
    assert motion is not None
    assert np.flatnonzero(motion.torn).tolist() == [7, 20, 33]


def test_features_that_a_codec_moves_before_a_tripod_tear_no_picture(wall: Picture) -> None:
    """By .7 pixels here and there, for half a second, as where a film is compressed strongly."""
    field = cv2.GaussianBlur(np.random.default_rng(0).normal(0.0, 1.0, (ROWS, COLUMNS, 2)), (0, 0), 8.0)
    beside = (0.7 * field / field.std()).astype(np.float32)
    places = np.indices((ROWS, COLUMNS)).astype(np.float32)
    drifted = cv2.remap(wall, places[1] + beside[..., 0], places[0] + beside[..., 1], cv2.INTER_CUBIC)
    film = [drifted if 20 <= k < 35 else wall for k in range(60)]
    motion = motion_of_camera(lambda: iter([(k / 30.0, np.asarray(picture)) for k, picture in enumerate(film)]))
    assert motion is not None
    assert motion.torn.sum() <= 2  # where it begins and ends, at most


def test_a_camera_that_was_knocked_over_is_refused(wall: Picture) -> None:
    """In a fifth of a second, so that no two pictures are of two takes."""
    x = 140.0 / (1.0 + np.exp(-(np.arange(60) - 30.0)))
    places = np.indices((ROWS, COLUMNS)).astype(np.float32)
    film = [
        (k / 30.0, cv2.remap(wall, places[1] + np.float32(beside), places[0], cv2.INTER_LINEAR).astype(np.uint8))
        for k, beside in enumerate(x)
    ]
    with pytest.raises(UserError, match="the camera was moved"):
        motion_of_camera(lambda: iter(film))

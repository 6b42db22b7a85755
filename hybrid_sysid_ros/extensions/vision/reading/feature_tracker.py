"""Feature tracker: what stands in the pictures of a camera that may move, followed from one to the others (OpenCV)."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture

PARTS, IN_PART, FEWEST = (8, 5), 6, 12  # of a picture, features in each, and features
LIT_ALIKE = 0.005  # relative difference of two pictures' light, below which it is left as it is
FAINTEST, SHARPNESS = 4, 0.003  # counts across a corner, and share of the sharpest one in its part
APART = 1 / 60  # widths between two features
BODIES = 3  # that go together, of which one may be what stands
STANDING = 0.75  # share of the sampled pictures in which a feature must go with the others
LEAST_SHARE = 0.3  # of the features must go together
ITERATIONS = 570  # after which a RANSAC of four features has seen such a share with 99 %: log .01 / log (1 - .3^4)
BESIDE = 1.0  # pixels of 640: farther off, a feature does not go with them
UNMOVED = 0.35  # pixels of 640: features that are no farther off than that in most pictures are those of a tripod
WIDE = 0.35  # share of the picture along each axis that features must span, to tell more than a shift
FLATTER = 0.85  # of the other residuals, those of homographies that are worth their four numbers more
FOCALS = 0.5 * 2.0 ** (np.arange(13) / 4)  # widths: lenses from 90 to 14 degrees
TURNS, SMALL = 6, 1e-6  # steps to the pose of a camera that turns, and differences that tell its slopes
BISQUARE = 4.685  # deviations; see alignment.py


class FeatureTracker:
    """Finds features of a reference in other pictures."""

    def __init__(self, cv2: Any, reference: Picture, features: NDArray[np.float32]) -> None:
        self.cv2, self.reference, self.features, self.flat = cv2, reference, features, True
        self.focal = 0.0
        """Of the lens, where a camera that is not flat turns about its place [pixels]; 0: poses are homographies."""

    def found(self, picture: Picture, pose: NDArray[np.float64]) -> NDArray[np.float32]:
        """Where the features are (features, 2), from a pose on that is near; NaN where they are not found."""
        near = moved(pose[None], self.features)[0].astype(np.float32)
        places, status, _ = self.cv2.calcOpticalFlowPyrLK(
            self.reference, self._lit_alike(picture), self.features.reshape(-1, 1, 2), near.reshape(-1, 1, 2).copy(),
            winSize=(21, 21), maxLevel=3, criteria=(3, 30, 0.003), flags=self.cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=1e-5,
        )  # fmt: skip
        places = places.reshape(-1, 2)
        places[status.ravel() == 0] = np.nan
        return np.asarray(places)

    def _lit_alike(self, picture: Picture) -> Picture:
        """A picture under the light of the reference, as features are followed by their brightness."""
        few, own = picture[::8, ::8].astype(np.float64), self.reference[::8, ::8]
        light = float(np.median(own / np.maximum(few, 1.0)))
        return picture if abs(light - 1.0) < LIT_ALIKE else np.asarray(self.cv2.convertScaleAbs(picture, alpha=light))

    def pose(self, picture: Picture, near: NDArray[np.float64], scale: float) -> tuple[NDArray[np.float64], float]:
        """The pose of a picture, and its features' distances from it, rms [pixels]; NaN where there are too few."""
        pose, residual, _ = self.pose_and_rest(picture, near, scale)
        return pose, residual

    def pose_and_rest(
        self, picture: Picture, near: NDArray[np.float64], scale: float
    ) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
        """The same, and where each feature (features, 2) lies beside its place by the pose [pixels], also of those that
        do not go with it; NaN where it is not found.
        """
        if picture.shape != self.reference.shape:
            return near, np.nan, np.full(self.features.shape, np.nan)
        places = self.found(picture, near)
        there = np.isfinite(places[:, 0])
        pose, residual = self.fitted(places, there, scale)
        return pose, residual, places - moved(pose[None], self.features)[0]

    def fitted(
        self, places: NDArray[np.float32], there: NDArray[np.bool_], scale: float
    ) -> tuple[NDArray[np.float64], float]:
        """The same, of features that are found at places."""
        if there.sum() < FEWEST / 2:
            return np.eye(3), np.nan
        one, other = self.features[there], places[there]
        if self.flat:
            similarity, kept = self.cv2.estimateAffinePartial2D(
                one, other, method=self.cv2.RANSAC, ransacReprojThreshold=BESIDE * scale
            )
            if similarity is None:
                return np.eye(3), np.nan
            pose = np.vstack([similarity, [0.0, 0.0, 1.0]])
        else:
            pose, kept = self.cv2.findHomography(one, other, self.cv2.RANSAC, BESIDE * scale, maxIters=ITERATIONS)
            if pose is None:
                return np.eye(3), np.nan
        kept = kept.ravel() > 0
        if kept.sum() < max(FEWEST / 2, LEAST_SHARE * len(self.features)):
            return pose, np.nan
        if self.focal and not self.flat:
            pose = self._turned(one[kept], other[kept])
        far = moved(pose[None], one[kept])[0] - other[kept]
        return pose, float(np.sqrt(np.mean(far**2)))

    def least_squares(self, one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float64]:
        """The pose of all features (features, 2), without a search for those that do not go with it."""
        if self.focal and not self.flat:
            return self._turned(one, other)
        if not self.flat:
            return np.asarray(self.cv2.findHomography(one, other, 0)[0])
        middle, there = one.mean(axis=0), other.mean(axis=0)
        x, y = one - middle, other - there
        along, across = float((x * y).sum()), float((x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]).sum())
        turned = np.array([[along, -across], [across, along]]) / float((x * x).sum())
        pose = np.eye(3)
        pose[:2, :2], pose[:2, 2] = turned, there - turned @ middle
        return pose

    def _turned(self, one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float64]:
        """The pose of a camera that turns about its place, and whose picture grows, by least squares with bisquare
        weights: four numbers, as a similarity has, tell its roll better than a homography's eight.
        """
        values = np.zeros(4)
        for _ in range(TURNS):
            left = other - moved(self._turn(values)[None], one)[0]
            shifted = np.array([self._turn(values + SMALL * unit) for unit in np.eye(4)])
            slopes = (moved(shifted, one) - moved(self._turn(values)[None], one)).reshape(4, -1).T / SMALL
            far = np.hypot(left[:, 0], left[:, 1])
            limit = BISQUARE * max(float(np.median(far)) / 1.1774, 1e-3)  # median of a Rayleigh distribution
            weights = np.repeat(np.maximum(1.0 - (far / limit) ** 2, 0.0) if values.any() else np.ones(len(far)), 2)
            values = values + np.linalg.lstsq(weights[:, None] * slopes, weights * left.ravel(), rcond=None)[0]
        return self._turn(values)

    def _turn(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The homography of a camera that is turned by a vector [rad] and whose picture has grown, by its logarithm."""
        rows, columns = self.reference.shape
        lens = np.array([[self.focal, 0.0, columns / 2], [0.0, self.focal, rows / 2], [0.0, 0.0, 1.0]])
        grown = lens * np.array([np.exp(values[3]), np.exp(values[3]), 1.0])[:, None]
        grown[:2, 2] = lens[:2, 2]
        pose = grown @ self.cv2.Rodrigues(values[:3])[0] @ np.linalg.inv(lens)
        return np.asarray(pose / pose[2, 2])


def standing_features(
    cv2: Any, reference: Picture, few: list[Picture], scale: float
) -> tuple[NDArray[np.float32], bool] | None:
    """Those features that stand, and whether they do so before a tripod; None where there are too few. What goes
    together in a narrow place may be the joint's own, and is left out. A camera that turns far away sees what stands in
    perspective.
    """
    features = _corners(cv2, reference)
    for _ in range(BODIES):
        if len(features) < FEWEST:
            return None
        most = np.zeros(len(features), dtype=bool)
        for flat in (True, False):
            tracker = FeatureTracker(cv2, reference, features)
            tracker.flat = flat
            found, tripod = _standing(tracker, few, scale)
            if tripod:
                return features[found], True
            most = found if found.sum() > most.sum() else most
        if most.sum() >= FEWEST and wide(features[most], reference.shape):
            return features[most], False
        features = features[~most]
    return None


def _corners(cv2: Any, reference: Picture) -> NDArray[np.float32]:
    """Corners (features, 2) of a picture that can be followed (Shi and Tomasi 1994), so many in each part, as most
    of the sharpest ones may be on the joint.
    """
    faint: Picture = np.full((21, 21), 100, dtype=np.uint8)
    faint[10:, 10:] += FAINTEST
    least, (rows, columns) = float(cv2.cornerMinEigenVal(faint, 3).max()), reference.shape
    found = [np.zeros((0, 2), dtype=np.float32)]
    for top, bottom in pairwise(np.linspace(0, rows, PARTS[1] + 1).astype(int)):
        for left, right in pairwise(np.linspace(0, columns, PARTS[0] + 1).astype(int)):
            part = np.ascontiguousarray(reference[top:bottom, left:right])
            most = float(cv2.cornerMinEigenVal(part, 3).max())
            if most > least:
                corners = cv2.goodFeaturesToTrack(part, IN_PART, max(least / most, SHARPNESS), APART * columns)
                if corners is not None:  # the sharpest points may lie on the part's border, where none is taken
                    found.append(corners.reshape(-1, 2) + np.array([left, top], dtype=np.float32))
    return np.vstack(found)


def _standing(tracker: FeatureTracker, few: list[Picture], scale: float) -> tuple[NDArray[np.bool_], bool]:
    """Features that do not move, where there are enough of them, as before a tripod, or else those that go together;
    and whether it is a tripod.
    """
    places, middle = np.full((len(few), len(tracker.features), 2), np.nan, dtype=np.float32), len(few) // 2
    for order in (range(middle, len(few)), range(middle - 1, -1, -1)):  # so that each is near the one before
        near = np.eye(3)
        for k in order:
            places[k] = tracker.found(few[k], near)
            pose, residual = tracker.fitted(places[k], np.isfinite(places[k, :, 0]), scale)
            near = pose if np.isfinite(residual) else near
    beside = places - tracker.features
    still = np.hypot(beside[..., 0], beside[..., 1]) < UNMOVED * scale
    unmoved = still.mean(axis=0) > STANDING
    if unmoved.sum() >= FEWEST:
        return np.asarray(unmoved), True
    together = np.zeros(still.shape, dtype=bool)
    for k in range(len(few)):
        there = np.isfinite(places[k, :, 0])
        pose, _ = tracker.fitted(places[k], there, scale)
        far = moved(pose[None], tracker.features)[0] - places[k]
        together[k] = np.hypot(far[:, 0], far[:, 1]) < BESIDE * scale
    return np.asarray(together.mean(axis=0) > STANDING), False


def tell_lens(tracker: FeatureTracker, few: list[Picture], scale: float) -> None:
    """Set what poses are: similarities, those of a camera that turns about its place, whose lens the film tells, or
    homographies, if these explain the pictures that much better and features are wide enough for them.
    """
    tracker.flat = True
    if len(tracker.features) < 3 * FEWEST or not wide(tracker.features, tracker.reference.shape):
        return
    width = tracker.reference.shape[1]
    found = [tracker.found(picture, tracker.pose(picture, np.eye(3), scale)[0]) for picture in few]

    def residual(flat: bool, focal: float = 0.0) -> float:
        tracker.flat, tracker.focal = flat, focal
        return float(np.nanmedian([tracker.fitted(places, np.isfinite(places[:, 0]), scale)[1] for places in found]))

    squares = np.square([residual(False, focal * width) for focal in FOCALS])
    best = int(np.argmin(squares[1:-1])) + 1
    before, here, after = squares[best - 1 : best + 2].tolist()
    bend = before - 2.0 * here + after
    step = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend > 0.0 else 0.0
    focal = float(FOCALS[best] * (FOCALS[1] / FOCALS[0]) ** step) * width
    flat, turning = residual(True), residual(False, focal)
    if residual(False) > FLATTER * min(flat, turning):
        tracker.flat, tracker.focal = flat < turning, focal


def wide(features: NDArray[np.float32], shape: tuple[int, ...], share: float = WIDE) -> bool:
    """Whether features (features, 2) span a share of a picture's shape along both axes; the usual one tells more than a
    shift.
    """
    low, high = np.percentile(features, [5, 95], axis=0)
    return bool((high[0] - low[0] > share * shape[1]) and (high[1] - low[1] > share * shape[0]))


def moved(poses: NDArray[np.float64], places: NDArray[Any]) -> NDArray[np.float64]:
    """Places (places, 2) by poses (pictures, 3, 3): (pictures, places, 2)."""
    full = np.column_stack([places, np.ones(len(places))])
    there = full @ poses.transpose(0, 2, 1)
    return np.asarray(there[..., :2] / there[..., 2:])

"""Second renderer: films of a rig by another drawing library than the project's own camera.

Polygons by their exact areas (Agg, by matplotlib), averaged in linear light over the exposure; then gamma, shot noise,
lens, shake, walkers, shadows and a codec. It shares no line with the simulated camera of the package.

Its own error is .0003 degrees rms over 320 pixels. (OpenCV's anti-aliased polygons lie up to .2 pixels beside their
corners, which is .06 degrees there: more than what is measured by them.)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.path import Path as Outline
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array

Image = NDArray[Any]
Points = list[tuple[float, float]]
INSTANTS = 4
"""Of an exposure."""
GAMMA = 2.2
FOCAL = 0.9
"""Of the lens, in widths."""
MARGIN = 1.3
"""How much larger than the picture the drawn wall is."""
LINEAR = (np.arange(256) / 255.0).astype(np.float32) ** GAMMA


@dataclass(frozen=True, kw_only=True)
class FilmCase:
    """A film: what stands before the camera, how it is held, and what becomes of its pictures."""

    name: str
    wrong: str = ""
    """What is said of a film that is to be refused, as a regular expression."""
    rig: str = "cam_beam"
    kind: str = "multisine"
    seconds: float = 10.0
    width: int = 640
    height: int = 360
    rate: float = 30.0
    pivot: tuple[float, float] = (0.5, 0.29)
    """Widths."""
    size: float = 1.0
    """Of the rig, beside what its scene says."""
    wall: str = "bricks"
    bright: float = 0.85
    """Of the sprite, from 0 to 1."""
    dark: float = 0.35
    """Of the wall."""
    light: float = 1.0
    noise: float = 2.0
    """In counts, rms, at half the light."""
    exposure: float = 0.006
    readout: float = 0.012
    jitter: float = 0.0
    """Pixels of 640 by which each picture lies elsewhere, rms along each axis,"""
    sway: float = 0.0
    """and by which a hand sways, slowly."""
    roll: float = 0.0
    """Of the hand, degrees rms."""
    drift: float = 0.0
    """Pixels of 640 in which the camera creeps away until the end."""
    parallax: float = 0.0
    """Share of the sway by which the rig moves beside the wall behind it."""
    tilt: float = 0.0
    """Degrees by which the camera looks from the side."""
    lens: float = 0.0
    """Radial distortion at half a width from the middle."""
    turned: float = 0.0
    """Degrees that the camera is rolled, for good."""
    walkers: int = 0
    in_front: bool = False
    shadow: bool = True
    codec: str = "libx264"
    crf: int = 23
    frozen: tuple[float, float] = (0.0, 0.0)
    """From when until when the pictures stand still [s]."""
    black: tuple[float, float] = (0.0, 0.0)
    rest: float = 1.0
    """s at rest before the motion."""
    pace: float = 1.0
    """Seconds of the film's times in a second."""
    clicked: bool = False
    """Whether the pivot is given, some pixels off, as it is clicked."""
    read_as: str = ""
    """The rig that the film is said to be of; "": what it is."""
    seed: int = 0


class SecondRenderer:
    """Draws the pictures of a case."""

    def __init__(self, case: FilmCase, times: Array, angles: Array, reach: float) -> None:
        """Times [s] (n,) and angles [rad] (n,) of the joint; reach: of its sprite [widths]."""
        self.case, self.times, self.angles = case, times, angles
        self.random = np.random.default_rng(case.seed)
        self.size = case.width
        self.reach = reach * case.size
        sprite = list(self._sprite())
        ends = np.cumsum([0, *(len(corners) for corners, _ in sprite)]).tolist()
        pieces = [((a, b), shade) for (a, b), (_, shade) in zip(pairwise(ends), sprite, strict=True)]
        self.parts = [(list(group), shade) for shade, group in groupby(pieces, key=lambda piece: piece[1])]
        self.corners = np.vstack([corners for corners, _ in sprite]).T * self.reach * self.size
        self.wall = self._wall()
        self.count = int((times[-1] - times[0] + case.rest - 0.1) * case.rate)
        self.poses = self._poses()
        self.maps = self._lens_maps() if case.lens else None
        self.grey = (255.0 * np.linspace(0.0, 1.0, 4096) ** (1.0 / GAMMA)).astype(np.float32)

    def angle(self, time: Array) -> Array:
        """Of the joint [rad] at times of the film [s]."""
        return np.interp(time - self.case.rest, self.times, self.angles)

    def truth(self, seen: Array) -> Array:
        """Its mean over the exposures whose middles are ``seen`` [s of the film]."""
        inside = self.case.exposure * ((np.arange(21) + 0.5) / 21 - 0.5)
        return np.asarray(self.angle(seen[:, None] + inside).mean(axis=1))

    def pictures(self) -> Iterator[tuple[float, Image]]:
        """Times and pictures."""
        before: Image | None = None
        for number in range(self.count):
            time = number / self.case.rate
            if before is None or not self.case.frozen[0] <= time < self.case.frozen[1]:
                before = self.picture(number, time)
            black = self.case.black[0] <= time < self.case.black[1]
            yield time, np.zeros_like(before) + 16 if black else before

    def picture(self, number: int, time: float) -> Image:
        """One of them."""
        case, pose = self.case, self.poses[number]
        whole = (case.width, case.height)
        offset = (MARGIN - 1.0) / 2 * self.size
        shift = np.array([[1.0, 0.0, -offset], [0.0, 1.0, -offset], [0.0, 0.0, 1.0]])
        still = cv2.warpPerspective(self.wall, pose[0] @ shift, whole, flags=cv2.INTER_LINEAR)
        self._walk(still, time, pose[0], before=False)
        total: Image = cv2.LUT(still, LINEAR)
        moments = time + case.exposure * ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5)
        places = [self._places(float(moment), pose[1]) for moment in moments]
        if case.shadow:
            self._shadow(still, places)
            total = cv2.LUT(still, LINEAR)
        seen = np.vstack(places)
        first = np.clip(np.floor(seen.min(axis=0)) - 3, 0, whole).astype(int)
        last = np.clip(np.ceil(seen.max(axis=0)) + 3, first + 1, whole).astype(int)
        part = (slice(first[1], last[1]), slice(first[0], last[0]))
        mean: Image = np.zeros_like(total[part])
        for points in places:
            light, cover = self._painted(points - first, last - first)
            mean = mean + (total[part] * (1.0 - cover) + light * cover) / INSTANTS
        total[part] = mean
        if case.in_front:
            drawn = np.clip(255.0 * total ** (1.0 / GAMMA), 0, 255).astype(np.uint8)
            self._walk(drawn, time, pose[0], before=True)
            total = cv2.LUT(drawn, LINEAR)
        if self.maps is not None:
            total = cv2.remap(total, *self.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        small: Image = np.clip(case.light * total, 0.0, 1.0)
        counts = self.grey[(4095.0 * small).astype(np.int32)]
        grain: Image = self.random.standard_normal(small.shape, np.float32)
        counts = counts + case.noise * (0.5 + small).astype(np.float32) * grain
        return np.clip(counts + 0.5, 0.0, 255.0).astype(np.uint8)

    def _poses(self) -> list[tuple[Image, Image]]:
        """Homographies of wall and rig, in pixels: a camera that pans, tilts and rolls about its own place."""
        case, n = self.case, self.count
        time = np.arange(n) / case.rate
        pixel = case.width / 640.0
        moves = case.jitter * self.random.standard_normal((n, 2))
        rolls = np.zeros(n)
        for axis in range(2):
            for _ in range(6):
                hertz, phase = self.random.uniform(0.2, 4.0), self.random.uniform(0, 2 * math.pi)
                moves[:, axis] += case.sway * math.sqrt(2 / 6) * np.sin(2 * math.pi * hertz * time + phase)
                rolls += case.roll * math.sqrt(2 / 12) * np.sin(2 * math.pi * 0.7 * hertz * time + 2.0 * phase)
        moves[:, 0] += case.drift * time / max(time[-1], 1e-9)
        focal = FOCAL * self.size
        camera = np.array([[focal, 0.0, self.size / 2], [0.0, focal, case.height / 2], [0.0, 0.0, 1.0]])
        found = []
        for move, roll in zip(moves * pixel, np.radians(rolls + case.turned), strict=True):
            angles = np.array([-move[1] / focal, move[0] / focal + math.radians(case.tilt), roll])
            turn = np.eye(3)
            for axis in (2, 1, 0):
                turn = turn @ cv2.Rodrigues(np.eye(3)[axis] * angles[axis])[0]
            wall = camera @ turn @ np.linalg.inv(camera)
            if case.tilt:  # and steps aside, so that what it looked at stays in the middle
                middle = np.array([self.size / 2, case.height / 2, 1.0])
                there = wall @ middle
                back = middle - there / there[2]
                wall = np.array([[1.0, 0.0, back[0]], [0.0, 1.0, back[1]], [0.0, 0.0, 1.0]]) @ wall
            beside = np.eye(3)
            beside[:2, 2] = case.parallax * move
            found.append((wall, beside @ wall))
        return found

    def _wall(self) -> Image:
        """What stands, larger than the picture by MARGIN."""
        case = self.case
        rows, columns = round(case.height + (MARGIN - 1) * self.size), round(MARGIN * self.size)
        found: Image = np.full((rows, columns), 255.0 * case.dark, dtype=np.float32)
        if case.wall == "even":
            return np.clip(found * (1.0 - 0.1 * np.linspace(-1, 1, columns) ** 2), 0, 255).astype(np.uint8)
        for octave in range(3, 9):  # fractal noise
            cells = self.random.standard_normal((2**octave * rows // columns + 2, 2**octave)).astype(np.float32)
            rough = 22.0 if case.wall == "foliage" else 5.0
            grown: Image = cv2.resize(cells, (columns, rows), interpolation=cv2.INTER_CUBIC)
            found = found + rough * 0.8 ** (octave - 3) * grown
        if case.wall == "bricks":
            high, wide = self.size // 26, self.size // 11
            for y in range(0, rows, high):
                for x in range(-((y // high) % 2) * wide // 2, columns, wide):
                    shade = float(self.random.uniform(-14, 14))
                    found[y + 2 : y + high, max(x + 2, 0) : max(x + wide, 0)] += shade + 10.0
        if case.wall == "office":
            for _ in range(40):
                left, top = int(self.random.integers(0, columns)), int(self.random.integers(0, rows))
                wide, high = self.random.integers(self.size // 40, self.size // 6, 2).tolist()
                found[top : top + high, left : left + wide] = float(self.random.uniform(20, 190))
        return cv2.GaussianBlur(np.clip(found, 0, 255).astype(np.uint8), (0, 0), 0.7)

    def _lens_maps(self) -> tuple[Image, Image]:
        """Where a picture with radial distortion looks in one without."""
        rows, columns = self.case.height, self.size
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        x, y = (x - columns / 2) / (columns / 2), (y - rows / 2) / (columns / 2)
        factor = 1.0 + self.case.lens * (x**2 + y**2)
        return (x * factor + 1) * columns / 2, y * factor * columns / 2 + rows / 2

    def _sprite(self) -> Iterator[tuple[Points, float]]:
        """Polygons of what turns, in its reaches, and their greys."""
        bright = 255.0 * self.case.bright
        if self.case.rig == "cam_beam":
            yield _box(-1.0, 1.0, -0.008, 0.022), bright
            yield _box(-1.0, 1.0, 0.016, 0.026), 0.6 * bright
            for x in np.arange(-0.95, 1.0, 0.05).tolist():
                yield _box(x - 0.004, x + 0.004, -0.006, 0.006), 0.4 * bright
            for side in (-1.0, 0.98):
                yield _box(side, side + 0.02, -0.01, 0.026), 0.15 * bright
        elif self.case.rig == "flexible_joint":
            yield _disc(0.0, 0.0, 0.12), 0.8 * bright
            yield _box(0.0, 0.95, -0.055, 0.045), bright
            for x in (0.3, 0.45, 0.7):
                yield _disc(x, 0.0, 0.028), 0.3 * bright
            yield _disc(0.93, 0.0, 0.07), 0.2 * bright
        else:
            yield _disc(0.0, 0.0, 1.0), 0.2 * bright
            yield _disc(0.0, 0.0, 0.76), bright
            for k in range(5):
                c, s = math.cos(2 * math.pi * k / 5), math.sin(2 * math.pi * k / 5)
                yield [(x * c - y * s, x * s + y * c) for x, y in _box(0.1, 0.72, -0.05, 0.06)], 0.4 * bright
            yield _disc(0.0, 0.0, 0.15), 0.25 * bright
            yield _disc(0.45, 0.3, 0.08), 0.1 * bright

    def _places(self, moment: float, pose: Image) -> Image:
        """Corners of the sprite at a moment (corners, 2); each is where it is while its row is exposed."""
        case, (u, v) = self.case, self.corners
        angle, rows = self.angle(np.full(len(u), moment)), case.height
        for _ in range(3 if case.readout else 1):
            c, s = np.cos(angle), -np.sin(angle)
            x, y = case.pivot[0] * self.size + u * c - v * s, case.pivot[1] * self.size + u * s + v * c
            scale = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]
            x, y = (
                (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]) / scale,
                (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]) / scale,
            )
            angle = self.angle(moment + (y / rows - 0.5) * case.readout)
        return np.column_stack([x, y])

    def _painted(self, points: Image, size: Image) -> tuple[Image, Image]:
        """Light of the sprite, and how far it covers each pixel, by its corners (corners, 2), of a size (2,)."""
        canvas = RendererAgg(*size.tolist(), 72)  # type: ignore[call-arg]
        for group, grey in self.parts:
            _fill(canvas, [points[begin:end] for (begin, end), _ in group], float(LINEAR[round(grey)]))
        drawn = np.asarray(canvas.buffer_rgba()).astype(np.float32) / 255.0
        return drawn[..., 0], drawn[..., 3]

    def _shadow(self, picture: Image, places: list[Image]) -> None:
        """That of the sprite's first part, on the wall, over the exposure."""
        (first, last), _ = self.parts[0][0][0]
        cover: Image = np.zeros_like(picture)
        for points in places:
            canvas = RendererAgg(*picture.shape[::-1], 72)  # type: ignore[call-arg]
            _fill(canvas, [points[first:last] + np.array([0.012, 0.016]) * self.size], 1.0)
            cover += np.asarray(canvas.buffer_rgba())[..., 3] // (3 * INSTANTS)
        cover = cv2.blur(cover, (5, 5))
        cv2.multiply(picture, 255 - cover, dst=picture, scale=1.0 / 255.0)

    def _walk(self, picture: Image, time: float, pose: Image, *, before: bool) -> None:
        """People who walk by, behind the rig or before it."""
        if before != self.case.in_front:
            return
        for k in range(self.case.walkers):
            span = 1.6 * self.size
            x = ((0.13 + 0.04 * k) * self.size * time + k * 0.45 * self.size) % span - 0.3 * self.size
            foot = 0.56 * self.size
            sway = 0.01 * self.size * math.sin(5.0 * time + k)
            place = np.array([x, foot, 1.0]) @ pose.T
            x, foot = place[0] / place[2], place[1] / place[2]
            tall, shade = 0.5 * self.size, (60, 200, 120)[k % 3]
            body = (round(x), round(foot - 0.55 * tall + sway))
            cv2.ellipse(picture, body, (round(0.09 * tall), round(0.3 * tall)), 0, 0, 360, shade, -1, cv2.LINE_AA)
            head = (round(x), round(foot - 0.92 * tall + sway))
            cv2.circle(picture, head, round(0.07 * tall), shade + 30, -1, cv2.LINE_AA)


def _fill(canvas: RendererAgg, polygons: list[Image], light: float) -> None:
    """Fill polygons (corners, 2), which are one another's complement nowhere, with a light from 0 to 1."""
    context, rows = canvas.new_gc(), canvas.height
    context.set_linewidth(0.0)
    context.set_snap(False)
    corners = [np.vstack([points, points[:1]]) + 0.5 for points in polygons]  # a pixel's middle is a whole number
    outline = Outline.make_compound_path(*(Outline(points * [1, -1] + [0, rows], closed=True) for points in corners))
    canvas.draw_path(context, outline, IdentityTransform(), (light, light, light, 1.0))


def _box(left: float, right: float, top: float, bottom: float) -> Points:
    """Corners of a box, with more of them along it, as each has its own row's time."""
    along = np.linspace(left, right, 15 if right - left > 0.3 else 2)
    return [(float(x), top) for x in along] + [(float(x), bottom) for x in along[::-1]]


def _disc(x: float, y: float, radius: float) -> Points:
    turn = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
    return [(x + radius * float(np.cos(a)), y + radius * float(np.sin(a))) for a in turn]


def write(path: Path, renderer: SecondRenderer) -> None:
    """Write the film of a case by its codec."""
    case, ticks = renderer.case, 60_000  # MPEG-4 takes at most 65 535 a second
    with av.open(str(path), "w") as container:
        options = {"crf": str(case.crf), "preset": "fast"} if "26" in case.codec else {"qscale": str(case.crf // 4)}
        stream: Any = container.add_stream(case.codec, rate=Fraction(case.rate).limit_denominator(1001))
        stream.width, stream.height = case.width, case.height
        stream.pix_fmt = "yuvj420p" if case.codec == "mjpeg" else "yuv420p"
        stream.options = {**options, **({"x265-params": "log-level=none"} if "265" in case.codec else {})}
        stream.time_base = stream.codec_context.time_base = Fraction(1, ticks)
        for time, picture in renderer.pictures():
            frame = av.VideoFrame.from_ndarray(picture, format="gray")
            frame.pts, frame.time_base = round(time * case.pace * ticks), Fraction(1, ticks)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())

"""Films: pictures and times come back as they were written, and what is no film is reported in a line."""

from __future__ import annotations

import math
import os
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("av", reason="needs the extra video")

import av

from hybrid_sysid_ros.extensions.vision.camera.film import format_of, pictures, write_film
from hybrid_sysid_ros.extensions.vision.camera.quantisation import quantiser_steps
from hybrid_sysid_ros.support.errors import UserError

TIMES = np.cumsum([0.0, 0.03, 0.035, 0.05, *[1 / 30] * 40])  # a phone's


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    frames = [np.full((90, 160), 40 + 4 * k, dtype=np.uint8) for k in range(len(TIMES))]
    assert write_film(path, zip(TIMES, frames, strict=True), rate=30.0) == len(TIMES)
    return path


def test_times_and_greys_come_back(film: Path) -> None:
    found = list(pictures(film))
    assert np.abs(np.array([time for time, _ in found]) - TIMES).max() < 1e-4
    for k, (_, picture) in enumerate(found):
        assert picture.shape == (90, 160)
        assert abs(float(picture.mean()) - (40 + 4 * k)) < 3
    assert (format_of(film).width, format_of(film).height) == (160, 90)


@pytest.mark.parametrize(
    ("content", "words"), [(b"", "is empty"), (b"no film at all\n" * 100, "no film that can be read")]
)
def test_what_is_no_film_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(content)
    with pytest.raises(UserError, match=words):
        list(pictures(path))


def test_a_pipe_is_refused_as_none_waits_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "film.mp4")
    for read in (format_of, lambda path: list(pictures(path))):
        with pytest.raises(UserError, match="a pipe or a device"):
            read(tmp_path / "film.mp4")


def test_a_cut_film_is_refused(film: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mp4"
    path.write_bytes(film.read_bytes()[:-2000])
    with pytest.raises(UserError, match=r"cut|damaged"):
        list(pictures(path))


def test_a_film_of_a_codec_that_is_not_known_is_refused(film: Path, tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(film.read_bytes().replace(b"avc1", b"odd?"))
    with pytest.raises(UserError, match="a codec that is not known"):
        list(pictures(path))


def test_a_film_of_no_breadth_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    write_film(path, [(k / 30.0, np.zeros((180, 2), dtype=np.uint8)) for k in range(3)], rate=30.0)
    with pytest.raises(UserError, match="2x180 pixels show nothing"):
        list(pictures(path))


def test_a_film_that_is_not_there_and_a_folder_are_reported(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        list(pictures(tmp_path / "film.mp4"))
    with pytest.raises(UserError):
        list(pictures(tmp_path))


def test_a_film_has_a_suffix_of_one(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="ends in"):
        write_film(tmp_path / "film.txt", [], rate=30.0)


def test_a_film_that_ends_before_its_head_says_is_refused(tmp_path: Path) -> None:
    """A Matroska file that is cut ends like a whole one."""
    random, whole, cut = np.random.default_rng(0), tmp_path / "whole.mkv", tmp_path / "cut.mkv"
    frames = [(k / 30.0, random.integers(0, 256, (90, 160), dtype=np.uint8)) for k in range(180)]
    write_film(whole, frames, rate=30.0)
    assert len(list(pictures(whole))) == len(frames)
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(UserError, match=r"is cut: .* its head says 6 s"):
        list(pictures(cut))


def test_a_film_whose_head_comes_first_is_refused_without_its_last_pictures(tmp_path: Path) -> None:
    """As films are sent over the net: a file that was not copied to its end reads well up to there."""
    import av

    random, whole, cut = np.random.default_rng(0), tmp_path / "whole.mp4", tmp_path / "cut.mp4"
    frames = [(k / 30.0, random.integers(0, 256, (90, 160), dtype=np.uint8)) for k in range(180)]
    write_film(tmp_path / "last.mp4", frames, rate=30.0)
    with (
        av.open(str(tmp_path / "last.mp4")) as source,
        av.open(str(whole), "w", options={"movflags": "faststart"}) as target,
    ):
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(source.streams.video[0]):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    assert len(list(pictures(whole))) == len(frames)
    cut.write_bytes(whole.read_bytes()[: int(0.97 * whole.stat().st_size)])
    with pytest.raises(UserError, match=r"is cut|is damaged"):
        list(pictures(cut))


def _written(path: Path, options: dict[str, str], aspect: Fraction | None = None, turned: int = 0) -> Path:
    """A film of ten pictures, brighter to the right, and darker below."""
    import av

    picture = np.add.outer(np.arange(96, 0, -1), np.arange(120)).astype(np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = 120, 96, "yuv420p", {"crf": "5", **options}
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        if turned and not hasattr(stream, "set_display_rotation"):
            pytest.skip(f"PyAV {av.__version__} writes no rotation")
        if turned:
            stream.set_display_rotation(turned)
        for _ in range(10):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    return path


def test_pixels_that_are_not_square_are_made_so(tmp_path: Path) -> None:
    """A third wider than high: angles would be off by as much."""
    _, picture = next(pictures(_written(tmp_path / "wide.mp4", {}, aspect=Fraction(4, 3))))
    assert picture.shape == (96, 160)
    assert float(picture[45, 120]) - float(picture[45, 40]) == pytest.approx(60.0, abs=2.0)


@pytest.mark.parametrize(("degrees", "shape"), [(90, (120, 96)), (180, (96, 120)), (270, (120, 96))])
def test_a_film_that_is_marked_as_turned_is_upright(tmp_path: Path, degrees: int, shape: tuple[int, int]) -> None:
    """Counter-clockwise, as FFmpeg's players turn it."""
    _, straight = next(pictures(_written(tmp_path / "film.mp4", {})))
    _, picture = next(pictures(_written(tmp_path / "turned.mp4", {}, turned=degrees)))
    assert picture.shape == shape
    assert np.abs(np.rot90(straight, degrees // 90).astype(float) - picture).max() < 3.0


def test_an_interlaced_film_is_refused(tmp_path: Path) -> None:
    """Each of its pictures is of two moments."""
    with pytest.raises(UserError, match="is interlaced"):
        list(pictures(_written(tmp_path / "film.mp4", {"flags": "+ilme+ildct", "x264-params": "tff=1"})))


@pytest.mark.parametrize("taken", ["30.000000", "240.000000"])
def test_slow_motion_is_refused_by_what_the_phone_wrote(film: Path, tmp_path: Path, taken: str) -> None:
    import av

    slow = tmp_path / "slow.mp4"
    with av.open(str(film)) as source, av.open(str(slow), "w", options={"movflags": "use_metadata_tags"}) as target:
        target.metadata["com.android.capture.fps"] = taken
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    if taken.startswith("30"):
        assert len(list(pictures(slow))) == len(TIMES)
    else:
        with pytest.raises(UserError, match=r"taken at 240 pictures/s and is played at (29|30).*itsscale"):
            list(pictures(slow))


def test_a_large_film_is_scaled_down_by_the_mean_of_its_pixels(tmp_path: Path) -> None:
    """Each pixel of 1920 is the mean of four of 3840, so that a place in widths stays where it is."""
    film = tmp_path / "film.mp4"
    rows, columns = np.mgrid[:96, :3840]
    own = (60 + 30 * np.sin(rows / 9.0) + 60 * np.sin(columns / 50.0)).astype(np.uint8)
    write_film(film, [(k / 30.0, own) for k in range(3)], rate=30.0, crf=5, preset="ultrafast")
    assert (format_of(film).width, format_of(film).scale) == (3840, 0.5)
    _, read = next(pictures(film))
    assert read.shape == (48, 1920)
    assert read == pytest.approx(own.reshape(48, 2, 1920, 2).mean(axis=(1, 3)), abs=3.0)


@pytest.mark.parametrize(
    ("codec", "pixels", "options", "step"),
    [
        ("libx264", "yuv420p", {"qp": "28", "preset": "ultrafast"}, 16.0),  # at 4 it is 1, and it doubles by 6
        ("libx264", "yuv420p10le", {"qp": "40", "preset": "ultrafast"}, 16.0),  # from -12 on, of 1023 counts
        ("mpeg4", "yuv420p", {"qmin": "6", "qmax": "6"}, 12.0),
        ("mjpeg", "yuvj420p", {}, 0.0),  # no picture hangs on another one
        ("libvpx-vp9", "yuv420p", {"cpu-used": "8", "deadline": "realtime"}, math.nan),  # its decoder names no blocks
    ],
)
def test_a_decoder_says_how_coarsely_pictures_are_rounded(
    codec: str, pixels: str, options: dict[str, str], step: float, tmp_path: Path
) -> None:
    with av.open(str(tmp_path / "film.mkv"), "w") as container:
        stream: Any = container.add_stream(codec, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        for grain in np.random.default_rng(0).integers(0, 255, (5, 48, 64), dtype=np.uint8):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grain, format="gray").reformat(format=pixels)))
        container.mux(stream.encode())
    steps = quantiser_steps(tmp_path / "film.mkv")
    assert len(steps) == 5
    assert float(np.median(steps)) == pytest.approx(step, rel=0.3, nan_ok=True)

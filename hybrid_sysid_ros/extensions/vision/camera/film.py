"""Films: files of pictures with a time each, read and written by FFmpeg's libraries (the extra ``video``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra
from hybrid_sysid_ros.support.files import written_file

SUFFIXES = (".mp4", ".mov", ".mkv")
TICKS = 90_000  # of a film's time in a second
CRF = 18  # of H.264, 0 (lossless) to 51
SMALLEST, LARGEST = 16, 8192  # pixels along a side
READ = 1920
"""Pixels along a side, to which larger pictures are scaled down: angles from 1920 are no better than from 1280."""
CAPTURED, SLOWED = "com.android.capture.fps", 1.5
"""What a phone writes of slow motion, and times as slow that it is played at least; missing pictures make less."""
MISSING = 3.0  # of the longest times between its pictures, before the end that a film's head says, is a cut


@dataclass(frozen=True, kw_only=True)
class FilmFormat:
    """What a film's head says of it; the rate [Hz] need not be true, its pictures' times are."""

    width: int
    """Of its own pictures [square pixels], not upright yet,"""
    height: int
    rate: float
    codec: str

    @property
    def scale(self) -> float:
        """Size of its pictures as they are read, beside its own; at most 1."""
        return min(READ / max(self.width, self.height), 1.0)


def format_of(path: Path) -> FilmFormat:
    """What a film's head says. Raises UserError where it is no film."""
    _check_regular(path)
    with extra("video"):
        import av
    try:
        with av.open(str(path)) as container:
            stream = _stream(container, path)
            return _format(stream)
    except (av.FFmpegError, OSError) as error:
        raise _unreadable(path, error) from error


def pictures(path: Path) -> Iterator[tuple[float, Picture]]:
    """Time [s] and grey picture (rows, columns) of each frame, upright, with square pixels and no larger than READ, in
    the order of their times.

    Raises UserError where the file is no film, is interlaced, in slow motion, cut or damaged.
    """
    _check_regular(path)
    with extra("video"):
        import av
    count, last, longest, stated = 0, -np.inf, 0.0, 0.0
    try:
        with av.open(str(path)) as container:
            stream = _stream(container, path)
            stream.thread_type = "AUTO"
            stated, longest = _end_of(container, stream), 1.0 / float(stream.average_rate or 1)
            film = _format(stream)
            wide, scaler = round(film.scale * film.width), "AREA" if film.scale < 1.0 else "BILINEAR"
            for frame in container.decode(stream):
                if frame.pts is None or frame.time is None:
                    raise UserError(f"{path}: frame {count} has no time: write the film again with time stamps")
                if not frame.time > last:
                    raise UserError(f"{path}: frame {count} is of {frame.time:.6g} s, after one of {last:.6g} s")
                if frame.interlaced_frame:
                    raise UserError(
                        f"{path}: is interlaced, so that each picture is of two moments: make whole ones of it first, "
                        "such as by ffmpeg -vf bwdif"
                    )
                high = round(film.scale * frame.height)
                grey = frame.to_ndarray(format="gray", width=wide, height=high, interpolation=scaler)
                turns = round(getattr(frame, "rotation", 0) / 90) % 4
                longest = max(longest, frame.time - last) if count else longest
                count, last = count + 1, frame.time
                yield float(frame.time), np.ascontiguousarray(np.rot90(grey, turns) if turns else grey)
    except (av.FFmpegError, OSError) as error:
        if count:
            raise UserError(
                f"{path}: is damaged after {count} frames, {last:.3g} s ({_words(error)}): cut it there"
            ) from error
        raise _unreadable(path, error) from error
    if not count:
        raise UserError(f"{path}: holds no frame")
    if last < stated - MISSING * longest:
        raise UserError(
            f"{path}: is cut: its pictures end at {last:.3g} s, where its head says {stated:.3g} s; copy it again, or "
            "write what there is as a film of its own"
        )


def write_film(
    path: Path, film: Iterable[tuple[float, Picture]], *, rate: float, crf: int = CRF, preset: str = "medium"
) -> int:
    """Write grey pictures with their times [s] as H.264; an older file is replaced. rate [Hz]: what its head says.
    preset: of x264, how much work it does for a smaller file.

    Returns the number of pictures. Raises UserError where the file can't be written or has another suffix.
    """
    with extra("video"):
        import av
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: a film's name ends in {', '.join(SUFFIXES)}")
    count = 0
    with written_file(path) as partial, av.open(str(partial), "w") as container:
        stream: Any = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(100_000))
        stream.pix_fmt, stream.options = "yuv420p", {"crf": str(crf), "preset": preset}
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        for time, picture in film:
            if not count:
                stream.height, stream.width = picture.shape
            frame = av.VideoFrame.from_ndarray(picture, format="gray")
            frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode())
    return count


def _check_regular(path: Path) -> None:
    """Raise UserError for a pipe or device, for which a reader would wait for ever."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise UserError(f"{path}: is a pipe or a device: copy the film into a file")


def _stream(container: Any, path: Path) -> Any:
    if not container.streams.video:
        raise UserError(f"{path}: has no pictures in it")
    stream = container.streams.video[0]
    if stream.codec_context is None:
        raise UserError(f"{path}: its pictures are of a codec that is not known, or its head is damaged: write it anew")
    sides = stream.codec_context.width, stream.codec_context.height
    if max(sides) > LARGEST:
        raise UserError(f"{path}: its pictures are larger than {LARGEST} pixels: scale it down")
    if min(sides) < SMALLEST:
        raise UserError(f"{path}: its pictures of {sides[0]}x{sides[1]} pixels show nothing: {SMALLEST} at least")
    taken, played = 0.0, float(stream.average_rate or 0.0)
    with suppress(ValueError):
        taken = float(container.metadata.get(CAPTURED, 0.0))
    if played and taken / played > SLOWED:
        raise UserError(
            f"{path}: was taken at {taken:.4g} pictures/s and is played at {played:.4g}: give it its true times first, "
            f"such as by ffmpeg -itsscale {played / taken:.4g} -i {path.name} -c copy"
        )
    return stream


def _format(stream: Any) -> FilmFormat:
    context = stream.codec_context
    wide = round(context.width * float(stream.sample_aspect_ratio or 1))
    return FilmFormat(
        width=wide, height=context.height, rate=float(stream.average_rate or 0), codec=context.name
    )  # fmt: skip


def _end_of(container: Any, stream: Any) -> float:
    """When a film's pictures end by what its head says [s]; 0 where it says nothing of them."""
    if stream.duration is not None:
        return float(((stream.start_time or 0) + stream.duration) * stream.time_base)
    alone = len(container.streams) == 1 and container.duration is not None
    return float(((container.start_time or 0) + container.duration) * 1e-6) if alone else 0.0


def _unreadable(path: Path, error: Exception) -> UserError:
    if isinstance(error, FileNotFoundError):
        return UserError(f"{path}: no such file")
    if isinstance(error, IsADirectoryError):
        return UserError(f"{path}: is a folder: name the film's file")
    if path.is_file() and not path.stat().st_size:
        return UserError(f"{path}: is empty")
    return UserError(f"{path}: is no film that can be read, or is cut ({_words(error)})")


def _words(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)

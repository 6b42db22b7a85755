"""Quantisation: how coarsely a film's codec rounds what changes in its pictures, as far as its decoder says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.extras import extra

SIDE_DATA = {"export_side_data": "venc_params"}
"""An option of FFmpeg's decoders."""
H264, MPEG = 1, 2
"""Kinds of quantisers in AVVideoEncParams."""
COARSE = 0.9  # quantile of a picture's blocks: a codec rounds edges more coarsely than what is plain


def quantiser_steps(path: Path) -> Array:
    """Step by which each picture's coefficients are rounded (pictures,) [counts of an orthonormal transform], in the
    order of their times; NaN where it is not known, as of HEVC, and 0 where no picture hangs on another one, so that
    nothing of it is left in place. A film that can be read is given.

    That of H.264 doubles by six of its parameter, from .625 at 0 on, in counts of its own depth (ITU-T H.264, 8.5.8);
    that of MPEG-4 is twice its code (ISO/IEC 14496-2, 7.4.4), which is what FFmpeg gives.
    """
    with extra("video"):
        import av
    with av.open(str(path)) as container:
        stream: Any = container.streams.video[0]
        stream.codec_context.options = SIDE_DATA
        stream.thread_type = "AUTO"
        frames = [(_step(frame), bool(frame.key_frame)) for frame in container.decode(stream)]
    steps, alone = np.array(frames).T
    return np.where(np.isnan(steps) & bool(alone.all()), 0.0, steps)


def _step(frame: Any) -> float:
    for kind, parameter in _parameters(frame):
        if kind == H264:
            return float(0.625 * 2.0 ** (parameter / 6.0) / 2.0 ** (frame.format.components[0].bits - 8))
        if kind == MPEG:
            return parameter
    return np.nan


def _parameters(frame: Any) -> Iterator[tuple[int, float]]:
    """Kind of a frame's quantiser and its parameter, from the structure AVVideoEncParams."""
    for item in frame.side_data:
        if item.type.name != "VIDEO_ENC_PARAMS":
            continue
        content = bytes(item)
        count = int(np.frombuffer(content, np.uint32, 1)[0])
        first, size = np.frombuffer(content, np.uint64, 2, offset=8).tolist()
        kind, parameter = np.frombuffer(content, np.int32, 2, offset=24).tolist()
        blocks = np.frombuffer(content, np.int32, count * size // 4, offset=first).reshape(count, size // 4)
        yield kind, parameter + (float(np.quantile(blocks[:, 4], COARSE)) if count else 0.0)

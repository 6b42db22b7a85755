"""Focus: which pictures of a film are out of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.support.arrays import Array

BLOCK = 8  # pixels along a side: what is as large is seen out of focus, too
SOFT = 0.4  # of the sharpness of most pictures: an edge as wide as 2.5 of theirs


def sharpness(picture: Picture) -> float:
    """How much neighbouring pixels differ beside neighbouring blocks, mean squares; of an edge it is one by its width.
    Neither light nor contrast change it, and who walks by changes both.
    """
    rows, columns = (side // BLOCK * BLOCK for side in picture.shape)
    fine = np.diff(picture[: rows : BLOCK // 2].astype(np.int16), axis=1).astype(np.float32)
    blocks = picture[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).mean(axis=(1, 3))
    coarse = np.diff(blocks, axis=1)
    return float(np.mean(fine**2) / max(float(np.mean(coarse**2)), 1.0))


def soft_pictures(values: Array) -> NDArray[np.bool_]:
    """Pictures (pictures,) that are less sharp than others by far."""
    return np.asarray(values < SOFT * np.median(values))

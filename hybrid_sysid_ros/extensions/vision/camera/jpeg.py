"""JPEG: a grey picture as the bytes that travel (the extra ``video``)."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

LARGEST = 8192  # pixels along a side


def check_available() -> None:
    """Raise UserError where what reads and writes JPEG is not installed."""
    with extra("video"):
        import PIL.JpegImagePlugin  # noqa: F401


def encoded(picture: Picture, quality: int) -> bytes:
    """A picture (rows, columns) as JPEG; quality: 1 to 95."""
    from PIL import Image

    data = BytesIO()
    Image.fromarray(picture).save(data, "JPEG", quality=quality)
    return data.getvalue()


def decoded(data: bytes) -> Picture:
    """Grey picture (rows, columns) of a JPEG, a coloured one's brightness. Raises UserError where it is none."""
    return _grey(BytesIO(data), "JPEG")


def opened(path: Path) -> Picture:
    """Grey picture (rows, columns) of a file, JPEG or PNG. Raises UserError where it is none."""
    return _grey(path, "JPEG", "PNG")


def _grey(source: BytesIO | Path, *formats: str) -> Picture:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(source, formats=formats) as image:
            if max(image.size) > LARGEST:
                raise UserError(f"a picture of {image.size[0]}x{image.size[1]} pixels is larger than {LARGEST}")
            image.draft("L", image.size)  # of a JPEG the brightness alone is unpacked
            return np.asarray(image.convert("L"))
    except (OSError, SyntaxError, ValueError) as error:
        why = "can't be identified" if isinstance(error, UnidentifiedImageError) else getattr(error, "strerror", None)
        raise UserError(f"no {' or '.join(formats)} that can be read ({why or error})") from error

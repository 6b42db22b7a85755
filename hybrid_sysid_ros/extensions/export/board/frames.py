"""Frames on a serial line: consistent overhead byte stuffing, a CRC-32 and a zero at the end, as frames.c has them.

Cheshire, Baker (1999), IEEE/ACM Transactions on Networking 7(2).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator

CHECKSUM = 4
"""Bytes of a checksum, the lowest first."""
FULL = 254
"""Bytes of a block at most."""
LONGEST = 1 << 16
"""Bytes without an end that are kept."""


def encode(content: bytes) -> bytes:
    """The frame of a content."""
    blocks = (content + zlib.crc32(content).to_bytes(CHECKSUM, "little")).split(b"\0")
    coded = bytearray()
    for last, block in zip((*(len(blocks) - 1) * (False,), True), blocks, strict=True):
        while len(block) >= FULL:
            coded += b"\xff" + block[:FULL]
            block = block[FULL:]
            if last and not block:
                return bytes(coded) + b"\0"
        coded += bytes([len(block) + 1]) + block
    return bytes(coded) + b"\0"


def decode(frame: bytes) -> bytes | None:
    """The content of a frame without its end; None where it is cut or damaged."""
    content, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        block = frame[at + 1 : at + code]
        if len(block) != code - 1:
            return None
        content += block
        at += code
        if code < 255 and at < len(frame):
            content += b"\0"
    checksum = bytes(content[-CHECKSUM:])
    found = bytes(content[:-CHECKSUM])
    return found if len(content) > CHECKSUM and zlib.crc32(found).to_bytes(CHECKSUM, "little") == checksum else None


class FrameReceiver:
    """Finds frames in what a line delivers, in pieces of any length."""

    def __init__(self) -> None:
        self.wrong = 0
        """Frames that were cut or damaged."""
        self._kept = bytearray()

    def receive(self, piece: bytes) -> Iterator[bytes]:
        """The contents of the frames that end in a piece."""
        *frames, rest = (bytes(self._kept) + piece).split(b"\0")
        self._kept = bytearray(rest[-LONGEST:])
        for frame in frames:
            content = decode(frame)
            if content is not None:
                yield content
            elif frame:
                self.wrong += 1

"""Frames on a serial line are the same in C and in Python, and no damaged one passes."""

import ctypes
import subprocess

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.export.board.folder import TEMPLATES
from hybrid_sysid_ros.extensions.export.board.frames import FrameReceiver, decode, encode
from hybrid_sysid_ros.extensions.export.c_source import Text

COMPILER = compiler.found() or ""
LONGEST = 600


def contents():
    """Contents of all kinds: short, around a block's length, zeros at all places."""
    random = np.random.default_rng(0)
    yield from (bytes(length) for length in (1, 253, 254, 255))
    yield from (b"\x01" * length for length in (1, 249, 250, 251, 252, 253, 254, 255, 504, 508, 509, LONGEST))
    for _ in range(300):
        found = random.integers(0, 256, random.integers(1, LONGEST + 1), dtype=np.uint8)
        found[random.random(len(found)) < random.choice([0.0, 0.02, 0.5])] = 0
        yield found.tobytes()


def test_a_frame_of_the_paper_s_bytes():
    """Cheshire and Baker's rule by hand: 11 22 00 33 and its checksum have no zero but the last."""
    frame = encode(b"\x11\x22\x00\x33")
    assert frame[:4] == b"\x03\x11\x22\x06"
    assert frame.count(0) == 1
    assert frame[-1] == 0


def test_what_is_encoded_is_decoded():
    for content in contents():
        frame = encode(content)
        assert 0 not in frame[:-1]
        assert decode(frame[:-1]) == content


def test_no_damaged_frame_passes():
    random, receiver = np.random.default_rng(1), FrameReceiver()
    for content in contents():
        frame = bytearray(encode(content))
        frame[random.integers(len(frame) - 1)] ^= int(random.integers(1, 256))
        assert content not in [*receiver.receive(bytes(frame))]
        assert [*receiver.receive(encode(content)[: len(frame) // 2] + b"\0")] == []
        assert [*receiver.receive(b"\0" + encode(content))] == [content]
    assert receiver.wrong > 500


@pytest.mark.skipif(not COMPILER, reason="needs a C compiler: cc, gcc or clang")
def test_c_and_python_write_and_read_the_same_frames(tmp_path):
    for name in ("frames.c", "frames.h"):
        text = Text((TEMPLATES / name).read_text()).substitute({"longest": LONGEST})
        (tmp_path / name).write_text(text)
    library = tmp_path / "frames.so"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-shared", "-fPIC"]
    subprocess.run([COMPILER, *flags, str(tmp_path / "frames.c"), "-o", str(library)], check=True)
    made = ctypes.CDLL(str(library))

    class Receiver(ctypes.Structure):
        _fields_ = (
            ("content", ctypes.c_uint8 * (LONGEST + 4)), ("count", ctypes.c_int), ("left", ctypes.c_int),
            ("code", ctypes.c_int), ("wrong", ctypes.c_uint32),
        )  # fmt: skip

    receiver, coded, random = Receiver(), ctypes.create_string_buffer(2 * LONGEST), np.random.default_rng(2)

    def received(piece):
        lengths = [made.frames_receive(ctypes.byref(receiver), byte) for byte in piece]
        return bytes(receiver.content[: lengths[-1]]) if lengths[-1] >= 0 else None

    for content in contents():
        length = made.frames_encode(content, len(content), coded)
        frame = encode(content)
        assert coded.raw[:length] == frame
        assert received(frame) == content
        noise = random.integers(0, 256, 1500, dtype=np.uint8).tobytes()
        received(noise + b"\0" + frame[: len(frame) // 2])
        damaged = bytearray(frame)
        damaged[random.integers(len(frame) - 1)] ^= 1 << int(random.integers(8))
        assert received(bytes(damaged)) != content
        assert received(b"\0" + frame) == content
    assert receiver.wrong > 500

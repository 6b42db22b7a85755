"""Writing: rosbag2 folders of ROS 2 Jazzy's default kind (metadata.yaml and MCAP files), without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags import metadata
from hybrid_sysid_ros.bags.bag import METADATA, markers
from hybrid_sysid_ros.bags.quality import Quality
from hybrid_sysid_ros.bags.series import SECOND, Series, jazzy_types
from hybrid_sysid_ros.bags.storage import Compression, Extent, Offer, Storage
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import written_folder


@dataclass(frozen=True, kw_only=True)
class Split:
    """Where a bag goes on in a next file: from so many bytes on the disk, or seconds of log time, on; 0: never."""

    size: int = 0
    seconds: float = 0.0

    def is_due(self, file: Storage, logged: int) -> bool:
        """Whether a message that was logged then [ns] belongs into the next one."""
        if not file.counts:
            return False
        long = 0.0 < self.seconds * SECOND <= logged - file.first
        return long or 0 < self.size <= file.stream.tell()


class BagWriter:
    """Write a bag, message by message, as a context.

    It grows in a temporary folder beside `path`, which takes its place when the context ends well: a bag is whole or
    not there. What cannot be had again is written by a :class:`Recording`.

    compression: what packs the chunks of the MCAP files: zstd or lz4, which every MCAP reader unpacks; "": nothing.
    replace: replace a bag that exists there.
    notes: text by key for the metadata (custom_data), such as where the data came from.
    split: where it goes on in a next file.

    Raises UserError when the place cannot be written or is taken.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        compression: Compression = "zstd",
        replace: bool = False,
        notes: Mapping[str, str] | None = None,
        split: Split | None = None,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        self._compression = compression
        self._replace = replace
        self._notes = dict(notes or {})
        self._split = split or Split()
        self._stack = ExitStack()
        self._offers: dict[str, Offer] = {}
        self._files: list[Storage] = []
        self._folder = self.path

    def __enter__(self) -> BagWriter:
        with ExitStack() as stack:
            place = written_folder(self.path, marker=markers(self.path), replace=self._replace)
            self._folder = stack.enter_context(place)
            stack.push(self._end)
            self._next_file()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _end(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is None:
                self._finish_file()
                self._describe()
        finally:
            for file in self._files:
                file.stream.close()

    def offer(self, topic: str, message_type: str, qualities: Sequence[Quality] = ()) -> Offer:
        """Say how a topic is offered, before its first message is written.

        Raises:
            UserError: ROS 2 Jazzy has no such message type, or the topic had another type before.
        """
        package, _, name = message_type.rpartition("/")
        full = message_type if package.endswith("/msg") else f"{package}/msg/{name}"
        known = self._offers.get(topic)
        if known is None:
            if full not in jazzy_types().fielddefs:
                raise UserError(f"{self.path}: topic {topic}: message type {message_type!r} is not one of ROS 2 Jazzy")
            known = self._offers[topic] = Offer(topic=topic, type=full, qualities=tuple(qualities))
        if known.type != full:
            raise UserError(f"{self.path}: topic {topic} has type {known.type}, not {full} as well")
        return known

    def write_raw(
        self, topic: str, message_type: str, stamp: int, data: bytes | memoryview, *, published: int = 0
    ) -> None:
        """Write one serialised message (CDR, as a raw subscription of rclpy gives it).

        stamp: time of logging [ns]. published: when it was sent, as far as that is known [ns]; 0: when it was logged.

        Raises:
            UserError: see :meth:`offer`.
        """
        offer = self._offers.get(topic)
        if offer is None or offer.type != message_type:
            offer = self.offer(topic, message_type)
        if self._split.is_due(self._files[-1], stamp):
            self._next_file()
        self._files[-1].write(offer, stamp, published or stamp, data)
        self.messages += 1

    def attach(self, name: str, data: bytes, logged: int) -> None:
        """Keep a file beside the messages, and the time [ns] at which it was read; see :mod:`.attachments`."""
        self._files[-1].attach(name, data, logged)

    def flush(self) -> None:
        """End a chunk of the file here."""
        self._files[-1].flush()

    def _next_file(self) -> None:
        """Begin the next file, and end the one before."""
        name = f"{self.path.resolve().name}_{len(self._files)}.mcap"
        stream = self._opened(self._folder / name)
        if self._files:
            self._finish_file()
        self._files.append(Storage(name, stream, compression=self._compression))

    def _finish_file(self) -> None:
        offers = tuple(self._offers.values())
        self._files[-1].finish(lambda file: metadata.inner_text(file, offers, self._notes))

    def _opened(self, path: Path) -> Any:
        """A new file, to write into."""
        return path.open("xb")

    def _describe(self) -> None:
        """Write metadata.yaml, beside its place, then rename."""
        partial = self._folder / f"{METADATA}.tmp"
        content = metadata.text(self._extents(), tuple(self._offers.values()), self._notes)
        self._put(partial, content.encode())
        partial.replace(self._folder / METADATA)

    def _put(self, path: Path, data: bytes) -> None:
        path.write_bytes(data)

    def _extents(self) -> list[Extent]:
        """What the files hold."""
        return [file.extent for file in self._files]


def write(
    path: Path | str,
    topics: Sequence[Series],
    *,
    compression: Compression = "zstd",
    replace: bool = False,
    notes: Mapping[str, str] | None = None,
) -> Path:
    """Write a bag of whole series, in the order of their stamps.

    Raises:
        UserError: the place cannot be written, or holds something that may not be replaced.
    """
    with BagWriter(path, compression=compression, replace=replace, notes=notes) as writer:
        stamps = np.concatenate([one.stamps for one in topics])
        owner = np.repeat(np.arange(len(topics)), [len(one.stamps) for one in topics])
        following = [one.messages() for one in topics]
        order = np.argsort(stamps, kind="stable")
        for stamp, number in zip(stamps[order].tolist(), owner[order].tolist(), strict=True):
            writer.write_raw(topics[number].topic, topics[number].type, stamp, next(following[number]))
    return Path(path)

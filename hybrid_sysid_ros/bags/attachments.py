"""Attachments: files that a bag keeps beside its messages, by which it explains itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from mcap.reader import make_reader
from mcap.records import Attachment
from mcap.stream_reader import StreamReader

from hybrid_sysid_ros.bags.bag import clear_line, storage_files
from hybrid_sysid_ros.support.errors import UserError

LARGEST = 1 << 26
"""Bytes of all that belongs to a bag."""


def collected(places: Mapping[str, Path]) -> dict[str, bytes]:
    """Files, and those of folders below their names, as attachments by name.

    Raises:
        UserError: one cannot be read, or they are larger than what a bag should carry.
    """
    found: dict[str, bytes] = {}
    for name, place in places.items():
        try:
            if place.is_dir():
                files = {f"{name}/{file.relative_to(place).as_posix()}": file for file in sorted(place.rglob("*"))}
                found |= {key: file.read_bytes() for key, file in files.items() if file.is_file()}
            else:
                found[name] = place.read_bytes()
        except OSError as error:
            raise UserError(f"{place}: cannot be read ({error.strerror})") from error
        if sum(map(len, found.values())) > LARGEST:
            raise UserError(f"{place}: more than {LARGEST >> 20} MiB, too much to be kept in a bag")
    return found


def attached(path: Path | str) -> dict[str, bytes]:
    """What a bag keeps beside its messages, by name, of one name the last; of a cut bag as far as it goes. {} where
    there is nothing, as in bags of other recorders.

    Raises:
        UserError: there is no bag.
    """
    path, found = Path(path), dict[str, bytes]()
    if not path.exists():
        raise UserError(f"{path}: no such file or folder")
    with clear_line(path):
        for file in storage_files(path):
            if file.suffix == ".mcap":
                with file.open("rb") as stream:
                    found |= {item.name: item.data for item in _of(stream)}
    return found


def _of(stream: BinaryIO) -> Iterator[Attachment]:
    try:
        yield from list(make_reader(stream).iter_attachments())
        return
    except Exception:  # whatever a file leads the library to that has no index, or no end
        stream.seek(0)
    with suppress(Exception):
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Attachment):
                yield record


def laid_out(found: Mapping[str, bytes], folder: Path, *, below: str) -> Path:
    """Write the attachments below a name, such as model, into a folder of that name in `folder`, and return it.

    Raises:
        UserError: there are none, a name leads out of the folder, or it cannot be written.
    """
    chosen = {PurePosixPath(name): data for name, data in found.items() if name.startswith(f"{below}/")}
    if not chosen:
        raise UserError(f"the bag has no {below} with it")
    for name, data in chosen.items():
        if ".." in name.parts:
            raise UserError(f"an attachment of the bag is called {name}, which leads out of its folder")
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
    return folder / below

"""Attachments: files that a bag keeps beside its messages to document them."""

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
"""Bytes of all attachments of a bag."""


def collected(places: Mapping[str, Path]) -> dict[str, bytes]:
    """Files as attachments by name; files of a folder have names below the folder's.

    Raises UserError where a file cannot be read, or all are larger together than a bag should carry.
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
            raise UserError(f"{place}: has more than {LARGEST >> 20} MiB, too much for a bag; leave it out")
    return found


def attached(path: Path | str) -> dict[str, bytes]:
    """The attachments of a bag by name; the last of each name, and of a cut bag those before the cut. It is empty for
    bags of other recorders.

    Raises UserError where there is no bag.
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
    except Exception:  # the library may raise anything for a file without index or end
        stream.seek(0)
    with suppress(Exception):
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Attachment):
                yield record


def laid_out(found: Mapping[str, bytes], folder: Path, *, below: str) -> Path:
    """Write the attachments below a name, such as model, into a folder of that name in `folder`, and return it.

    Raises UserError where there are no such attachments, a name leads out of the folder, or it cannot be written.
    """
    chosen = {PurePosixPath(name): data for name, data in found.items() if name.startswith(f"{below}/")}
    if not chosen:
        raise UserError(f"the bag has no {below} attached")
    for name, data in chosen.items():
        if ".." in name.parts:
            raise UserError(f"an attachment of the bag is called {name}, which leads out of its folder")
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
    return folder / below

"""Metadata: what metadata.yaml says of a bag's folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from hybrid_sysid_ros.bags.mcap import DamagedError
from hybrid_sysid_ros.support import yaml_text

FILE = "metadata.yaml"  # what makes a folder a bag
NEWEST = 9
PACKINGS = ("", "none", "file", "message")


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """files: of the folder, in their order. packing: "", "file" or "message": what zstd packed. types, counts: of each
    topic, its messages' type and number.
    """

    files: tuple[Path, ...]
    packing: str
    types: dict[str, str]
    counts: dict[str, int]


def load(folder: Path) -> Metadata:
    """Read it.

    Raises:
        OSError: it can't be read.
        DamagedError: it is not what rosbag2 writes, or a file that it names is missing.
    """
    try:
        return _of(yaml_text.read(folder / FILE)["rosbag2_bagfile_information"], folder)
    except yaml_text.TextError as error:
        raise DamagedError(f"{FILE} {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = str(error) if isinstance(error, DamagedError) else f"{error!r} is missing or malformed"
        raise DamagedError(f"{FILE}: {reason}") from error


def _of(content: dict[str, Any], folder: Path) -> Metadata:
    if content["version"] > NEWEST:
        raise DamagedError(f"version {content['version']} is newer than {NEWEST}, the newest that is read here")
    files = tuple(folder / PurePath(name).name for name in content["relative_file_paths"])
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise DamagedError(f"{', '.join(missing)} of it is missing")
    packing = str(content.get("compression_mode") or "").lower()
    if packing not in PACKINGS or (packing[:1] in "fm" and packing and content.get("compression_format") != "zstd"):
        raise DamagedError(f"compression {packing} by {content.get('compression_format')} can't be read, only zstd")
    types, counts = dict[str, str](), dict[str, int]()
    for told in content["topics_with_message_count"]:
        topic = told["topic_metadata"]
        if topic["serialization_format"] != "cdr":
            raise DamagedError(f"topic {topic['name']} is in {topic['serialization_format']}, not in CDR")
        types[str(topic["name"])] = str(topic["type"])
        counts[str(topic["name"])] = counts.get(str(topic["name"]), 0) + int(told["message_count"])
    return Metadata(files=files, packing="" if packing == "none" else packing, types=types, counts=counts)

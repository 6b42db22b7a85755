"""Metadata: a bag's metadata.yaml, read and written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import yaml

from hybrid_sysid_ros.bags.mcap import DamagedError
from hybrid_sysid_ros.bags.quality_of_service import QualityOfService
from hybrid_sysid_ros.bags.storage import DISTRIBUTION, Extent, OfferedTopic
from hybrid_sysid_ros.support import yaml_text

FILE = "metadata.yaml"  # what makes a folder a bag
NEWEST = 9
PACKINGS = ("", "none", "file", "message")


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """files: those of the folder, in order. packing: what zstd compressed, "", "file" or "message". types, counts,
    qualities: by topic, the type and number of messages and the publishers' qualities of service where they are known.
    """

    files: tuple[Path, ...]
    packing: str
    types: dict[str, str]
    counts: dict[str, int]
    qualities: dict[str, list[QualityOfService]]


def load(folder: Path) -> Metadata:
    """Read metadata.yaml. Raises OSError where it can't be read, and DamagedError where rosbag2 would not have written
    it so, or a file that it names is missing.
    """
    try:
        return _of(yaml_text.read(folder / FILE)["rosbag2_bagfile_information"], folder)
    except yaml_text.TextError as error:
        raise DamagedError(f"{FILE} {error}") from error
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
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
    types, counts, qualities = dict[str, str](), dict[str, int](), dict[str, list[QualityOfService]]()
    for given in content["topics_with_message_count"]:
        topic = given["topic_metadata"]
        if topic["serialization_format"] != "cdr":
            raise DamagedError(f"topic {topic['name']} is in {topic['serialization_format']}, not in CDR")
        types[str(topic["name"])] = str(topic["type"])
        counts[str(topic["name"])] = counts.get(str(topic["name"]), 0) + int(given["message_count"])
        qualities.setdefault(str(topic["name"]), []).extend(_qualities(topic.get("offered_qos_profiles")))
    packing = "" if packing == "none" else packing
    return Metadata(files=files, packing=packing, types=types, counts=counts, qualities=qualities)


def _qualities(given: Any) -> list[QualityOfService]:
    """The profiles of a topic; none where they are unreadable, since no measurement depends on them."""
    with suppress(KeyError, TypeError, ValueError, AttributeError, yaml_text.TextError):
        profiles = yaml_text.parsed(given) if isinstance(given, str) else given
        return [QualityOfService.of(profile) for profile in profiles or ()]
    return []


def text(files: Sequence[Extent], offers: Sequence[OfferedTopic], notes: Mapping[str, str]) -> str:
    """The text that rosbag2 of ROS 2 Jazzy writes about a bag's files and topics; notes: custom_data."""
    return _dumped({"rosbag2_bagfile_information": _description(files, offers, notes)})


def inner_text(file: Extent, offers: Sequence[OfferedTopic], notes: Mapping[str, str]) -> str:
    """The text that rosbag2 writes into one file of a bag."""
    return _dumped(_description([file], offers, notes))


def _description(files: Sequence[Extent], offers: Sequence[OfferedTopic], notes: Mapping[str, str]) -> dict[str, Any]:
    counts = sum((file.counts for file in files), Counter[str]())
    held = [file for file in files if file.counts]
    first, last = min((file.first for file in held), default=0), max((file.last for file in held), default=0)
    return {
        "version": NEWEST,
        "storage_identifier": "mcap",
        **_times(first, last),
        "message_count": counts.total(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": offer.topic,
                    "type": offer.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": offer.profiles,
                    "type_description_hash": offer.hash,
                },
                "message_count": counts[offer.topic],
            }
            for offer in offers
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {"path": file.name, **_times(file.first, file.last), "message_count": file.counts.total()} for file in files
        ],
        "custom_data": dict(notes) or None,
        "ros_distro": DISTRIBUTION,
    }


def _times(first: int, last: int) -> dict[str, Any]:
    return {"duration": {"nanoseconds": last - first}, "starting_time": {"nanoseconds_since_epoch": first}}


def _dumped(content: dict[str, Any]) -> str:
    return str(yaml.dump(content, Dumper=yaml_text.Dumper, sort_keys=False, allow_unicode=True))

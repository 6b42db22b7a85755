"""Contents: whole topics of a bag in memory, and the list of all of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from rosbags.typesys.store import Typestore

from hybrid_sysid_ros.bags.bag import Messages, Topic, listing, opened


@dataclass(frozen=True, kw_only=True, eq=False)
class Contents:
    """What was read from a bag: all its topics, the messages of those asked for, and the definitions of their types."""

    topics: dict[str, Topic]
    messages: dict[str, Messages]
    typestore: Typestore

    @cached_property
    def listing(self) -> str:
        """Topics and types in a line, for messages to the user."""
        return listing(self.topics)


def topics(path: Path | str) -> dict[str, Topic]:
    """Topics of a bag by name.

    Raises:
        UserError: see bag.opened().
    """
    with opened(path) as bag:
        return bag.topics


def contents(path: Path | str, wanted: Collection[str], *, recover: bool = False) -> Contents:
    """Read all messages of the topics in `wanted`, for bags that are small beside the memory.

    recover: see bag.opened().

    Raises:
        UserError: see bag.opened().
    """
    with opened(path, recover=recover) as bag:
        found: dict[str, list[Messages]] = {name: [] for name in bag.topics if name in wanted}
        for block in bag.blocks(found):
            found[block.topic].append(block)
        return Contents(
            topics=bag.topics,
            messages={name: _joined(bag.topics[name], blocks) for name, blocks in found.items()},
            typestore=bag.typestore,
        )


def _joined(topic: Topic, blocks: list[Messages]) -> Messages:
    return Messages(
        topic=topic.name,
        type=topic.type,
        logged=np.concatenate([np.empty(0, dtype=np.int64), *(block.logged for block in blocks)]),
        data=[message for block in blocks for message in block.data],
    )

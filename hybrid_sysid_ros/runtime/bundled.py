"""Shipped: what comes trained with the package."""

from __future__ import annotations

from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

OPTIONS = {"model": "--model", "policy": "--policy-path", "layers": "--layers"}
"""Of commands, by which another folder than the shipped one is given."""
TRAINED = Path(__file__).parents[1] / "trained"


class NothingShippedError(UserError):
    """Nothing of a kind comes with the package for a rig."""


def shipped(rig: str, kind: str) -> Path:
    """Folder of what comes trained with the package for a rig; kind: model, policy or layers. Raises
    NothingShippedError where nothing does.
    """
    folder = TRAINED / rig / kind
    if not folder.is_dir():
        raise NothingShippedError(
            f"no {kind} comes with the package for the rig {rig} ({folder}): give {OPTIONS[kind]}"
        )
    return folder

"""Reading of bags by commands, with warnings of doubtful values."""

from __future__ import annotations

from pathlib import Path

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import status
from hybrid_sysid_ros.library.records import checked_bag
from hybrid_sysid_ros.models import InputHandling, Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import provided


def read_records(
    paths: list[Path],
    rig: str,
    signals: Path | None,
    recover: bool,
    period: float,
    handling: InputHandling,
    *,
    model: Model | None = None,
) -> list[Record]:
    """The records of bags, by a rig's signals or a user's file. Doubtful values are reported.

    period: that of the samples that are kept [s], 0 for all. model: the model that is scored on them. Raises UserError
    for two bags with one name, for signals in another unit than the rig's, for inputs that its actuators can't give,
    and where the model's handling reads inputs at samples, but the period leaves only means.
    """
    if period and handling == "sampled":
        raise UserError("--read-period keeps means of the input, but the model reads it sampled; leave one out")
    check_names(paths)
    described = load_rig(rig)
    return [
        checked_bag(
            path,
            described,
            signals=signals,
            period=period,
            recover=recover,
            doubtful=lambda line: status.print(f"doubt: {line}"),
            model=model,
        )
        for path in paths
    ]


def check_names(paths: list[Path]) -> None:
    """Raise UserError for two bags with one name."""
    names = [bags.name_of(path) for path in paths]
    if twins := {name for name in names if names.count(name) > 1}:
        raise UserError(f"two bags are called {min(twins)}: results go by the name, so rename one")


def check_records(records: list[Record], rig: Rig, *, anyway: bool) -> None:
    """Print the costliest fault of each record, as the extensions that check records find them. Raises UserError for a
    record to which a fit would be worth nothing, unless it is to be fitted anyway.
    """
    for check in provided("record_checks").values():
        for record in records:
            found = check(record, rig)
            if found and found[0].blocks and not anyway:
                raise UserError(
                    f"{record.source or record.name}: {found[0]}; a fit would be worth nothing (--anyway fits)"
                )
            if found:
                status.print(f"doubt: {record.name}: {found[0]}")

"""The loop that an export command writes: a rig, its model, and who drives, out of folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid_sysid_ros.models import Model, load, storage
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.rig import load as load_rig

PolicyFolder = Annotated[Path | None, typer.Option(help="Policy folder: it drives while it passes the check.")]
Daqp = Annotated[Path | None, typer.Option(help="Folder of DAQP's C sources, without network.")]


def exported_loop(
    model: Path, rig: str, policy: Path | None, daqp: Path | None, *, real_time: bool = True
) -> tuple[Rig, Model, dict[str, Any]]:
    """Rig, model, and keywords of :func:`~.unit.folder.export_loop`, which the exports of other bodies take, too.

    policy: folder of one that drives while it passes its check. daqp: C sources of the solver. Raises UserError for
    folders that can't be read.
    """
    loaded, settings = load(model, rig=rig), {"real_time": real_time}
    given: dict[str, Any] = {"settings": settings, "seal": storage.digest(model, kind="model"), "source": daqp}
    if policy is not None:
        given["settings"] = {**settings, "policy": "supervised", "policy_path": str(policy)}
        given["policy_seal"] = storage.digest(policy, kind="policy")
    return load_rig(rig or loaded.rig), loaded, given

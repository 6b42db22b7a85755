"""DAQP's own C, from the package index's source archive of the installed version or from a folder of the user."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from hybrid_sysid_ros.core.compilation import folder
from hybrid_sysid_ros.support.errors import UserError

PARTS = {"csrc/src": "*.c", "csrc/include": "*.h"}
LICENCE = "LICENSE"
LEFT_OUT = Path(__file__).parent / "c" / "left_out.c"
UNUSED = ("avi.c", "bnb.c", "eq_elim.c", "hierarchical.c", "presolve.c")
"""Files for what no loop needs; LEFT_OUT has what the others call of them."""
TIME_LIMIT = 300.0
"""Of a download [s], with what its metadata takes."""


def daqp(given: Path | None = None) -> Path:
    """A folder with csrc/src, csrc/include and LICENSE: the given one, or one in the cache, filled once.

    Raises UserError where the given one is no such folder, or the archive can't be fetched.
    """
    if given is not None:
        if not _is_whole(given):
            raise UserError(f"{given}: has no csrc/src, csrc/include and {LICENCE} of DAQP; unpack its source archive")
        return given
    release = version("daqp")
    kept = folder("daqp", release) / f"daqp-{release}"
    if not _is_whole(kept):
        _fetch(release, kept)
    return kept


def copy_to(source: Path, target: Path) -> None:
    """Copy the C that a loop needs and its licence to a folder."""
    target.mkdir()
    paths = [path for part, pattern in PARTS.items() for path in (source / part).glob(pattern)]
    for path in (*paths, source / LICENCE, LEFT_OUT):
        if path.name not in UNUSED:
            shutil.copyfile(path, target / path.name)


def _is_whole(place: Path) -> bool:
    return all(any((place / part).glob(pattern)) for part, pattern in PARTS.items()) and (place / LICENCE).is_file()


def _fetch(release: str, target: Path) -> None:
    with TemporaryDirectory(dir=target.parent) as scratch:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", "daqp"]
        try:
            done = subprocess.run(
                [*command, f"daqp=={release}", "--dest", scratch],
                capture_output=True, text=True, timeout=TIME_LIMIT, check=False,
            )  # fmt: skip
            archives = list(Path(scratch).glob("*.tar.gz"))
            if done.returncode or not archives:
                raise UserError(_advice(release, (done.stderr.strip().splitlines() or ["no archive"])[-1]))
            with tarfile.open(archives[0]) as archive:
                archive.extractall(scratch, filter="data")
            shutil.rmtree(target, ignore_errors=True)
            shutil.move(Path(scratch) / f"daqp-{release}", target)
        except (OSError, tarfile.TarError, subprocess.TimeoutExpired) as error:
            raise UserError(_advice(release, str(error))) from error
    if not _is_whole(target):
        raise UserError(_advice(release, "its archive has other folders"))


def _advice(release: str, reason: str) -> str:
    return (
        f"export: the C sources of DAQP can't be fetched ({reason}); unpack daqp-{release}.tar.gz of the package index "
        "and name its folder with --daqp"
    )

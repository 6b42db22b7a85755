"""Files and folders written beside their place, then renamed: what is on disk is old and whole, or new and whole."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError, shown


def path_of(value: str | Path, argument: str) -> Path:
    """A path out of an argument, "~" a home. Raises UserError for what can be none."""
    if not isinstance(value, str | Path) or not str(value):
        raise UserError(f"{argument} is {shown(value)}; give a path, as text or pathlib.Path")
    try:
        path = Path(value).expanduser()
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            path.lstat()
    except (RuntimeError, ValueError, OSError) as error:
        raise UserError(
            f"{argument} is {shown(value)}, which can be no path ({getattr(error, 'strerror', None) or error}); give "
            "another"
        ) from error
    return path


@contextmanager
def written_file(path: Path | str) -> Iterator[Path]:
    """Yield a path of the same name in a temporary folder beside `path`; rename it into place if the body succeeds.

    Missing parent folders are made. If the body raises, `path` stays as it was.

    Raises UserError where the place cannot be written, or `path` is a folder.
    """
    target = Path(os.path.realpath(path))
    _check_no_folder(Path(path), target)
    with room_beside(target) as partial:
        yield partial
        os.replace(partial, target)


def write_text(path: Path | str, text: str) -> None:
    """Write a text beside its place, and rename it. Raises UserError as :func:`written_file` does."""
    with written_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def written_folder(
    path: Path | str, *, marker: str | tuple[str, ...], replace: bool = True, force: bool = False
) -> Iterator[Path]:
    """Yield a new, empty folder beside `path`; put it in place if the body succeeds. The old one is kept until then.

    marker: the file that shows that a folder is of our kind ("metadata.yaml" for a bag, "model.yaml" for a model), or
        several of which one does. A folder that exists is replaced only if it is empty or holds it, and never if
        `replace` is false.
    force: replace the folder whatever it holds.

    Raises UserError where the place cannot be written, or holds something that may not be replaced.
    """
    target = Path(os.path.realpath(path))
    _check_replaceable(Path(path), target, marker=marker, replace=replace, force=force)
    with room_beside(target) as partial:
        partial.mkdir()
        yield partial
        take_place(partial, target, old=partial.with_name(f"{partial.name}.old"))


@contextmanager
def room_beside(target: Path) -> Iterator[Path]:
    """Yield a free path with the target's name inside a temporary folder next to it, and remove that folder at exit,
    with the parents that were made for it where nothing came into them.
    """
    container: Path | None = None
    made = [parent for parent in target.parents if not os.path.exists(parent)]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        container = Path(tempfile.mkdtemp(prefix=f"{target.name}.partial-", dir=target.parent))
        yield container / target.name
    except OSError as error:
        if _concerns(error, target, container):
            raise _unwritable(target, error) from error
        raise
    finally:
        if container is not None:
            shutil.rmtree(container, ignore_errors=True)
        with suppress(OSError):  # one is not empty, or was never made
            for parent in made:
                parent.rmdir()


def take_place(partial: Path, target: Path, *, old: Path) -> bool:
    """Rename the folder `partial` to `target`, and what is there to `old`; whether something was there."""
    had_old = target.exists()
    if had_old:
        os.rename(target, old)
    try:
        os.rename(partial, target)
    except OSError:
        if had_old:
            os.rename(old, target)
        raise
    return had_old


def check_file(path: Path | str, *, suffix: str = "", replace: bool = True) -> None:
    """Whether written_file() could write there, to be asked before long work.

    suffix: that the name must end in, so that no file of another kind is taken for an old one. replace: whether a file
    that is there may be replaced.

    Raises UserError where the place cannot be written, `path` is a folder, has another suffix, or may not be replaced.
    """
    target = Path(os.path.realpath(path))
    if not target.name.endswith(suffix):
        raise UserError(f"{path}: does not end in {suffix}: choose a name that does")
    _check_no_folder(Path(path), target)
    if not replace and target.exists():
        raise _taken(path)
    _check_writable(target)


def check_folder(path: Path | str, *, marker: str | tuple[str, ...], replace: bool = True) -> None:
    """Whether written_folder() could write there, to be asked before long work.

    Raises UserError where the place cannot be written, or holds something that may not be replaced.
    """
    target = Path(os.path.realpath(path))
    _check_replaceable(Path(path), target, marker=marker, replace=replace, force=False)
    _check_writable(target)


def beside(path: Path | str, suffix: str) -> Path:
    """The place next to a file or folder, of its name and a suffix; of ".", next to the current folder."""
    target = Path(os.path.realpath(path))
    return target.with_name(f"{target.name}{suffix}")


def sha256(path: Path | str, *, without: str = "") -> str:
    """Hexadecimal SHA-256 of a file, or of a folder.

    A folder's is that of its list of files, sorted by relative path, as `sha256sum` prints it ("<digest>  <path>").
    without: a file of the folder that is left out.

    Raises UserError where there is no such file or folder, or it cannot be read.
    """
    path = Path(path)
    try:
        if path.is_dir():
            names = sorted(file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file())
            listing = "".join(f"{sha256(path / name)}  {name}\n" for name in names if name != without)
            return hashlib.sha256(listing.encode()).hexdigest()
        digest = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
        return digest.hexdigest()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from error


def _check_no_folder(path: Path, target: Path) -> None:
    if os.path.isdir(target):
        raise UserError(f"{path}: is a folder, not a file: choose another name")
    if os.path.exists(target) and not os.path.isfile(target):
        raise UserError(f"{path}: is a device or a pipe, which can't be replaced by a file: choose another name")


def _check_replaceable(path: Path, target: Path, *, marker: str | tuple[str, ...], replace: bool, force: bool) -> None:
    if not os.path.exists(target):
        return
    if not target.is_dir():
        raise UserError(f"{path}: is a file, not a folder: choose another name")
    if Path.cwd().is_relative_to(target):
        raise UserError(f"{path}: is the current folder or above it, so it is not replaced: choose another name")
    try:
        empty = not any(target.iterdir())
    except OSError as error:
        raise _unwritable(target, error) from error
    if force or empty:
        return
    markers = (marker,) if isinstance(marker, str) else marker
    if not any(os.path.isfile(target / name) for name in markers):
        raise UserError(f"{path}: holds other files (no {markers[0]}), so it is not replaced: choose another name")
    if not replace:
        raise _taken(path)


def _taken(path: Path | str) -> UserError:
    return UserError(f"{path}: exists already: choose another name, or replace it (overwrite=True, --overwrite)")


def _check_writable(target: Path) -> None:
    """Make a folder where the target's parents begin, and remove it: permissions alone don't tell of /proc, or of a
    disk that is full or may only be read.
    """
    ancestor = next(folder for folder in target.parents if os.path.exists(folder))
    try:
        tempfile.TemporaryDirectory(prefix=f"{target.name}.partial-", dir=ancestor).cleanup()
    except OSError as error:
        raise _unwritable(target, error) from error


def _unwritable(target: Path, error: OSError) -> UserError:
    return UserError(f"{target}: cannot be written ({error.strerror}): choose another place")


def _concerns(error: OSError, target: Path, container: Path | None) -> bool:
    """Whether an error of the operating system is about the place that is written (and not about a file read)."""
    if error.strerror is None:
        return False
    if error.errno in (errno.ENOSPC, errno.EDQUOT):  # of a copy, which names what is read
        return True
    if error.filename is None or container is None:
        return True
    return str(error.filename).startswith((str(container), str(target)))


def make_folder(path: Path) -> None:
    """Make a folder, or raise UserError before any work is done for it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: can't be made a folder ({error.strerror}); choose another --out") from error

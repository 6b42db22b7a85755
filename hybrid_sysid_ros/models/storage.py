"""A folder of plain data: one YAML file and one file of arrays, sealed by checksums. Loading runs no code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file
from safetensors.numpy import save as serialised

from hybrid_sysid_ros.support import yaml_text
from hybrid_sysid_ros.support.arrays import Array, NamedArrays
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import path_of, sha256, write_text, written_folder
from hybrid_sysid_ros.support.structured import read_mapping

ARRAYS = "weights.safetensors"
MADE_BY = {
    "model": "identify", "policy": "policy train", "certificate": "policy certify", "layers": "video --layers",
    "notes": "trained-range",
}  # fmt: skip
"""The commands that write each kind."""


def save(folder: Path | str, *, kind: str, version: int, content: dict[str, Any], arrays: NamedArrays) -> None:
    """Write ``KIND.yaml`` and the arrays beside the folder, then rename; an older folder of this kind is replaced.

    Raises UserError where the place can't be written or holds something else.
    """
    with written_folder(path_of(folder, "folder"), marker=f"{kind}.yaml") as partial:
        save_arrays(partial / ARRAYS, arrays)
        body = {**content, "arrays": {"file": ARRAYS, "sha256": sha256(partial / ARRAYS)}}
        (partial / f"{kind}.yaml").write_text(_text(version, body), encoding="utf-8")


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a file of arrays. The umask decides who may read it, as for any other file; a file of safetensors' own
    function could be read by its owner alone, not by nodes of another user.
    """
    path.write_bytes(serialised({name: np.ascontiguousarray(value) for name, value in arrays.items()}))


def save_sheet(path: Path | str, *, version: int, content: dict[str, Any]) -> None:
    """Write one sealed YAML file, beside its place, then rename. Raises UserError where it can't be written."""
    write_text(path, _text(version, content))


def load(folder: Path | str, *, kind: str, version: int) -> tuple[dict[str, Any], NamedArrays]:
    """Read what :func:`save` wrote.

    Raises UserError, naming the file, where one is missing, unreadable, altered since it was saved, or of a newer
    format than this version reads.
    """
    path = _sheet(folder, kind)
    content = load_sheet(path, kind=kind, version=version)
    arrays_path = Path(folder) / ARRAYS
    if not arrays_path.is_file():
        raise UserError(f"{arrays_path}: is missing; restore it or {_again(kind)}")
    if content.get("arrays") != {"file": ARRAYS, "sha256": sha256(arrays_path)}:
        raise UserError(f"{arrays_path}: was altered since it was saved; restore it or {_again(kind)}")
    try:
        return content, load_file(arrays_path)
    except (SafetensorError, OSError, ValueError, LookupError, OverflowError) as error:  # data types that numpy lacks
        raise UserError(f"{arrays_path}: can't be read; restore it or {_again(kind)}") from error


def numbers(arrays: Mapping[str, NDArray[Any]], name: str, *shape: int | None) -> Array:
    """A loaded array by its name, as float64, of a shape in which None is any size; float32 and the like are converted.

    Raises KeyError where it is missing, and UserError where it is of another shape, holds no real numbers, or some that
    are not finite.
    """
    array = arrays[name]
    if array.dtype.kind not in "fiu":
        raise UserError(f"array {name} is of kind {array.dtype}; it needs real numbers, float64 at best")
    if len(array.shape) != len(shape) or any(size not in (None, n) for size, n in zip(shape, array.shape, strict=True)):
        wanted = tuple("any" if size is None else size for size in shape)
        raise UserError(f"array {name} has the shape {array.shape}, not ({', '.join(map(str, wanted))})")
    found = np.ascontiguousarray(array, dtype=np.float64)
    if not np.isfinite(found).all():
        raise UserError(f"array {name} holds numbers that are not finite")
    return found


def load_sheet(path: Path, *, kind: str, version: int) -> dict[str, Any]:
    """Read the sealed YAML file of a ``kind``.

    Raises UserError, naming the file, where it is unreadable, altered since it was saved, or of another format.
    """
    content = _content(path, kind)
    if not isinstance(content.get("format"), int):
        raise UserError(f"{path}: has no format number; restore it or {_again(kind)}")
    if content["format"] > version:
        raise UserError(
            f"{path}: format {content['format']} is newer than {version}, the newest that this version reads; "
            "update hybrid_sysid_ros"
        )
    if content["format"] < version:
        raise UserError(f"{path}: format {content['format']} is older than {version}; {_again(kind)}")
    if not _sealed(content):
        raise UserError(f"{path}: was altered since it was saved; restore it or {_again(kind)}")
    return content


def digest(folder: Path | str, *, kind: str) -> str:
    """The seal of a saved folder, by which a folder that was made from it refers to it.

    Raises UserError where there is none, or it can't be read.
    """
    path = _sheet(folder, kind)
    content = _content(path, kind)
    if "seal" not in content:
        raise UserError(f"{path}: has no seal; restore it or {_again(kind)}")
    return str(content["seal"])


def _content(path: Path, kind: str) -> dict[str, Any]:
    try:
        return read_mapping(path)
    except UserError as error:
        raise UserError(f"{error}; restore it or {_again(kind)}") from error


def _sheet(folder: Path | str, kind: str) -> Path:
    """The YAML file of a folder of this kind."""
    path = Path(folder) / f"{kind}.yaml"
    if not Path(folder).is_dir():
        raise UserError(f"{folder}: no such {kind} folder")
    if not path.is_file():
        raise UserError(f"{path}: is missing, so {folder} is no {kind} folder")
    return path


def _again(kind: str) -> str:
    return f"make the {kind} again (hybrid-sysid {MADE_BY[kind]})"


def _sealed(content: dict[Any, Any]) -> bool:
    try:
        return bool(content.get("seal") == _seal({key: value for key, value in content.items() if key != "seal"}))
    except (TypeError, ValueError, RecursionError):  # what YAML knows and we never write: dates, keys of several types
        return False


def _text(version: int, content: dict[str, Any]) -> str:
    """The content as YAML, its format first and its seal last."""
    body = {"format": version, **plain(content)}
    body["seal"] = _seal(body)
    return str(yaml.dump(body, Dumper=yaml_text.Dumper, sort_keys=False, allow_unicode=True, width=120))


def _seal(body: dict[str, Any]) -> str:
    """Checksum of the content, independent of the file's order and layout."""
    return hashlib.sha256(json.dumps(body, sort_keys=True, ensure_ascii=True).encode()).hexdigest()


def plain(value: Any) -> Any:
    """A value in types that YAML and JSON write in the same way."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    return value

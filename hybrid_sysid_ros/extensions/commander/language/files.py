"""Files that a command may name: columns of numbers and pictures below one folder, and no other file."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.extensions.commander.language.vocabulary import Vocabulary
from hybrid_sysid_ros.rigs.units import of_rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LARGEST, LARGEST_PICTURE = 1 << 20, 1 << 23  # bytes
PICTURES = (".jpg", ".jpeg", ".png")


def is_picture(name: str) -> bool:
    """Whether a file is a picture, by its name."""
    return name.lower().endswith(PICTURES)


@dataclass(frozen=True, kw_only=True)
class Files:
    """Those below a folder; "": none."""

    folder: str = ""

    def find(self, name: str) -> Path:
        """The file of a name. Raises UserError where it lies elsewhere, is none, or is too large."""
        if not self.folder:
            raise UserError(
                "no files may be followed here: start the commander with a folder of them (-p folder:=PATH)"
            )
        root = Path(self.folder).resolve()
        path = (root / name).resolve()
        if not path.is_relative_to(root):
            raise UserError(f"{name[:60]}: lies outside of the folder of files to follow: copy it there")
        if not path.is_file():
            raise UserError(f"{name[:60]}: no such file in the folder of files to follow")
        largest = LARGEST_PICTURE if is_picture(name) else LARGEST
        if path.stat().st_size > largest:
            raise UserError(f"{name[:60]}: is larger than {largest >> 20} MB: make it smaller")
        return path


def columns(path: Path, vocabulary: Vocabulary) -> tuple[Array, dict[int, Array]]:
    """Times [s] and values of outputs, as they are shown, of a file of columns.

    Its first row names them, "time, OUTPUT [unit]", the unit being the one in which it is shown where none is given.
    Raises UserError for whatever is no such file; none of its content is shown.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file, skipinitialspace=True) if row and not row[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path.name}: is no file of columns: 'time, OUTPUT [unit]', then numbers") from error
    outputs = {output.name: k for k, output in enumerate(vocabulary.outputs) if output.tracked}
    if len(rows) < 3:
        raise UserError(f"{path.name}: has less than two points: 'time, {', '.join(outputs)}', then numbers")
    head = [cell.strip() for cell in rows[0]]
    if head[0].partition("[")[0].strip() not in ("time", "t") or len(head) < 2:
        raise UserError(f"{path.name}: begins with other columns: it needs 'time, {', '.join(outputs)}'")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise UserError(f"{path.name}: has cells that are no numbers, or rows of other lengths") from error
    if table.shape[1] != len(head) or not np.isfinite(table).all():
        raise UserError(f"{path.name}: needs a finite number for each column in each row")
    times = table[:, 0] - table[0, 0]
    if (np.diff(times) <= 0.0).any():
        raise UserError(f"{path.name}: its times must grow from row to row")
    found = {}
    for name, values in zip(head[1:], table[:, 1:].T, strict=True):
        word, _, unit = (part.strip() for part in name.partition("["))
        if word not in outputs:
            raise UserError(f"{path.name}: no tracked output {word[:40]!r}: they are {', '.join(outputs)}")
        found[outputs[word]] = values * _factor(unit.rstrip("] "), outputs[word], vocabulary, path)
    return times, found


def _factor(unit: str, output: int, vocabulary: Vocabulary, path: Path) -> float:
    """What a column's unit is in the shown one; without one it is the shown one."""
    shown = vocabulary.outputs[output]
    if not unit or unit == shown.unit:
        return 1.0
    given, own, si = of_rig(unit), of_rig(shown.unit), of_rig(vocabulary.si(shown))
    if given.alike(own):
        return given.factor / own.factor
    if given.alike(si) and math.isfinite(shown.scale):
        return given.factor * si.factor / shown.scale
    raise UserError(f"{path.name}: {shown.name} is in {shown.unit}, not in {unit[:20]}")

"""The lecture on the cam-driven beam: its protocols, its names of records and its published results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture import records as bab

RIG = "cam_beam"
DATA = "HYBRID_SYSID_DATA"
"""Environment variable with the folder that has the author's records in its folder bab."""
COLUMNS = ("ms_05", "ms_06", "rs_01", "rs_02", "rs_03", "rs_04", "swept")
NUMBERS = (1, 2, 3)
"""Of the protocols: the lecture's two, and one with motion at creeping speed."""
FIRST_HALF, SECOND_HALF, WHOLE = Part(stop=0.5), Part(start=0.5), Part()

PUBLISHED: dict[int, dict[str, tuple[float, ...]]] = {
    1: {
        "linear": (0.8511, 0.8404, 0.7439, 0.6846, 0.5800, 0.3755, 0.8637),
        "stribeck": (0.8578, 0.8480, 0.7540, 0.7161, 0.6381, 0.4907, 0.8801),
        "black_box": (0.8794, 0.6762, 0.7686, 0.7068, 0.6915, 0.5986, 0.8055),
        "hybrid_joint": (0.9467, 0.9643, 0.5601, 0.5110, 0.4078, 0.4406, 0.8984),
        "hybrid_frozen": (0.9821, 0.9316, 0.5677, 0.4854, 0.3235, 0.4899, 0.8914),
    },
    2: {
        "linear": (0.4025, 0.6423, 0.7822, 0.7475, 0.5875, 0.5626, 0.8679),
        "stribeck": (0.5382, 0.4376, 0.4586, 0.4344, 0.2880, 0.2520, 0.6116),
        "black_box": (-3.9730, -1.9576, 0.5234, 0.5843, 0.4914, 0.6467, 0.8299),
        "hybrid_joint": (0.9122, 0.8645, 0.9318, 0.7863, 0.6329, 0.8895, 0.9532),
        "hybrid_frozen": (0.7983, 0.6804, 0.7266, 0.6004, 0.5082, 0.6440, 0.5814),
    },
}
"""Free-run R2 of the lecture's structures, by protocol, in the order of COLUMNS; its input is read once a sample."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Protocol:
    """training: what models are fitted to; tests: what they are scored on, each with the part of the record."""

    number: int
    training: Sequence[Record]
    part: Part
    """Of the training records, but for slow ramps: these are used as a whole."""
    tests: Sequence[tuple[Record, Part]]

    @property
    def parts(self) -> list[Part]:
        """The part of each training record."""
        return [WHOLE if is_ramp(record.name) else self.part for record in self.training]

    @property
    def about(self) -> str:
        return {
            1: "Trained on the two multisines, tested on all records.",
            2: "Trained on the first halves of multisines and random steps, tested on their second halves and the "
            "swept sine.",
            3: "Trained on the first halves of multisines and random steps and on the slow ramps, tested on the second "
            "halves and the swept sine; the ramps' own scores are those of training data.",
        }[self.number]

    @property
    def alike(self) -> bool:
        """Whether blocks that are held out are of every kind, as the training records are: a creep that is never
        trained on can't be predicted.
        """
        return self.number == 3


def table_name(record: str) -> str:
    """A record's name in the lecture's tables: 05_multisine_01 is ms_05, 03_random_steps_01 rs_01, ... swept."""
    parts = record.split("_")
    if parts[0].isdigit() and "multisine" in record:
        return f"ms_{parts[0]}"
    if parts[0].isdigit() and "random_steps" in record:
        return f"rs_{parts[-1]}"
    if is_ramp(record):
        return f"ramp_{parts[0]}" if parts[0].isdigit() else record
    if parts[0].isdigit() and "swept" in record:
        return "swept"
    return record


def is_ramp(record: str) -> bool:
    """Whether a record is a slow ramp, by its name."""
    return "rampa" in record or "ramp" in record.split("_")


def read_folder(folder: Path, *, slow: bool = False) -> list[Record]:
    """The records of a folder: the author's .mat files in it or in its folder bab, or bags; slow: those in its folder
    bab_slow as well.

    Raises UserError where neither is there, or one cannot be read.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder; name the one with the author's .mat files, or with bags of them")
    sources = [place for place in (folder, folder / "bab") if any(place.glob("*.mat"))][:1]
    if slow and any((folder / "bab_slow").glob("*.mat")):
        sources.append(folder / "bab_slow")
    signals = load_rig(RIG).signals
    if sources:
        with TemporaryDirectory() as place:
            made = [path for item in sources for path in bab.import_folder(item, Path(place) / "records")]
            return [bags.read(path, signals) for path in made]
    paths = sorted(path for path in folder.iterdir() if path.suffix == ".mcap" or (path / "metadata.yaml").is_file())
    if not paths:
        raise UserError(f"{folder}: neither .mat files nor bags are there (docs/guides/bags.md)")
    return [bags.read(path, signals) for path in paths]


def arrange(records: Sequence[Record], number: int) -> Protocol:
    """Records in a protocol's parts, in the order of the tables.

    Raises UserError for an unknown protocol, or where multisines, random steps or, for protocol 3, slow ramps are
    missing.
    """
    if number not in NUMBERS:
        raise UserError(f"protocol {number}: there are protocols 1 and 2, the lecture's, and 3, with the slow ramp")
    order = sorted(records, key=lambda item: ("swept" in item.name, "multisine" not in item.name, item.name))
    multisine = [record for record in order if "multisine" in record.name]
    steps = [record for record in order if "random_steps" in record.name]
    swept = [record for record in order if "swept" in record.name]
    ramps = [record for record in order if is_ramp(record.name)]
    for kind, found in (("multisine", multisine), ("random_steps", steps), *([("ramp", ramps)] if number == 3 else [])):
        if not found:
            where = "; those of .mat files are read from the folder's bab_slow" if kind == "ramp" else ""
            raise UserError(f"protocol {number}: no record has {kind} in its name, so the parts can't be made{where}")
    if number == 1:
        return Protocol(
            number=1, training=multisine, part=WHOLE, tests=[(item, WHOLE) for item in (*multisine, *steps, *swept)]
        )
    training = [*multisine, *steps]
    tests = [*((item, SECOND_HALF) for item in training), *((item, WHOLE) for item in swept)]
    if number == 3:
        training, tests = [*training, *ramps], [*tests, *((item, WHOLE) for item in ramps)]
    return Protocol(number=number, training=training, part=FIRST_HALF, tests=tests)


def published(number: int, structure: str) -> dict[str, float] | None:
    """The published row of a structure by the tables' names of records, None where there is none."""
    row = PUBLISHED.get(number, {}).get(structure)
    return None if row is None else dict(zip(COLUMNS, row, strict=True))

"""The table that the command protocol prints."""

from types import SimpleNamespace
from typing import Any

import pytest

from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.search.cross_validation import Validation
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import structure_names
from studies.beam_lecture.candidate import Candidate
from studies.beam_lecture.comparison import Comparison
from studies.beam_lecture.lecture import COLUMNS, PUBLISHED, Protocol
from studies.beam_lecture.protocol import table

RECORDS = (
    "05_multisine_01",
    "06_multisine_01",
    "01_random_steps_01",
    "02_random_steps_02",
    "03_random_steps_03",
    "04_random_steps_04",
    "07_swept_sine_01",
)


@pytest.mark.parametrize("width", ["40", "80", "200"])
def test_no_number_of_the_table_is_cut(monkeypatch, capsys, width):
    """The widest one: every structure on all of the lecture's records, each by its range over seeds."""
    monkeypatch.setenv("COLUMNS", width)
    records: list[Any] = [SimpleNamespace(name=name) for name in RECORDS]
    protocol = Protocol(number=1, training=[], part=Part(), tests=[(record, Part()) for record in records])
    model: Any = SimpleNamespace(fit={"seconds": 123.4})
    r2 = [dict.fromkeys(RECORDS, -9.123 - 0.5 * number) for number in range(2)]
    held = Validation(scores={"one": 0.9, "two": 0.8}, seconds=1.0)
    made = [Candidate(structure=name, models=[model], r2=r2, validation=held) for name in structure_names()]
    print_table(table(protocol, Comparison(candidates=made, chosen="hybrid", seconds=1.0), "averaged"))
    lines = capsys.readouterr().out.splitlines()
    text = "\n".join(lines)
    assert "…" not in text
    for name in (*COLUMNS, *structure_names(), *(f"{name}, published" for name in PUBLISHED[1]), "hybrid, chosen"):
        assert name in text
    assert text.count("\N{MINUS SIGN}9.623 to \N{MINUS SIGN}9.123") == len(structure_names()) * len(RECORDS)
    assert max(map(len, lines)) == len(lines[1])  # nothing beyond the table's frame

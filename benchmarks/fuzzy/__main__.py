"""Studies of fuzzy models: python -m benchmarks.fuzzy [identification] [inference] [control] [series] [sines]."""

from __future__ import annotations

from functools import partial

from benchmarks import parts, result
from benchmarks.fuzzy import control, functions, identification, inference
from benchmarks.fuzzy.data import RIG

main = partial(
    parts.run,
    str(RIG),
    {
        "identification": identification.measured,
        "inference": inference.measured,
        "control": control.measured,
        "series": functions.series,
        "sines": functions.sum_of_sines,
    },
    name="fuzzy",
)

if __name__ == "__main__":
    result.run(main)

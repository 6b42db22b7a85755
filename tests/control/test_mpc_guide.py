"""What the guide of the MPC shows, as it is printed there."""

import re
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "mpc-problem.md"


def test_the_blocks_of_the_guide_run_in_turn():
    known: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S):
        exec(compile(block, str(PAGE), "exec"), known)
    assert known["answers"].solved.all()
    assert known["near"].solved.all()
    assert np.unique(known["plan"].inputs).size == 6
    assert 0.0 < min(known["margins"]) <= max(known["margins"]) < 0.05
    assert np.abs(known["stays"].inputs - known["point"].inputs).max() < 1e-3
    assert known["near"].iterations.mean() < known["answers"].iterations.mean()

"""What the guide of the MPC shows, as it is printed there."""

import re
from pathlib import Path
from typing import Any

import numpy as np

import hybrid_sysid_ros as hs

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "mpc-problem.md"


def test_the_blocks_of_the_guide_run_in_turn():
    known: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S):
        exec(compile(block, str(PAGE), "exec"), known)
    assert known["answers"].solved.all()
    assert known["near"].solved.all()
    assert np.all(known["stop"].states[:, 0] <= np.linspace(0.03, 0.01, 15) + 1e-6)
    assert np.abs(known["stop"].states[-1, 1]) <= 0.01 + 1e-6
    assert np.abs(known["stop"].inputs).max() <= 3.0 + 1e-6
    assert np.unique(known["plan"].inputs).size == 6
    assert 0.0 < min(known["margins"]) <= max(known["margins"]) < 0.05
    assert np.abs(known["stays"].inputs - known["point"].inputs).max() < 1e-3
    assert known["near"].iterations.mean() < known["answers"].iterations.mean()


def test_a_problem_may_be_economic_alone():
    """A price on the position, and nothing to track: to the end of the travel that the price asks for."""
    given: dict[str, Any] = {
        "terms": {"far": {"value": "position", "price": -50.0}},
        "parameters": {"output_weight": [0.0]},
    }
    mpc = hs.mpc("cam_beam", **given)
    plan = mpc.control(np.zeros(2), np.zeros(1), np.zeros(1), np.zeros((mpc.horizon, 1)))
    assert plan.states[-1, 0] > 0.05
    assert "terms far" in repr(mpc)


def test_numbers_of_numpy_are_numbers():
    prices = np.linspace(0.0, 1.0, 8)
    mpc: Any = hs.mpc(
        "cam_beam",
        terms={"far": {"value": "position", "price": prices, "weight": np.float32(3), "high": np.int64(1)}},
        intervals=np.array([1, 1, 2, 4]),
        parameters={"output_weight": np.array([2.0]), "horizon": np.int64(8)},
    )
    assert mpc.problem.terms[0].price == tuple(prices.tolist())
    assert mpc.problem.terms[0].weight == (3.0,)
    assert list(mpc.problem.intervals) == [1, 1, 2, 4]

"""Many closed loops side by side: in order, kept as they finish, and gone on with."""

import numpy as np
import pytest
from hybrid_sysid_ros.control.many_loops import FILE, Kept, run_all


def squared(item: int) -> dict[str, np.ndarray]:
    return {"square": np.array([item**2.0]), "item": np.array([item])}


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_the_order_of_their_items(jobs):
    told = []
    found = run_all(squared, range(7), jobs=jobs, progress=lambda done, of: told.append((done, of)))
    assert [float(each["square"][0]) for each in found] == [float(k**2) for k in range(7)]
    assert told == [(k + 1, 7) for k in range(7)]


def test_kept_items_are_not_done_again_if_their_purpose_is_the_same(tmp_path):
    kept = Kept(tmp_path / "kept", "a purpose")
    kept.store.keep(kept.key(3), {"square": np.array([-1.0])})
    found = run_all(squared, range(5), jobs=1, kept=kept)
    assert [float(each["square"][0]) for each in found] == [0.0, 1.0, 4.0, -1.0, 16.0]
    other = Kept(tmp_path / "kept", "another")
    assert [float(each["square"][0]) for each in run_all(squared, [3], jobs=1, kept=other)] == [9.0]
    for file in (tmp_path / "kept").rglob(FILE):
        file.write_bytes(file.read_bytes()[:20])  # not written whole
    assert [float(each["square"][0]) for each in run_all(squared, [3], jobs=1, kept=kept)] == [9.0]
    kept.remove()
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_finished_before_an_interrupt_is_kept(tmp_path, jobs):
    def interrupt(done: int, of: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    kept = Kept(tmp_path / "kept", "a purpose")
    with pytest.raises(KeyboardInterrupt):
        run_all(squared, range(100), jobs=jobs, kept=kept, progress=interrupt)
    there = [k for k in range(100) if kept.store.find(kept.key(k)) is not None]
    assert 3 <= len(there) < 50

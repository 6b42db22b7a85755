"""Work in parallel: in order, kept as it finishes, and gone on with."""

import numpy as np
import pytest

from hybrid_sysid_ros.support import parallel
from hybrid_sysid_ros.support.parallel import Store


def squared(piece: int) -> dict[str, np.ndarray]:
    return {"square": np.array([piece**2.0]), "piece": np.array([piece])}


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_their_pieces(workers):
    told = []
    found = parallel.run(squared, range(7), workers=workers, progress=lambda done, of: told.append((done, of)))
    assert [float(each["square"][0]) for each in found] == [float(k**2) for k in range(7)]
    assert told == [(k + 1, 7) for k in range(7)]


def test_kept_pieces_are_not_done_again_if_their_purpose_is_the_same(tmp_path):
    store = Store(tmp_path / "store", "a purpose")
    assert store.find(3) is None
    store.keep(3, {"square": np.array([-1.0])})
    found = parallel.run(squared, range(5), workers=1, store=store)
    assert [float(each["square"][0]) for each in found] == [0.0, 1.0, 4.0, -1.0, 16.0]
    assert all(store.find(k) is not None for k in range(5))
    assert Store(tmp_path / "store", "another").find(3) is None
    for file in (tmp_path / "store").iterdir():
        file.write_bytes(file.read_bytes()[:20])
    assert store.find(3) is None  # not written whole
    store.remove()
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_what_finished_before_an_interrupt_is_kept(tmp_path, workers):
    def interrupt(done: int, of: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    store = Store(tmp_path / "store", "a purpose")
    with pytest.raises(KeyboardInterrupt):
        parallel.run(squared, range(1000), workers=workers, store=store, progress=interrupt)
    kept = [k for k in range(1000) if store.find(k) is not None]
    assert kept[:3] == [0, 1, 2]
    assert len(kept) < 900


def test_an_error_of_a_piece_is_told(tmp_path):
    def broken(piece: int) -> dict[str, np.ndarray]:
        raise ValueError(f"piece {piece}")

    with pytest.raises(ValueError, match="piece 0"):
        parallel.run(broken, range(3), workers=1)

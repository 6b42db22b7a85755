"""Work side by side: in order or as it ends, kept, found again, and left whole by an interrupt."""

import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from hybrid_sysid_ros.extensions.shared import parallel
from hybrid_sysid_ros.extensions.shared.parallel import Store, resumed, run
from hybrid_sysid_ros.extensions.shared.workers import Workers, count
from hybrid_sysid_ros.support import threads
from hybrid_sysid_ros.support.errors import UserError


def squares(number):
    return {"square": np.array([number**2.0]), "threads": np.array([float(threads.available())])}


@pytest.mark.parametrize("how", [{"workers": 1}, {"workers": 2}])
def test_results_come_in_the_order_of_the_pieces(how, tmp_path):
    heard = []
    found = run(squares, [3, 1, 2], store=Store(tmp_path / "kept"), progress=lambda *news: heard.append(news), **how)
    assert [item["square"][0] for item in found] == [9.0, 1.0, 4.0]
    assert heard == [(1, 3), (2, 3), (3, 3)]
    # One alone may use all threads, one beside others has one.
    assert {item["threads"][0] for item in found} == {2.0 if how["workers"] == 1 else 1.0}


def test_what_is_kept_is_not_done_again_and_another_purpose_does_not_find_it(tmp_path):
    done = []

    def work(number):
        done.append(number)
        return squares(number)

    store: Store[dict[str, np.ndarray]] = Store(tmp_path / "kept", "squares")
    run(work, [1, 2], workers=1, store=store)
    found = run(work, [1, 2, 3], workers=1, store=store)
    assert done == [1, 2, 3]
    assert [item["square"][0] for item in found] == [1.0, 4.0, 9.0]
    run(work, [1], workers=1, store=Store(tmp_path / "kept", "cubes"))
    assert done == [1, 2, 3, 1]
    store.remove()
    assert not (tmp_path / "kept").exists()


def test_what_was_not_written_whole_is_not_there(tmp_path):
    store: Store[dict[str, np.ndarray]] = Store(tmp_path)
    store.keep([1, "a"], squares(2))
    kept = store.find([1, "a"])
    assert kept is not None
    assert kept["square"][0] == 4.0
    (place,) = tmp_path.iterdir()
    (place / parallel.ARRAYS).write_bytes(b"short")
    assert store.find([1, "a"]) is None
    (place / parallel.FINISHED).unlink()
    assert store.find([1, "a"]) is None


def test_what_somebody_altered_is_not_there(tmp_path):
    """Also where it can still be read: fewer shots of a batch would go unnoticed."""
    store: Store[dict[str, np.ndarray]] = Store(tmp_path)
    store.keep(1, squares(2))
    (place,) = tmp_path.iterdir()
    save_file({"square": np.array([5.0])}, place / parallel.ARRAYS)
    assert store.find(1) is None
    (place / parallel.FINISHED).write_text("[]")
    assert store.find(1) is None


class Threads(Workers[Any, Any]):
    """Two of this process."""

    pool = ThreadPoolExecutor(2)
    size = 2

    def submit(self, item) -> Future[Any]:
        return self.pool.submit(self.work, item)


def test_after_an_interrupt_what_is_under_way_is_kept(tmp_path):
    started, release = threading.Event(), threading.Event()

    def work(number):
        if number == 2:
            started.set()
            release.wait(20.0)
        return squares(number)

    store: Store[dict[str, np.ndarray]] = Store(tmp_path)
    with Threads(work) as crew:
        items = resumed(crew, [2, 1, 3, 4], store=store, finish=True)
        next(items)
        started.wait(20.0)
        release.set()
        with pytest.raises(KeyboardInterrupt):
            items.throw(KeyboardInterrupt)
    assert store.find(1) is not None
    assert store.find(2) is not None


def test_a_mistake_of_the_work_is_raised():
    with pytest.raises(ZeroDivisionError):
        run(lambda number: {"a": np.array([1 / number])}, [1, 0], workers=2)


def test_a_number_of_workers_that_is_none_is_refused():
    with pytest.raises(UserError, match="-2"):
        run(squares, [1], workers=-2)
    assert count(0) == count(-1) == len(os.sched_getaffinity(0))

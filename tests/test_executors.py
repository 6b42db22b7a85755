"""Executors: a callback is called at once, in the thread that spins; what it raises is raised there."""

from __future__ import annotations

import pytest
from rclpy.task import Future

from tests.node_bench import Bench


@pytest.fixture
def bench(domain: int) -> Bench:
    return Bench(domain)


def test_callbacks_of_one_turn_come_in_their_order_and_none_twice(bench: Bench) -> None:
    calls: list[str] = []
    first = bench.probe.create_guard_condition(lambda: calls.append("first"))
    second = bench.probe.create_guard_condition(lambda: calls.append("second"))
    second.trigger()
    first.trigger()
    bench.until(lambda: len(calls) >= 2)
    for _ in range(3):
        bench.executor.spin_once(timeout_sec=0.01)
    assert calls == ["first", "second"]
    bench.close()


def test_what_a_callback_raises_is_raised_where_the_executor_spins_and_it_goes_on(bench: Bench) -> None:
    calls: list[int] = []

    def fail() -> None:
        calls.append(1)
        raise ZeroDivisionError("once")

    guard = bench.probe.create_guard_condition(fail)
    for _ in range(2):
        guard.trigger()
        with pytest.raises(ZeroDivisionError, match="once"):
            bench.until(lambda: False)
    assert len(calls) == 2
    bench.close()


def test_a_callback_may_be_a_coroutine_but_not_wait(bench: Bench) -> None:
    calls: list[int] = []

    async def soon() -> None:
        calls.append(1)

    async def late() -> None:
        await Future()

    bench.probe.create_guard_condition(soon).trigger()
    bench.until(lambda: calls)
    bench.probe.create_guard_condition(late).trigger()
    with pytest.raises(RuntimeError, match="awaits something"):
        bench.until(lambda: False)
    bench.close()

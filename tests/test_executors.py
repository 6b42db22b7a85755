"""Executors: a callback is called at once, in the thread that spins; what it raises is raised there. So does rclpy's
own, on which the nodes fall back, and the nodes work with it.
"""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path
from threading import Thread

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes import executors
from hybrid_sysid_ros.nodes.executors import Executor
from hybrid_sysid_ros.runtime import node_commands, processes
from hybrid_sysid_ros.support.versions import FALL_BACK, RCLPY_EXECUTOR, WARNED
from tests.manager import ACTIVATE, DEACTIVATE, change, set_parameter, state
from tests.node_bench import Bench, ask


@pytest.fixture(params=[Executor, SingleThreadedExecutor], ids=["ours", "rclpy"])
def bench(domain: int, request: pytest.FixtureRequest) -> Bench:
    return Bench(domain, executor=request.param)


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


@pytest.mark.parametrize("bench", [Executor], indirect=True)
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


def test_what_is_made_while_it_spins_is_called_and_what_is_destroyed_is_gone(bench: Bench) -> None:
    publisher = bench.speak("late", Empty)
    bench.executor.spin_once(timeout_sec=0.0)
    heard: list[Empty] = []
    subscription = bench.probe.create_subscription(Empty, "late", heard.append, 10)
    bench.until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(Empty())
    bench.until(lambda: heard)
    bench.probe.destroy_subscription(subscription)
    bench.until(lambda: publisher.get_subscription_count() == 0)
    other = Node("other", context=bench.context, namespace=bench.namespace)
    calls: list[int] = []
    other.create_guard_condition(lambda: calls.append(1)).trigger()
    bench.executor.add_node(other)
    bench.until(lambda: calls)
    bench.executor.remove_node(other)
    other.destroy_node()
    bench.until(lambda: "other" not in bench.probe.get_node_names())
    bench.close()


def test_what_a_callback_of_the_same_turn_destroys_or_cancels_is_not_called(bench: Bench) -> None:
    calls: list[str] = []

    def end() -> None:
        calls.append("end")
        bench.probe.destroy_guard_condition(later)
        bench.probe.destroy_subscription(subscription)
        tick.cancel()

    publisher = bench.speak("never", Empty)
    end_timer = bench.probe.create_timer(0.3, end)
    tick = bench.probe.create_timer(0.3, lambda: calls.append("tick"))
    subscription = bench.probe.create_subscription(Empty, "never", lambda _: calls.append("message"), 10)
    later = bench.probe.create_guard_condition(lambda: calls.append("guard"))
    bench.until(lambda: publisher.get_subscription_count() == 1)
    end_timer.reset()
    tick.reset()
    while not (end_timer.is_ready() and tick.is_ready()):
        pass  # both are ready before the executor looks
    publisher.publish(Empty())
    later.trigger()
    bench.until(lambda: calls)
    end_timer.cancel()
    for _ in range(5):
        bench.executor.spin_once(timeout_sec=0.02)
    assert calls == ["end"]
    bench.close()


def test_an_answer_calls_back_once_it_is_there(bench: Bench) -> None:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = "here"
        return response

    bench.probe.create_service(Trigger, "ask", answer)
    client = bench.probe.create_client(Trigger, "ask")
    bench.until(client.service_is_ready)
    answers: list[str] = []
    client.call_async(Trigger.Request()).add_done_callback(lambda future: answers.append(future.result().message))
    bench.until(lambda: answers)
    assert answers == ["here"]
    bench.close()


def test_it_can_be_ended_from_another_thread_while_it_waits(bench: Bench) -> None:
    thread = Thread(target=bench.executor.spin, daemon=True)
    thread.start()
    guard_called = Future()
    bench.probe.create_guard_condition(lambda: guard_called.set_result(None)).trigger()
    while not guard_called.done():
        pass
    bench.executor.shutdown()
    thread.join(5.0)
    assert not thread.is_alive()
    bench.close()


def test_a_private_name_that_rclpy_no_longer_has_is_found_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert executors._missing() == []
    monkeypatch.delattr("rclpy.executors.Executor._take_timer")
    monkeypatch.setattr("rclpy.executors.Executor.__init__", lambda self: None)
    assert {"_take_timer", "_tasks_lock"} <= set(executors._missing())


@pytest.mark.parametrize("without", ["", RCLPY_EXECUTOR.name], ids=["ours", "rclpy"])
def test_a_loop_in_one_process_is_served_managed_and_ended(
    domain: int, without: str, model_folder: Path, policy_folder: Path, tmp_path: Path
) -> None:
    network = {"policy_path": str(policy_folder), "policy": "network", "certificate": "ignore"}
    given: dict[str, object] = {"model": str(model_folder), **network}
    nodes: dict[str, dict[str, object]] = {
        "plant": {"seed": 1},
        "estimator": {"model": given["model"]},
        "controller": given,
        "reference": {"kind": "constant"},
    }
    command = node_commands.composed(nodes, tmp_path / "parameters.yaml", rig="cam_beam", namespace="cam_beam")
    environment = {**processes.environment(domain), FALL_BACK: without, WARNED: ""}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    bench = Bench(domain)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        commands = bench.listen("joint_command")
        bench.until(lambda: len(commands) > 20)
        assert ask(bench, Trigger, "controller/hold", Trigger.Request()).success
        assert "choose one of" in set_parameter(bench, "reference", "kind", "walk")
        assert state(bench, "controller") == "active"
        assert change(bench, "controller", DEACTIVATE)
        assert not change(bench, "controller", DEACTIVATE)  # rclpy would end the node
        assert change(bench, "controller", ACTIVATE)
        commands.clear()
        bench.until(lambda: len(commands) > 20)
    finally:
        process.send_signal(signal.SIGINT)
        reported, complaints = process.communicate(timeout=20.0)
        bench.close()
    assert process.returncode == 0
    assert reported.count('"node"') == len(nodes)  # the last diagnostics of each
    assert complaints.count("its own executor is used") == bool(without)
    assert "rror" not in complaints

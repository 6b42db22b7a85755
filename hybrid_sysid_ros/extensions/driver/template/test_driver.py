"""The driver against the simulated board, over a pseudo terminal: pytest test_driver.py."""

from __future__ import annotations

import math
import os
import pty
import select
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

import pytest
import rclpy
from board import Board, commanded
from driver import WATCHDOG, Driver, SerialLine, written
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

HERE = str(Path(__file__).parent)


@pytest.fixture
def board() -> Iterator[Board]:
    made = Board(HERE)
    thread = Thread(target=made.run)
    thread.start()
    yield made
    made.ended.set()
    thread.join()


@pytest.fixture
def loop(board: Board) -> Iterator[tuple[Driver, Callable[[Callable[[], object]], None]]]:
    rclpy.init()
    driver, executor = Driver(HERE, board.port), SingleThreadedExecutor()
    executor.add_node(driver)

    def until(condition: Callable[[], object]) -> None:
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end, "waited in vain"
            executor.spin_once(timeout_sec=0.01)

    yield driver, until
    driver.close()
    executor.shutdown()
    rclpy.shutdown()


def command(driver: Driver, value: float) -> JointState:
    names = [driver.rig.joints.place(item.name)[0] for item in driver.rig.system.inputs]
    return JointState(name=names, effort=[value] * len(names))


def test_readings_come_and_a_command_acts(loop, board):
    driver, until = loop
    heard: list[JointState] = []
    driver.create_subscription(JointState, "joint_states", heard.append, 10)
    until(lambda: len(heard) > 5)
    half = 0.5 * driver.rig.actuators[0].high
    driver.on_command(command(driver, half))
    until(lambda: board.inputs[0] == pytest.approx(half, rel=1e-5))
    until(lambda: any(half == pytest.approx(value, rel=1e-5) for value in heard[-1].effort))


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e12])
def test_a_command_never_leaves_the_limits(loop, board, value):
    driver, until = loop
    driver.on_command(command(driver, value))
    actuator = driver.rig.actuators[0]
    assert actuator.low <= driver.inputs()[0] <= actuator.high


def test_without_commands_the_drive_rests(loop, board):
    driver, until = loop
    driver.on_command(command(driver, driver.rig.actuators[0].high))
    until(lambda: board.inputs[0] > 0.0)
    began = time.monotonic()
    until(lambda: board.inputs == board.rest)
    assert time.monotonic() - began < 3.0 * WATCHDOG


def test_without_a_driver_the_board_rests(loop, board):
    driver, until = loop
    driver.on_command(command(driver, driver.rig.actuators[0].high))
    until(lambda: board.inputs[0] > 0.0)
    driver.close()
    until(lambda: board.inputs == board.rest)


def test_a_board_that_is_gone_is_named_and_ends_the_driver(loop, board):
    driver, until = loop
    until(lambda: board.plant.time > 0.05)
    board.ended.set()
    until(lambda: driver.lost)
    driver.close()


def test_a_board_that_does_not_listen_gets_whole_lines_later(loop):
    """What its port does not take is left out, whole."""
    first, second = pty.openpty()
    tty.setraw(second)
    line = SerialLine(os.ttyname(second))
    for _ in range(5000):
        line.write(written([1.23456]))
    text = b""
    while select.select([first], [], [], 0.0)[0]:
        text += os.read(first, 65536)
    line.write(written([2.0]))
    text += os.read(first, 65536)
    assert {*text.decode().splitlines()} == {"U 1.23456", "U 2"}
    line.close()


@pytest.mark.parametrize("line", [b"", b"U 1.2U 0.5", b"\xff\xfe", b"U", b"U 1 2 3 4 5 6 7 8 9", b"M 1"])
def test_a_board_passes_over_noise(loop, board, line):
    assert len(commanded(line)) != len(board.rest)


def test_lines_that_make_no_sense_are_counted(loop, board):
    driver, until = loop
    until(lambda: board.plant.time > 0.05)
    board.plant.sensed = list
    until(lambda: driver.refused > 0)

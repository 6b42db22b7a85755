"""The live view: what it costs, and whether the loop notices.

The whole loop in real time, without the view, with the view and no page, and with the view and a page in a headless
Chromium, in turns; the view's share of a core, pictures a second, and the delay of the commands. Then set-points from a
page of a running loop: from the moment that the page sends one to the reference that asks for it.
"""

from __future__ import annotations

import argparse
import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.table import Table

from benchmarks import browser, result
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.extensions.view.companion import View
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError

NAME = "live_view"
RATE = 200.0  # Hz
SETTLED = 2.0  # s, of a page before its pictures are counted
SET_POINTS = 100
UNTOUCHED = 12.0  # s, of the reference before the first of them comes, and behind the last


class Page(threading.Thread):
    """A page that is opened as soon as there is an address, and counts its pictures."""

    def __init__(self, seconds: float) -> None:
        super().__init__(daemon=True)
        self.seconds, self.address, self.pictures = seconds, "", 0.0
        self.opened = threading.Event()

    def tell(self, line: str) -> None:
        """Take the address from what a run tells."""
        if line.startswith("live view: "):
            self.address = line.removeprefix("live view: ")
            self.opened.set()

    def run(self) -> None:
        self.opened.wait()
        began = time.monotonic()
        with browser.Browser(self.address) as page:
            page.until("+fps.textContent > 0")
            time.sleep(max(self.seconds - (time.monotonic() - began) - SETTLED, SETTLED))
            self.pictures = float(page.evaluate("+fps.textContent"))


def loop(seconds: float, *, view: bool, page: bool) -> dict[str, Any]:
    """One run of the loop: delays [ms], and what the view says of itself."""
    shown = Page(seconds)
    if page:
        shown.start()
    outcome = Run(
        rate=RATE,
        duration=seconds,
        reference="steps",
        companions=[View(port=0)] if view else [],
        tell=shown.tell,
    ).go()
    if outcome.interrupted:
        raise KeyboardInterrupt
    plant, reported = outcome.diagnostics["plant"], outcome.diagnostics.get("view", {})
    found = {
        "view": view,
        "page": page,
        "delay_ms": {key: plant[f"delay_ms_{key}"] for key in ("p50", "p99", "max")},
        "measurements": plant["measurements"],
        "missed_commands": plant["missed_commands"],
    }
    if view:
        found |= {
            "cpu_share": reported["cpu_share"],
            "memory_mb": reported["memory_mb"],
            "pictures_sent": reported["pictures"],
        }
    if page:
        shown.join()
        found["pictures_hz"] = shown.pictures
    return found


@contextmanager
def heard(domain: int, topic: str) -> Iterator[Any]:
    """When which values came on a topic of references: a list of (time, last value), filled beside."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from trajectory_msgs.msg import JointTrajectory

    from hybrid_sysid_ros.nodes.validation import MessageValidator

    context = rclpy.context.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("witness", context=context)
    found: list[tuple[float, float]] = []

    validator = MessageValidator(JointTrajectory, steady=time.monotonic_ns)

    def note(data: bytes) -> None:
        came, message = time.perf_counter(), validator.unpack(data)  # which takes ROS's own Python some milliseconds
        if message is not None:
            positions, velocities, _ = message.lists
            found.append((came, float((positions or velocities)[0][-1])))

    node.create_subscription(JointTrajectory, topic, note, 10, raw=True)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    ending = threading.Event()

    def spin() -> None:
        while not ending.is_set():
            executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield found
    finally:
        ending.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


def set_points(count: int) -> dict[str, Any]:
    """Delays of set-points [ms], from a page that sends them to a reader of the reference, the loop running."""
    from websockets.sync.client import connect

    rig = rigs.load(rigs.default())
    shown, domain, taken = Page(0.0), int(os.environ.get("ROS_DOMAIN_ID", "0")), []
    trouble: list[BaseException] = []

    def send() -> None:
        try:
            shown.opened.wait()
            address = shown.address.replace("http://", "ws://").replace("/#", "/live?")
            origin: Any = address.replace("ws://", "http://").partition("/live")[0]
            with heard(domain, f"/{rig.namespace}/reference") as found, connect(address, origin=origin) as page:
                page.recv()
                time.sleep(5.0)  # until the rig is let go, and the witness hears it
                for k in range(count):
                    wanted = 0.01 * (k % 50 + 1)
                    began = time.perf_counter()
                    page.send(json.dumps({"do": "set_point", "times": [0.0], "values": [[wanted]]}))
                    end, value = began + 1.0, wanted * rig.display[0].scale
                    while time.perf_counter() < end:
                        times = [at for at, asked in list(found)[-20:] if abs(asked - value) < 1e-9 and at > began]
                        if times:
                            taken.append(1e3 * (times[0] - began))
                            break
                        time.sleep(2e-4)
                    page.recv()
                    time.sleep(0.037)
                page.send('{"do": "experiment", "kind": "constant"}')  # which has an end: a set-point has none
                page.recv()
        except BaseException as error:
            trouble.append(error)

    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    Run(rate=RATE, duration=UNTOUCHED, reference="constant", companions=[View(port=0)], tell=shown.tell).go()
    sender.join(10.0)
    if trouble:
        raise trouble[0]
    return {"sent": count, "arrived": len(taken), "delay_ms": result.percentiles(taken)}


def table(runs: list[dict[str, Any]]) -> Table:
    """A row for each run."""
    shown = Table("view", "page", "delay p50", "p99", "max", "missed", "share of a core", "pictures/s", title=NAME)
    for run in runs:
        delay, missed = run["delay_ms"], f"{run['missed_commands']} of {run['measurements']}"
        shown.add_row(
            *("yes" if run[key] else "" for key in ("view", "page")),
            *(f"{delay[key]:.2f} ms" for key in ("p50", "p99", "max")),
            missed,
            f"{100 * run['cpu_share']:.1f} %" if run["view"] else "",
            f"{run['pictures_hz']:.0f}" if run["page"] else "",
        )
    return shown


def main() -> int:
    """Measure, print the table and write the results."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{NAME}", description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each run")
    parser.add_argument("--turns", type=int, default=3, help="of the three kinds of runs")
    options = parser.parse_args()
    if not browser.found():
        raise UserError("no Chromium: install one, or name it in BROWSER_PATH")
    on, runs = result.machine(), []
    kinds: list[tuple[bool, bool]] = [(False, False), (True, False), (True, True)]
    for _ in range(options.turns):
        runs += [loop(options.seconds, view=view, page=page) for view, page in kinds]
    asked = set_points(SET_POINTS)
    print_table(table(runs))
    delay = asked["delay_ms"]
    print(
        f"{asked['arrived']} of {asked['sent']} set-points became the reference, "
        f"after {delay['p50']:.2f} / {delay['p99']:.2f} / {delay['max']:.2f} ms"
    )
    print(f"written to {result.write(NAME, {'rate_hz': RATE, 'runs': runs, 'set_points': asked}, on=on)}")
    return 0


if __name__ == "__main__":
    result.run(main)

"""Player: publishes the messages of a bag again, as `ros2 bag play` would, without rosbag2."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import partial
from threading import Condition, Thread
from typing import Any

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from hybrid_sysid_ros.bags.bag import Bag, opened
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.base import RigNode, run
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.keys import keys
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from hybrid_sysid_ros.nodes.playhead import Playhead
from hybrid_sysid_ros.support.errors import UserError

DISCOVERY = 1.0  # s, from the opening of the topics to the first message: readers have yet to hear of them
CLOCK_PERIOD = 0.01  # s, between two messages on /clock where nothing is published
PATIENCE = 1.0  # s, after which it looks whether it is over
PAUSE, STEP = b" ", (b"\x1b[C", b"\x1bOC", b".")  # keys: space; the right arrow, as terminals send it, or a dot


class PlayerNode(RigNode):
    """Publishes serialised messages as they lie in the bag, on its topics, with the quality that was offered.

    /clock, if it is asked for, is the time at which messages were logged: never behind that of a message.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("player", **options)
        settings = self.settings
        if not settings["bag"]:
            raise UserError("parameter bag is empty: give the bag to play, as -p bag:=FOLDER")
        self.playhead = Playhead(rate=settings["rate"], paused=settings["pause"])
        self.turn = Condition()
        """Of who plays and who presses keys."""
        self.sent = self.rounds = self.told = 0
        self.trouble: UserError | None = None
        with opened(settings["bag"], recover=settings["recover"]) as bag:
            self.outlets = self.opened(bag, settings["topics"].split())
        self.clock = self.create_publisher(Clock, "/clock", 10) if settings["clock"] else None
        if self.clock is not None:
            self.every(CLOCK_PERIOD, self.tick)
        self.thread = Thread(target=self.play, daemon=True)
        self.thread.start()

    def opened(self, bag: Bag, wanted: Sequence[str]) -> dict[str, Publisher]:
        """Publishers of a bag's topics by name, of those that are wanted and whose type is installed."""
        for name in wanted:
            if name not in bag.topics:
                raise UserError(f"{bag.path}: no topic {name}: the bag has {bag.listing}")
        found = {}
        for name in wanted or bag.topics:
            kind = topics.type_of(bag.topics[name].type)
            if kind is None:
                self.get_logger().error(f"topic {name} is not played: no type {bag.topics[name].type} is installed")
            else:
                found[name] = self.create_publisher(kind, name, topics.profile_of(bag.qualities.get(name, ())))
        if not found:
            raise UserError(f"{bag.path}: no topic to play: the bag has {bag.listing}")
        return found

    def messages(self, bag: Bag) -> Iterator[tuple[str, int, bytes]]:
        """Those to play: topic, when it was logged [ns] and data."""
        begin: int | None = None
        for name, logged, data in bag.messages(self.outlets):
            if begin is None:
                begin = logged + round(self.settings["start"] * SECOND)
                self.told = 0
                self.playhead.go_to(begin)
            if logged >= begin:
                yield name, logged, data

    def play(self) -> None:
        """Play to the end, once or again and again; runs in a thread of its own."""
        try:
            with self.turn:
                self.turn.wait_for(self.finished.done, DISCOVERY)
            with opened(self.settings["bag"], recover=self.settings["recover"]) as bag:
                while not self.finished.done():
                    before = self.sent
                    for name, logged, data in self.messages(bag):
                        if not self.wait(logged):
                            return
                        self.tell(logged)
                        self.outlets[name].publish(data)
                        self.sent += 1
                    self.rounds += 1
                    if not self.settings["loop"] or self.sent == before:
                        break
        except UserError as error:
            self.trouble = error
        finally:
            self.finish()

    def wait(self, logged: int) -> bool:
        """Wait until a message is due that was logged then [ns]; False where it is over before."""
        with self.turn:
            while not self.finished.done():
                seconds = self.playhead.until(logged)
                if seconds <= 0.0:
                    return True
                self.turn.wait(min(seconds, PATIENCE))
        return False

    def tick(self) -> None:
        """Let time go on where nothing is published."""
        if self.sent and not self.playhead.paused:
            self.tell(self.playhead.time)

    def tell(self, time: int) -> None:
        """Say on /clock what time of the bag it is [ns]."""
        if self.clock is None:
            return
        with self.turn:
            if time <= self.told:
                return
            self.told = time
            message = Clock()
            set_nanoseconds(message.clock, time)
            self.clock.publish(message)

    def pause(self) -> None:
        """Rest, or go on."""
        with self.turn:
            self.playhead.pause()
            self.turn.notify_all()

    def step(self) -> None:
        """Publish one message more while it rests."""
        with self.turn:
            self.playhead.step()
            self.turn.notify_all()

    def close(self) -> None:
        """Stop. Raises UserError where the bag was found to be damaged."""
        self.finish()
        with self.turn:
            self.turn.notify_all()
        self.thread.join()
        super().close()
        if self.trouble is not None:
            raise self.trouble
        self.get_logger().info(f"{self.sent} messages played")

    def health(self) -> Sequence[Task]:
        words = "done" if self.finished.done() else "paused" if self.playhead.paused else "playing"
        values = {"messages": self.sent, "rounds": self.rounds, "bag": self.settings["bag"]}
        return [Task(name="player", message=words, values=values)]


def main() -> int:
    """Run the player, with its keys where there is a terminal."""
    made: list[PlayerNode] = []

    def make() -> PlayerNode:
        made.append(PlayerNode())
        return made[0]

    def press(action: str) -> None:
        for node in made:
            getattr(node, action)()

    actions = {PAUSE: partial(press, "pause"), **{key: partial(press, "step") for key in STEP}}
    with keys(actions) as pressed:
        if pressed:
            print("space: pause and go on; right arrow: one message; Ctrl-C: end", file=sys.stderr, flush=True)
        return run(make)


if __name__ == "__main__":
    sys.exit(main())

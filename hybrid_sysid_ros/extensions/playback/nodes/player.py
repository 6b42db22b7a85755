"""Player: publishes the messages of a bag again, as `ros2 bag play` would, without rosbag2."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import partial
from threading import Condition, Thread
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from hybrid_sysid_ros.bags import QualityOfService
from hybrid_sysid_ros.bags.bag import Bag, opened
from hybrid_sysid_ros.extensions.playback.nodes.keys import keys
from hybrid_sysid_ros.extensions.playback.nodes.playback_clock import PlaybackClock
from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.support.errors import UserError

DISCOVERY = 1.0  # s, from the opening of the topics to the first message: readers have yet to hear of them
CLOCK_PERIOD = 0.01  # s, between two messages on /clock where nothing is published
PATIENCE = 1.0  # s, after which it looks whether it is over
ACKNOWLEDGED = 1.0  # s, that readers have to get the last messages
PAUSE, STEP = b" ", (b"\x1b[C", b"\x1bOC", b".")  # keys: space; the right arrow, as terminals send it, or a dot


class PlayerNode(RigNode):
    """Publishes serialised messages as they lie in the bag, on its topics, with the quality that was offered.

    /clock, if it is asked for, is the time at which messages were logged: never behind that of a message.
    """

    NAME = "player"

    def configure(self) -> None:
        path, wanted = self.settings["bag"], self.settings["topics"].split()
        if not path:
            raise UserError("parameter bag is empty: give the bag to play, as -p bag:=FOLDER")
        with opened(path, recover=self.settings["recover"]) as bag:
            for name in wanted:
                if name not in bag.topics:
                    raise UserError(f"{path}: no topic {name}: the bag has {bag.listing}")
            kinds = {name: topics.type_of(bag.topics[name].type) for name in wanted or bag.topics}
            for name in (name for name, kind in kinds.items() if kind is None):
                self.get_logger().error(f"topic {name} is not played: no type {bag.topics[name].type} is installed")
            self.played = {
                name: (kind, _profile_of(bag.qualities.get(name, ())))
                for name, kind in kinds.items()
                if kind is not None
            }
            if not self.played:
                raise UserError(f"{path}: no topic to play: the bag has {bag.listing}")

    def activate(self) -> None:
        settings = self.settings
        self.playback = PlaybackClock(rate=settings["rate"], paused=settings["pause"])
        self.turn = Condition()
        """Of who plays and who presses keys."""
        self.sent = self.rounds = self.announced = 0
        self.trouble: UserError | None = None
        self.ended = False
        self.outlets = {name: self.outlet(name, *offer) for name, offer in self.played.items()}
        self.clock = self.outlet("/clock", Clock, QoSProfile(depth=10)) if settings["clock"] else None
        if self.clock is not None:
            self.every(CLOCK_PERIOD, self.tick)
        self.reader = Thread(target=self.play, daemon=True)
        self.reader.start()

    def outlet(self, topic: str, kind: Any, quality: QoSProfile) -> Publisher:
        """Publisher of any topic, as long as the node is active."""
        self._opened.append(publisher := self.create_publisher(kind, topic, quality))
        return publisher

    def messages(self, bag: Bag) -> Iterator[tuple[str, int, bytes]]:
        """Those to play: topic, when it was logged [ns] and data."""
        begin: int | None = None
        for name, logged, data in bag.messages(self.outlets):
            if begin is None:
                begin = logged + round(self.settings["start"] * SECOND)
                self.announced = 0
                self.playback.go_to(begin)
            if logged >= begin:
                yield name, logged, data

    def play(self) -> None:
        """Play to the end, once or again and again; runs in a thread of its own."""
        try:
            with self.turn:
                self.turn.wait_for(lambda: self.ended, DISCOVERY)
            with opened(self.settings["bag"], recover=self.settings["recover"]) as bag:
                while not self.ended:
                    before = self.sent
                    for name, logged, data in self.messages(bag):
                        if not self.wait(logged):
                            return
                        self.tell_time(logged)
                        self.outlets[name].publish(data)
                        self.sent += 1
                    self.rounds += 1
                    if not self.settings["loop"] or self.sent == before:
                        break
            for outlet in self.outlets.values():
                outlet.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED))
        except UserError as error:
            self.trouble = error
        finally:
            if not self.ended:
                self.finish()

    def wait(self, logged: int) -> bool:
        """Wait until a message is due that was logged then [ns]; False where it is over before."""
        with self.turn:
            while not self.ended:
                seconds = self.playback.until(logged)
                if seconds <= 0.0:
                    return True
                self.turn.wait(min(seconds, PATIENCE))
        return False

    def tick(self) -> None:
        """Let time go on where nothing is published."""
        if self.sent and not self.playback.paused:
            self.tell_time(self.playback.time)

    def tell_time(self, time: int) -> None:
        """Say on /clock what time of the bag it is [ns]."""
        if self.clock is None:
            return
        with self.turn:
            if time <= self.announced:
                return
            self.announced = time
            message = Clock()
            set_nanoseconds(message.clock, time)
            self.clock.publish(message)

    def pause(self) -> None:
        """Rest, or go on."""
        with self.turn:
            self.playback.pause()
            self.turn.notify_all()

    def step(self) -> None:
        """Publish one message more while it rests."""
        with self.turn:
            self.playback.step()
            self.turn.notify_all()

    def deactivate(self) -> None:
        """Stop. Raises UserError where the bag was found to be damaged."""
        with self.turn:
            self.ended = True
            self.turn.notify_all()
        self.reader.join()
        if self.trouble is not None:
            raise self.trouble
        self.get_logger().info(f"{self.sent} messages played")

    def health(self) -> Sequence[Task]:
        words = "done" if self.ended or self.finished.done() else "paused" if self.playback.paused else "playing"
        values = {"messages": self.sent, "rounds": self.rounds, "bag": self.settings["bag"]}
        return [Task(name="player", message=words, values=values)]


def _profile_of(qualities: Sequence[QualityOfService]) -> QoSProfile:
    """A profile to publish a topic again; the default of ROS where its publishers differed or are unknown."""
    chosen = qualities[0] if len(set(qualities)) == 1 else QualityOfService()
    policies = {"reliability": ReliabilityPolicy, "durability": DurabilityPolicy}
    reported = {name: policy.__members__.get(getattr(chosen, name).upper()) for name, policy in policies.items()}
    known = {name: policy for name, policy in reported.items() if policy is not None}
    return QoSProfile(**{"depth": max(chosen.depth, QualityOfService.depth), **known})


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

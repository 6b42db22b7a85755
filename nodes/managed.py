"""Managed: a node whose states a manager may change (https://design.ros2.org/articles/node_lifecycle.html)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future as Answer
from concurrent.futures import TimeoutError as Late
from functools import cached_property, partial
from threading import get_ident
from traceback import format_exception
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleNodeMixin
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.task import Future
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.exchange import Exchange, Outlet
from hybrid_sysid_ros.nodes.subscriptions import Listener, unmatched
from hybrid_sysid_ros.support.errors import UserError

LOOK_PERIOD = 0.02  # s, between two looks whether a peer is there
RCLError = rclpy_implementation.RCLError
LONGEST = 2000  # characters of an error
PATIENCE = 60.0  # s, with a loop that is asked to do something


def _changed(change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    """Answer a manager, also one who asks for what can't be from here: rclpy would end the node."""
    try:
        return change(request, response)
    except RCLError:
        response.success = False
        return response


class ManagedNode(LifecycleNodeMixin, Node):
    """A node that is unconfigured, inactive or active. What it opens while it is active is closed behind that.

    finished: done when the node has nothing more to do.
    """

    def __init__(self, name: str, *, exchange: Exchange | None = None, **options: Any) -> None:
        """exchange: with other nodes of this process. options: of rclpy.node.Node."""
        self.exchange = exchange
        Node.__init__(self, name, **options)
        self.finished = Future()
        self.configured = self.active = False
        self.failure: Exception | None = None
        """Why the last change of state failed."""
        self.thread: int | None = None
        """Of the loop, while one runs."""
        self._handed: deque[tuple[Callable[[], object], Answer[Any]]] = deque()
        self._wake = self.create_guard_condition(self._take_over)
        self._opened: list[Publisher] = []
        self._refused: dict[str, QoSProfile] = {}
        """How topics are offered that somebody asks for otherwise."""
        self._listeners: list[Listener] = []
        self._ticking: list[Timer] = []
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        LifecycleNodeMixin.__init__(self, callback_group=self.slow_group)
        change = next(service for service in self.services if service.srv_type is ChangeState)
        change.callback = partial(_changed, change.callback)
        for service, action in self.own_services().items():
            self._serve(service, action)

    def destroy_node(self) -> None:
        """Destroy all that the middleware has of the node, its states too, which rclpy leaves to the collector."""
        super().destroy_node()
        states = getattr(self, "_state_machine", None)  # a private name: without it they are left to the collector
        if states is not None:
            states.destroy_when_not_in_use()

    def bring_up(self) -> None:
        """Be active at once, without a manager. Raises what stands in the way."""
        for change in (self.trigger_configure, self.trigger_activate):
            if change() != TransitionCallbackReturn.SUCCESS and self.failure is not None:
                raise self.failure

    def configure(self) -> None:
        """Load, compile and check what the parameters name. Raises UserError where that can't be."""

    def activate(self) -> None:
        """Begin to hear, publish and do what the node is for."""

    def wind_down(self) -> None:
        """Leave nothing moving behind before the node is inactive; beside the loop, which goes on meanwhile."""

    def deactivate(self) -> None:
        """Last words of an active node."""

    def cleanup(self) -> None:
        """Forget what configure() has loaded."""

    def in_loop(self, action: Callable[[], object]) -> None:
        """Do something in the loop's thread, between two of its callbacks, and wait for it; here, where none runs.
        Raises what the action raises, and UserError where the loop does not get to it in PATIENCE: then it never does.
        """
        if self.thread in (None, get_ident()):
            action()
            return
        answer: Answer[Any] = Answer()
        self._handed.append((action, answer))
        self._wake.trigger()
        try:
            answer.result(PATIENCE)
        except Late as error:
            if answer.done():  # the action's own
                raise
            late = "got to it, and is still at it" if not answer.cancel() else "did not get to it"
            raise UserError(f"the node's loop {late} after {PATIENCE:g} s: look at what holds it up") from error

    def _take_over(self) -> None:
        while self._handed:
            action, answer = self._handed.popleft()
            if not answer.set_running_or_notify_cancel():
                continue  # nobody waits for it any more
            try:
                answer.set_result(action())
            except Exception as error:
                answer.set_exception(error)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        def configure() -> None:
            self.configure()
            self.configured = True

        return self._attempt(configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        def activate() -> None:
            try:
                self.activate()
                self.active = True
            except BaseException:
                self._shut()
                raise

        return self._attempt(activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.wind_down()
        return self._attempt(self._leave)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._attempt(self._forget)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.active:
            self.wind_down()
        self.finish()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a failure that is no user's: unconfigured again, so that a manager may try once more."""

        def recover() -> None:
            self._leave()
            self._forget()

        failure, found = self.failure, self._attempt(recover)
        self.failure = failure
        return found

    def _attempt(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        """Do what a change of state asks for; a failure is logged, and told in the diagnostics until one goes well."""
        try:
            self.in_loop(action)
        except Exception as error:
            known = isinstance(error, UserError | OSError)
            self.failure = error if isinstance(error, UserError) or not known else UserError(self.words_of(error))
            if self.thread is not None:
                self.get_logger().error(self.words_of(error))
            return TransitionCallbackReturn.FAILURE if known else TransitionCallbackReturn.ERROR
        self.failure = None
        return TransitionCallbackReturn.SUCCESS

    def _leave(self) -> None:
        try:
            if self.active:
                self.deactivate()
        finally:
            self.active = False
            self._shut()

    def _forget(self) -> None:
        self.configured = False
        self.cleanup()

    def _shut(self) -> None:
        """Close what activate() has opened."""
        for listener in self._listeners:
            listener.close()
        for publisher in self._opened:
            if isinstance(publisher, Outlet):
                publisher.close()
                publisher = publisher.publisher
            self._refused.pop(publisher.topic_name, None)
            self.destroy_publisher(publisher)
        for timer in self._ticking:
            self.destroy_timer(timer)
        for closed in (self._listeners, self._opened, self._ticking):
            closed.clear()

    @cached_property
    def service_group(self) -> MutuallyExclusiveCallbackGroup:
        """What goes on in another thread than the loop's: see :class:`executors.Services`."""
        return MutuallyExclusiveCallbackGroup()

    @cached_property
    def slow_group(self) -> MutuallyExclusiveCallbackGroup:
        """What may take long, as parameters and states do where something is loaded and compiled: in a third thread, so
        that a stop does not wait for it.
        """
        return MutuallyExclusiveCallbackGroup()

    def create_service(self, kind: Any, *arguments: Any, **options: Any) -> Any:
        group = self.service_group if kind is Trigger else self.slow_group
        return super().create_service(kind, *arguments, **{"callback_group": group, **options})

    @property
    def state(self) -> str:
        """As a manager calls it."""
        return "active" if self.active else "inactive" if self.configured else "unconfigured"

    def words_of(self, error: Exception) -> str:
        """An error in a line; one that nobody has foreseen is logged with where it comes from."""
        if isinstance(error, UserError):
            return str(error)
        if isinstance(error, OSError):
            return " ".join(str(error).split())[:LONGEST] or type(error).__name__
        self.get_logger().error("".join(format_exception(error)))
        return f"{type(error).__name__}: {error}"[:LONGEST]

    def create_publisher(self, kind: Any, topic: str, quality: QoSProfile, **options: Any) -> Any:
        """Its group is that of what the middleware tells of it: of readers that ask for another quality above all."""
        name = self.resolve_topic_name(topic)
        events = PublisherEventCallbacks(incompatible_qos=lambda event: self._refused.update({name: quality}))
        return super().create_publisher(
            kind, topic, quality, **{"callback_group": self.service_group, "event_callbacks": events, **options}
        )

    def publication(self, topic: str) -> Publisher:
        """Publisher of a topic, for as long as the node is there."""
        quality, overrides = self.quality(topic), topics.OVERRIDES
        return self.create_publisher(topics.TYPES[topic], topic, quality, qos_overriding_options=overrides)

    def unmatched(self) -> list[str]:
        """Peers that ask for another quality of service than this node offers, or offer less than it asks for: nothing
        passes between them and it. A line each.
        """
        heard = [line for listener in list(self._listeners) for line in listener.unmatched()]
        said = [
            line
            for name, quality in list(self._refused.items())
            for line in unmatched(name, quality, self.get_subscriptions_info_by_topic(name))
        ]
        return heard + said

    def quality(self, topic: str) -> QoSProfile:
        """How a topic is offered."""
        return topics.profile(topic)

    def open(self, topic: str) -> Publisher:
        """Publisher of a topic, as long as the node is active."""
        publisher = self.publication(topic)
        self._opened.append(publisher if self.exchange is None else Outlet(publisher, self.exchange))
        return self._opened[-1]

    def subscribe(self, kind: type[Any], topic: str, quality: QoSProfile, callback: Callable[..., None]) -> Listener:
        """Hear serialised messages of a topic, as long as the node is active."""
        self._listeners.append(listener := Listener(self, kind, topic, quality, callback, soon=self.soon))
        return listener

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        """What the node's own services, ~/NAME, do in the loop while it is active."""
        return {}

    def _serve(self, name: str, action: Callable[[], object]) -> None:
        """A service for as long as the node is there: one that goes while it answers would answer nobody."""

        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            if not self.active:
                response.message = f"the node is {self.state}: its part of the loop is at rest"
                return response
            try:
                self.in_loop(action)
                response.success = True
            except Exception as error:
                response.message = self.words_of(error)
            return response

        self.create_service(Trigger, f"~/{name}", answer)

    def every(self, period: float, callback: Callable[[], object]) -> Timer:
        """Timer on the steady clock, as long as the node is active; period [s]."""
        self._ticking.append(timer := self.create_timer(period, callback, clock=self._steady))
        return timer

    def when(self, condition: Callable[[], bool], action: Callable[[], None]) -> None:
        """Do something once, as soon as a condition holds."""

        def look() -> None:
            if condition():
                timer.cancel()
                self.destroy_timer(timer)
                self._ticking.remove(timer)
                action()

        timer = self.every(LOOK_PERIOD, look)

    def soon(self, action: Callable[[], None]) -> None:
        """Do something once, outside of callbacks that it would not suit."""
        self.when(lambda: True, action)

    def finish(self) -> None:
        """End the node; may be called from any thread, and more than once."""
        if not self.finished.done():
            self.finished.set_result(None)
            self._wake.trigger()

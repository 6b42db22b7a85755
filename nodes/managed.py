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

LOOK_PERIOD = 0.02  # s, between two checks whether a peer is there
RCLError = rclpy_implementation.RCLError
LONGEST = 2000  # characters of an error
PATIENCE = 60.0  # s, to wait for an action in the loop


def _changed(change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    """Answer a manager, also a request that is impossible in this state, for which rclpy would end the node."""
    try:
        return change(request, response)
    except RCLError:
        response.success = False
        return response


class ManagedNode(LifecycleNodeMixin, Node):
    """A node that is unconfigured, inactive or active. Whatever it opens while it is active is closed afterwards.

    finished: a future that is done when the node has finished.
    """

    def __init__(self, name: str, *, exchange: Exchange | None = None, **options: Any) -> None:
        """exchange: messages with other nodes of this process. options: those of rclpy.node.Node."""
        self.exchange = exchange
        Node.__init__(self, name, **options)
        self.finished = Future()
        self.configured = self.active = False
        self.failure: Exception | None = None
        """Why the last change of state failed."""
        self.thread: int | None = None
        """Identifier of the loop's thread, while it runs."""
        self._handed: deque[tuple[Callable[[], object], Answer[Any]]] = deque()
        self._wake = self.create_guard_condition(self._take_over)
        self._opened: list[Publisher] = []
        self._refused: dict[str, QoSProfile] = {}
        """Quality of service of topics that a peer requests otherwise."""
        self._listeners: list[Listener] = []
        self._ticking: list[Timer] = []
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        LifecycleNodeMixin.__init__(self, callback_group=self.slow_group)
        change = next(service for service in self.services if service.srv_type is ChangeState)
        change.callback = partial(_changed, change.callback)
        for service, action in self.own_services().items():
            self._serve(service, action)

    def destroy_node(self) -> None:
        """Destroy the node and its state machine, which rclpy leaves to the garbage collector."""
        super().destroy_node()
        states = getattr(self, "_state_machine", None)  # a private name: without it they are left to the collector
        if states is not None:
            states.destroy_when_not_in_use()

    def bring_up(self) -> None:
        """Become active at once, without a manager. Raises the error that prevents it."""
        for change in (self.trigger_configure, self.trigger_activate):
            if change() != TransitionCallbackReturn.SUCCESS and self.failure is not None:
                raise self.failure

    def configure(self) -> None:
        """Load, compile and check what the parameters name. Raises UserError where that is not possible."""

    def activate(self) -> None:
        """Begin to subscribe, to publish and to work."""

    def wind_down(self) -> None:
        """Bring everything to rest before the node becomes inactive; called beside the loop, which runs on."""

    def deactivate(self) -> None:
        """Finish the work of an active node."""

    def cleanup(self) -> None:
        """Release what configure() has loaded."""

    def in_loop(self, action: Callable[[], object]) -> None:
        """Run an action in the loop's thread, between two callbacks, and wait for it; without a loop run it here.
        Raises errors of the action, and UserError where the loop does not begin it within PATIENCE; then it is
        cancelled.
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
            if answer.done():  # an error of the action
                raise
            late = "got to it, and is still at it" if not answer.cancel() else "did not get to it"
            raise UserError(f"the node's loop {late} after {PATIENCE:g} s: look at what holds it up") from error

    def _take_over(self) -> None:
        while self._handed:
            action, answer = self._handed.popleft()
            if not answer.set_running_or_notify_cancel():
                continue  # it was cancelled
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
        """After an unexpected failure become unconfigured again, so that a manager may try again."""

        def recover() -> None:
            self._leave()
            self._forget()

        failure, found = self.failure, self._attempt(recover)
        self.failure = failure
        return found

    def _attempt(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        """Run the action of a change of state; a failure is logged, and stays in the diagnostics until one succeeds."""
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
        """Close everything that activate() has opened."""
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
        """Callback group that runs in another thread than the loop's, see :class:`executors.Services`."""
        return MutuallyExclusiveCallbackGroup()

    @cached_property
    def slow_group(self) -> MutuallyExclusiveCallbackGroup:
        """Callback group of slow callbacks, such as changes of parameters and states that load and compile. It runs in
        a third thread, so that a stop does not wait for it.
        """
        return MutuallyExclusiveCallbackGroup()

    def create_service(self, kind: Any, *arguments: Any, **options: Any) -> Any:
        group = self.service_group if kind is Trigger else self.slow_group
        return super().create_service(kind, *arguments, **{"callback_group": group, **options})

    @property
    def state(self) -> str:
        """Name of the state, as a manager uses it."""
        return "active" if self.active else "inactive" if self.configured else "unconfigured"

    def words_of(self, error: Exception) -> str:
        """An error in a line; an unexpected one is logged with its traceback."""
        if isinstance(error, UserError):
            return str(error)
        if isinstance(error, OSError):
            return " ".join(str(error).split())[:LONGEST] or type(error).__name__
        self.get_logger().error("".join(format_exception(error)))
        return f"{type(error).__name__}: {error}"[:LONGEST]

    def create_publisher(self, kind: Any, topic: str, quality: QoSProfile, **options: Any) -> Any:
        """Create a publisher; its callback group handles its events, such as subscribers with another quality."""
        name = self.resolve_topic_name(topic)
        events = PublisherEventCallbacks(incompatible_qos=lambda event: self._refused.update({name: quality}))
        return super().create_publisher(
            kind, topic, quality, **{"callback_group": self.service_group, "event_callbacks": events, **options}
        )

    def publication(self, topic: str) -> Publisher:
        """Publisher of a topic that lives as long as the node."""
        quality, overrides = self.quality(topic), topics.OVERRIDES
        return self.create_publisher(topics.TYPES[topic], topic, quality, qos_overriding_options=overrides)

    def unmatched(self) -> list[str]:
        """A line for each peer that requests another quality of service than this node offers, or offers less than it
        requests, so that no messages pass between them.
        """
        heard = [line for listener in list(self._listeners) for line in listener.unmatched()]
        said = [
            line
            for name, quality in list(self._refused.items())
            for line in unmatched(name, quality, self.get_subscriptions_info_by_topic(name))
        ]
        return heard + said

    def quality(self, topic: str) -> QoSProfile:
        """Quality of service of a topic."""
        return topics.profile(topic)

    def open(self, topic: str) -> Publisher:
        """Publisher of a topic that lives as long as the node is active."""
        publisher = self.publication(topic)
        self._opened.append(publisher if self.exchange is None else Outlet(publisher, self.exchange))
        return self._opened[-1]

    def subscribe(self, kind: type[Any], topic: str, quality: QoSProfile, callback: Callable[..., None]) -> Listener:
        """Subscribe to serialised messages of a topic, as long as the node is active."""
        self._listeners.append(listener := Listener(self, kind, topic, quality, callback, soon=self.soon))
        return listener

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        """Actions of the node's own services, ~/NAME, which run in the loop while it is active."""
        return {}

    def _serve(self, name: str, action: Callable[[], object]) -> None:
        """Create a service that lives as long as the node; one that is destroyed in a call would never answer."""

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
        """Timer on the steady clock that runs as long as the node is active; period [s]."""
        self._ticking.append(timer := self.create_timer(period, callback, clock=self._steady))
        return timer

    def when(self, condition: Callable[[], bool], action: Callable[[], None]) -> None:
        """Run an action once, as soon as a condition holds."""

        def look() -> None:
            if condition():
                timer.cancel()
                self.destroy_timer(timer)
                self._ticking.remove(timer)
                action()

        timer = self.every(LOOK_PERIOD, look)

    def soon(self, action: Callable[[], None]) -> None:
        """Run an action once, outside the current callback."""
        self.when(lambda: True, action)

    def finish(self) -> None:
        """End the node; may be called from any thread, and more than once."""
        if not self.finished.done():
            self.finished.set_result(None)
            self._wake.trigger()

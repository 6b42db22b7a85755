"""Process: nodes run in one loop, with other threads for slow callbacks, and end cleanly."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import signal
import socket
import sys
import warnings
from collections.abc import Callable, Sequence
from threading import Thread, get_ident
from typing import TYPE_CHECKING

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions

from hybrid_sysid_ros.nodes import middleware
from hybrid_sysid_ros.nodes.executors import EventLoop, Services, ended
from hybrid_sysid_ros.support import interruption
from hybrid_sysid_ros.support.errors import UserError

if TYPE_CHECKING:
    from hybrid_sysid_ros.nodes.base import RigNode

SWITCH_INTERVAL = 2e-4  # s, for which another thread may delay the loop
PATIENCE = 2.0  # s, until an interrupt cuts a node's start
LAST_PATIENCE = 10.0  # s, to wait for threads at the end
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4  # of mlockall, on Linux


def announce(word: str) -> None:
    """Print a word for the process that started this one, in a line on the standard output."""
    print(word, flush=True)


def run(make: Callable[[], RigNode | Sequence[RigNode]], *, together: bool = False) -> int:
    """Run a node, or several in one loop, until one is finished or a signal ends it; return the exit status.

    together: messages between the nodes use an exchange and not the middleware.

    0: it ended without an error; 2: a parameter, file or argument is wrong, reported in one line.
    """
    ending = Interruption()
    sys.setswitchinterval(SWITCH_INTERVAL)
    # A client that went while it was answered, or asks again: nothing that a user could mend.
    warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
    gc.freeze()  # imported objects stay, so no collection examines them again
    if os.environ.get(interruption.TETHER):
        Thread(target=_end_with_starter, daemon=True).start()
    try:
        middleware.prepare_middleware(together=together)
        try:
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # rclpy's error for wrong arguments and parameter files
            raise UserError(" ".join(str(error).split())) from error
        try:
            made = make()
        except rclpy_implementation.RCLError as error:  # a keystore is missing, or the middleware has no security
            raise UserError(f"ROS cannot make the node: {' '.join(str(error).split())}") from error
        _serve(made if isinstance(made, Sequence) else [made], ending)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return 2
    except KeyboardInterrupt:
        return 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        rclpy.try_shutdown()
    return 0


def _end_with_starter() -> None:
    """End when the standard input closes, since then the process that started this one has ended."""
    while os.read(0, 1024):  # not through sys.stdin, whose lock a thread may hold when Python ends
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _serve(nodes: Sequence[RigNode], ending: Interruption) -> None:
    services = [
        Services(nodes, [node.service_group for node in nodes]),
        Services(nodes, [node.slow_group for node in nodes]),
    ]
    executor = EventLoop(nodes, services)
    servers = [Thread(target=item.serve, daemon=True) for item in services]
    for node in nodes:
        node.thread = get_ident()
        Thread(target=node.watch_sources, daemon=True).start()
    for server in servers:
        server.start()
    _prioritise(nodes)
    gc.collect()
    gc.freeze()  # existing objects stay, so collections examine only objects of the loop
    ending.then(nodes[0].finish)
    announce("ready")
    try:
        # Not spin_until_future_complete: its future keeps a function of every turn, 260 bytes each.
        while executor.context.ok() and not ended(nodes):
            executor.turn()
    finally:
        try:
            for node in nodes:
                node.thread = None
            _close(nodes)
        finally:  # a remaining thread would end the process by SIGABRT
            for node in nodes:
                node.finish()
            for server, item in zip(servers, services, strict=True):
                server.join(LAST_PATIENCE)  # a thread that compiles may take longer
                if not server.is_alive():
                    item.shutdown()
            executor.shutdown()
            for node in nodes:
                node.destroy_node()


def _close(nodes: Sequence[RigNode]) -> None:
    """Close all nodes, even if one of them fails. Raises the first UserError."""
    troubles: list[UserError] = []
    for node in nodes:
        try:
            node.close()
        except UserError as error:
            troubles.append(error)
    if troubles:
        raise troubles[0]


def _prioritise(nodes: Sequence[RigNode]) -> None:
    """Give all threads of this process real-time priority and keep its pages in memory, if a node has a priority and
    the system permits it.
    """
    priority = max(node.settings["priority"] for node in nodes)
    if not priority:
        return
    logger = nodes[0].get_logger()
    try:
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:  # not permitted, or no Linux
        logger.warning(f"no real-time priority ({error}): the limit for the user is `ulimit -r`")
    try:
        _keep_in_memory()
    except (OSError, AttributeError) as error:
        logger.warning(f"memory may be paged out ({error}): the limit for the user is `ulimit -l`")


def _keep_in_memory() -> None:
    """Keep every page of this process in memory after its first use. Otherwise the system may evict idle pages, and the
    loop would wait while code that runs twice a second is read from the disk again. Raises OSError where that is not
    permitted.
    """
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def peak_memory() -> float:
    """Largest resident memory of this process so far [MB]. The kernel counts it in 1024 bytes."""
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            # Not ru_maxrss, which a process inherits from its parent.
            return next(float(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1.024e-3
    except (OSError, StopIteration):  # no Linux
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1e-6 if sys.platform == "darwin" else 1.024e-3)


class Interruption:
    """Signals that end a process: the first one calls an action, as soon as there is one.

    A long start, such as one that compiles, ends by KeyboardInterrupt after PATIENCE. A short one is not cut, since a
    recorder has a bag and a thread to close.

    Python runs its handlers between two of its instructions, which may be long after the signal if a thread waits in
    the middleware. So the signals' numbers also come through a socket, to a thread that waits for them.
    """

    def __init__(self) -> None:
        self._noted = False
        self._ours, self._theirs = socket.socketpair()
        self._theirs.setblocking(False)
        signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        for number in interruption.ending():
            signal.signal(number, self._note)
        interruption.repeat_unheard()

    def then(self, action: Callable[[], object]) -> None:
        """Call `action` from another thread at the first signal, or now if it came before; later signals do nothing."""

        def wait() -> None:
            self._ours.recv(1)
            action()

        self._noted = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        Thread(target=wait, daemon=True).start()

    def _note(self, number: int, frame: object) -> None:
        if not self._noted:
            self._noted = True
            signal.setitimer(signal.ITIMER_REAL, PATIENCE)

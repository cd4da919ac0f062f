# Copyright 2026 The hapticvision_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
How every node of the cell starts, runs, fails and stops.

One thread runs the callbacks (a multi-threaded executor loses almost all samples at 1 kHz), the
node's own threads serve its device, and whatever ends the process lets go of the device first.
"""

from collections.abc import Callable, MutableMapping, Sequence
import inspect
import os
import signal
import sys
import threading
import time
from typing import Any, Final

from hapticvision_ros.core.errors import HapticVisionError, UsageError
from hapticvision_ros.nodes.parameters import Parameters, ParameterSpec
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle.node import LifecycleNodeMixin
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

STOP_POLL: Final = 0.1
"""Longest time between a signal and the begin of the shutdown [s]."""

THREAD_JOIN_TIMEOUT: Final = 5.0
"""Longest time that a node's thread may take to see that the node stops [s]."""

LAST_WORDS: Final = 3.0
"""Longest time that a node that stops waits for those who listen to it [s]."""


_DISCOVERY: Final = (
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_STATIC_PEERS',
    # Of older distributions; where it is set it goes before the first.
    'ROS_LOCALHOST_ONLY',
)


class CellNode(Node):  # type: ignore[misc]
    """
    A node of the cell: parameters from its table, threads that end with it, one way to fail.

    Parameters
    ----------
    name : str
        The node's name, also of its file in ``config/``.
    table : sequence of ParameterSpec
        Its parameters.

    Attributes
    ----------
    parameters : Parameters
        The declared parameters.
    stopping : threading.Event
        Set when the node is to end; the node's threads watch it.
    failure : BaseException or None
        Why the node cannot go on.

    Raises
    ------
    InputError, UsageError
        If the parameters do not fit the table.

    """

    def __init__(self, name: str, table: Sequence[ParameterSpec]) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.parameters = Parameters(self, name, table)
        self.stopping = threading.Event()
        self.failure: BaseException | None = None
        self._threads: list[threading.Thread] = []
        # The first line that is logged looks through all modules for its caller, a tenth of a
        # second on a busy machine: not in the middle of a push, from a thread that reads a sensor.
        inspect.getframeinfo(sys._getframe())

    def spawn(self, target: Callable[[], None], name: str) -> threading.Thread:
        """Run `target` in a thread of this node; what it raises ends the node."""

        def guarded() -> None:
            try:
                target()
            # Whatever a thread raises must end the process: a dead thread is silent.
            except BaseException as error:
                self.fail(error)

        thread = threading.Thread(target=guarded, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def fail(self, error: BaseException) -> None:
        """End the node because of `error`; safe to call from any thread."""
        if self.failure is None:
            self.failure = error
        self.stopping.set()

    def close(self) -> None:
        """
        Stop the node's threads; ROS still runs, and so does `executor`.

        A node that owns a device extends this: first this, then the device's own ``close``.
        """
        self.stopping.set()
        for thread in self._threads:
            thread.join(THREAD_JOIN_TIMEOUT)


class ManagedCellNode(LifecycleNodeMixin, CellNode):  # type: ignore[misc]
    """A node of the cell with the states of a managed node: unconfigured, inactive, active."""

    def __init__(self, name: str, table: Sequence[ParameterSpec]) -> None:
        CellNode.__init__(self, name, table)
        LifecycleNodeMixin.__init__(self)


def deliver(node: Node) -> None:
    """
    Wait until all that a node has published is with those who listen reliably.

    To be called before the node is destroyed. That a publisher has gone is told over another
    channel than what it has published: a listener that is just held up may hear of it first, and
    then drops the rest.

    Parameters
    ----------
    node : rclpy.node.Node
        The node; it waits for `LAST_WORDS` at most.

    """
    end = time.monotonic() + LAST_WORDS
    for publisher in node.publishers:
        left = max(0.0, end - time.monotonic())
        publisher.wait_for_all_acked(Duration(seconds=left))


def run(factory: Callable[[], CellNode], args: Sequence[str] | None = None) -> int:
    """
    Run one node until it is told to stop, and return the process's exit code.

    Parameters
    ----------
    factory : callable
        Makes the node.
    args : sequence of str, optional
        Arguments of the process; those of `sys.argv` if not given.

    Returns
    -------
    int
        0 after SIGINT or SIGTERM; 2 after an error that the user can do something about, with
        one sentence on standard error.

    """
    interrupted = threading.Event()

    def interrupt(number: int, frame: Any) -> None:
        interrupted.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    try:
        # ROS's own handlers would end the communication before a node can say its last words.
        initialise(args)
        _spin(factory, interrupted)
    except HapticVisionError as error:
        print(f'error: {error}', file=sys.stderr)
        return error.exit_code
    finally:
        rclpy.try_shutdown()
    return 0


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> None:
    """
    Let ROS discover on this machine only, unless the user has said how it discovers.

    ROS by itself discovers the whole subnet, where anyone could then talk to the arm.

    Parameters
    ----------
    environment : mutable mapping of str to str, optional
        That of the process if not given. It is read when ROS starts.

    """
    if not any(environment.get(name) for name in _DISCOVERY):
        environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'


def initialise(args: Sequence[str] | None = None) -> None:
    """
    Start ROS in the process, which keeps its own signal handlers.

    Without a word of the user's it discovers on this machine only.

    Parameters
    ----------
    args : sequence of str, optional
        Arguments of the process; those of `sys.argv` if not given.

    Raises
    ------
    UsageError
        If ROS does not accept them.

    """
    stay_on_this_machine()
    # The exceptions of the binding have no public name; all of them are RuntimeErrors.
    try:
        rclpy.init(
            args=None if args is None else list(args),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise UsageError(f'ROS does not accept the arguments: {reason}') from error


def _wake() -> None:
    """Let the executor return, so that a signal is seen."""


def _spin(factory: Callable[[], CellNode], interrupted: threading.Event) -> None:
    node = factory()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    # One timer that wakes the executor costs less than a timeout, which makes a new one each time.
    node.create_timer(STOP_POLL, _wake, clock=Clock(clock_type=ClockType.STEADY_TIME))
    try:
        while not interrupted.is_set() and not node.stopping.is_set():
            executor.spin_once()
    finally:
        node.close()
        deliver(node)
        executor.shutdown()
        node.destroy_node()
    # Where everything is stopped at once, the device may go first: that is no failure.
    if node.failure is not None and not interrupted.is_set():
        raise node.failure

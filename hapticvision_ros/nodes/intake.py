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
Streams that are taken in batches: what a node needs that only stores its samples.

An executor wakes and builds its wait set anew for each message, which costs several times what
the message itself does. A node that acts on a trial rather than on a sample lets its messages
wait in the middleware's queue, and takes all of them at each tick of its timer; one that needs
each sample at once gives the stream a thread of its own, which waits for nothing else.
"""

from collections.abc import Iterator
import time
from typing import Any, Final, Self

from hapticvision_ros.bag.contract import POINTS, Topic
from hapticvision_ros.nodes.conversions import NS_PER_S
from hapticvision_ros.nodes.qos import interface_class, relative_name, subscription_profile
from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSReliabilityPolicy

SCALAR_DEPTH: Final = 20000
"""
Queue length of all but clouds: a replay may be many times faster than the cell, and its listeners
may be held up for seconds. What is not used takes no memory.
"""


class _Parked(CallbackGroup):  # type: ignore[misc]
    """A group whose members the executor never waits for."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return


class Intake:
    """
    A subscription that is emptied by its owner.

    Parameters
    ----------
    node : rclpy.node.Node
        Its owner.
    kind : type
        Class of the messages.
    name : str
        Topic; in the node's namespace unless it begins with a slash.
    profile : rclpy.qos.QoSProfile
        Quality of service to ask for.
    raw : bool
        Whether to hand over serialized bytes.

    """

    def __init__(self, node: Any, kind: Any, name: str, profile: Any, *, raw: bool) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            kind, name, _never, profile, callback_group=_Parked(), raw=raw
        )
        # One subscription and nothing else, as in rclpy's own `wait_for_message`.
        self._wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)

    @classmethod
    def of(cls, node: Any, topic: Topic, *, raw: bool = False, reliable: bool = False) -> Self:
        """Return the intake of a contract topic, in the node's namespace."""
        profile = subscription_profile(topic.qos)
        if reliable:
            profile.reliability = QoSReliabilityPolicy.RELIABLE
        if topic is not POINTS:
            profile.depth = max(profile.depth, SCALAR_DEPTH)
        kind = interface_class(topic.msgtype)
        return cls(node, kind, relative_name(topic.name), profile, raw=raw)

    def close(self) -> None:
        """Listen no longer; no thread may wait for it any more."""
        self._node.destroy_subscription(self._subscription)

    @property
    def matched(self) -> bool:
        """Return whether some publisher is heard."""
        return bool(self._subscription.get_publisher_count())

    def wait(self, timeout: float) -> bool:
        """
        Wait for the next message; for one thread at a time.

        Parameters
        ----------
        timeout : float
            Longest wait [s].

        Returns
        -------
        bool
            Whether there is something to take.

        """
        wait_set = self._wait_set
        handle = self._subscription.handle
        with handle:
            wait_set.clear_entities()
            wait_set.add_subscription(handle)
            wait_set.wait(round(timeout * NS_PER_S))
            return bool(wait_set.get_ready_entities('subscription'))

    def take(self) -> Iterator[tuple[Any, int, int]]:
        """
        Yield what has come since the last call.

        Yields
        ------
        message : object
            The message, or its bytes.
        sent_ns : int
            When it was sent, by the sender's clock [ns since the epoch].
        received_ns : int
            When it arrived [ns since the epoch].

        """
        subscription = self._subscription
        handle, kind, raw = subscription.handle, subscription.msg_type, subscription.raw
        with handle:
            while (taken := handle.take_message(kind, raw)) is not None:
                message, info = taken
                # Some middlewares leave the latter at zero.
                received_ns = info['received_timestamp'] or time.time_ns()
                yield message, info['source_timestamp'], received_ns


def _never(message: Any) -> None:
    raise AssertionError('a parked subscription was executed')

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
When a message without a stamp was measured: its sender's time, also in a replay.

In a live cell the middleware's source timestamp is that time. In a replay it is the time of the
replay, and only ``/clock`` ties the two together: its messages bear the bag's time and a source
timestamp of the same sender.
"""

from array import array
from typing import Any, Final

from hapticvision_ros.nodes.conversions import ns_from_stamp
from hapticvision_ros.nodes.intake import Intake
import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rosgraph_msgs.msg import Clock

type Nanoseconds = NDArray[np.int64]

OWN_TICK_NS: Final = 200_000
"""A tick that was sent no longer than this before a message was sent for it [ns]."""
CLOCK_DEPTH: Final = 2000
MOST_TICKS: Final = 4_000_000
"""Ticks that are kept at most: 64 MB."""


def replayed_times(sent: Nanoseconds, tick_sent: Nanoseconds, tick: Nanoseconds) -> Nanoseconds:
    """
    Return the bag times of messages from when they were sent in the replay.

    A player that sends a tick right before each message (``ros2 bag play --clock-topics-all``,
    and this package's own) tells the times exactly: where most messages have a tick of their own,
    each gets the last tick before it. Otherwise the ticks come at a rate of their own
    (``ros2 bag play --clock``), and the times are interpolated between them.

    Parameters
    ----------
    sent : ndarray of int64, shape (n,)
        Source timestamps of the messages [ns].
    tick_sent : ndarray of int64, shape (m,)
        Source timestamps of the ticks [ns], increasing, m >= 1.
    tick : ndarray of int64, shape (m,)
        The ticks: bag times [ns].

    Returns
    -------
    ndarray of int64, shape (n,)
        Bag times [ns].

    """
    before = np.searchsorted(tick_sent, sent, side='right') - 1
    own = (before >= 0) & (sent - tick_sent[np.maximum(before, 0)] <= OWN_TICK_NS)
    if 2 * np.count_nonzero(own) > sent.size:
        snapped: Nanoseconds = tick[np.maximum(before, 0)]
        return snapped
    # Relative to the first tick: a double holds an epoch in nanoseconds to 256 ns only.
    x = (tick_sent - tick_sent[0]).astype(np.float64)
    y = (tick - tick[0]).astype(np.float64)
    at = (sent - tick_sent[0]).astype(np.float64)
    inside = np.interp(at, x, y)
    rate = (y[-1] - y[0]) / (x[-1] - x[0]) if x.size > 1 and x[-1] > x[0] else 1.0
    outside = np.where(at < 0.0, at, np.maximum(at - x[-1], 0.0)) * rate
    interpolated: Nanoseconds = tick[0] + np.rint(inside + outside).astype(np.int64)
    return interpolated


class MessageClock:
    """
    Tells when messages were measured from when they were sent.

    Parameters
    ----------
    node : rclpy.node.Node
        Its owner; the node's ``use_sim_time`` decides whether this is a replay.

    """

    def __init__(self, node: Any) -> None:
        self.replay = bool(node.get_parameter('use_sim_time').value)
        self._sent = array('q')
        self._tick = array('q')
        if self.replay:
            profile = QoSProfile(depth=CLOCK_DEPTH, reliability=QoSReliabilityPolicy.BEST_EFFORT)
            self._intake = Intake(node, Clock, '/clock', profile, raw=False)

    def update(self) -> None:
        """Take the ticks that have come."""
        if self.replay:
            for message, sent_ns, _ in self._intake.take():
                self._sent.append(sent_ns)
                self._tick.append(ns_from_stamp(message.clock))
            if len(self._sent) > MOST_TICKS:
                self.forget(MOST_TICKS // 2)

    def forget(self, keep: int) -> None:
        """Forget all ticks but the last `keep`."""
        del self._sent[:-keep]
        del self._tick[:-keep]

    def times(self, sent: Nanoseconds) -> Nanoseconds:
        """
        Return when messages were measured [ns since the epoch], given when they were sent.

        Without a tick a replay's messages cannot be placed, and none is returned.
        """
        if not self.replay:
            return sent
        if not self._tick:
            return sent[:0]
        return replayed_times(
            sent, np.array(self._sent, dtype=np.int64), np.array(self._tick, dtype=np.int64)
        )

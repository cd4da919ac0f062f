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
from hapticvision_ros.nodes.parameters import ParameterSpec
import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rosgraph_msgs.msg import Clock

type Nanoseconds = NDArray[np.int64]

EXACT_REPLAY: Final = ParameterSpec(
    'exact_replay',
    'bool',
    '-',
    'With use_sim_time: whether a tick of /clock is sent right before each message and nothing '
    'may be lost, as in "hapticvision replay" and "ros2 bag play --clock-topics-all".',
    read_only=True,
)
"""The parameter that a node with a `MessageClock` declares."""
CLOCK: Final = '/clock'
CLOCK_DEPTH: Final = 20000
MOST_TICKS: Final = 4_000_000
"""Ticks that are kept at most: 64 MB."""


def last_ticks(sent: Nanoseconds, tick_sent: Nanoseconds, tick: Nanoseconds) -> Nanoseconds:
    """
    Return the bag times of messages each of which has a tick of its own right before it.

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
        Bag times [ns]: exact, whatever the pace of the player.

    """
    before = np.searchsorted(tick_sent, sent, side='right') - 1
    last: Nanoseconds = tick[np.maximum(before, 0)]
    return last


def between_ticks(sent: Nanoseconds, tick_sent: Nanoseconds, tick: Nanoseconds) -> Nanoseconds:
    """
    Return the bag times of messages between ticks that come at a rate of their own.

    Parameters
    ----------
    sent, tick_sent, tick : ndarray of int64
        As for `last_ticks`.

    Returns
    -------
    ndarray of int64, shape (n,)
        Bag times [ns], interpolated: as exact as the pace of the player.

    """
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
        Its owner, which has declared `EXACT_REPLAY`; its ``use_sim_time`` decides whether
        this is a replay.

    """

    def __init__(self, node: Any) -> None:
        self.replay = bool(node.get_parameter('use_sim_time').value)
        self.exact = self.replay and bool(node.get_parameter(EXACT_REPLAY.name).value)
        self._times_of = last_ticks if self.exact else between_ticks
        self._sent = array('q')
        self._tick = array('q')
        # Of a player that sends reliably nothing is lost; any other is heard with best effort.
        reliabilities = [QoSReliabilityPolicy.RELIABLE] if self.exact else []
        reliabilities += [QoSReliabilityPolicy.BEST_EFFORT] if self.replay else []
        self._intakes = [
            Intake(node, Clock, CLOCK, QoSProfile(depth=CLOCK_DEPTH, reliability=item), raw=False)
            for item in reliabilities
        ]
        self._heard: Intake | None = None

    @property
    def matched(self) -> bool:
        """Return whether someone tells the time of the replay, if this is one."""
        return any(intake.matched for intake in self._intakes)

    def update(self) -> None:
        """Take the ticks that have come."""
        if self.replay:
            self._heard = next((item for item in self._intakes if item.matched), self._heard)
            for intake in self._intakes:
                for message, sent_ns, _ in intake.take():
                    # The one may bring again what the other has brought before it was matched.
                    if intake is self._heard and (not self._sent or sent_ns > self._sent[-1]):
                        self._sent.append(sent_ns)
                        self._tick.append(ns_from_stamp(message.clock))
            if len(self._sent) > MOST_TICKS:
                self.forget(MOST_TICKS // 2)

    def forget(self, keep: int) -> None:
        """Forget all ticks but the last `keep`."""
        stop = max(0, len(self._sent) - keep)
        del self._sent[:stop]
        del self._tick[:stop]

    def times(self, sent: Nanoseconds) -> Nanoseconds:
        """
        Return when messages were measured [ns since the epoch], given when they were sent.

        Without a tick a replay's messages cannot be placed, and none is returned.
        """
        if not self.replay:
            return sent
        if not self._tick:
            return sent[:0]
        return self._times_of(
            sent, np.array(self._sent, dtype=np.int64), np.array(self._tick, dtype=np.int64)
        )

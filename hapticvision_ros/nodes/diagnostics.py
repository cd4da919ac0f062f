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
What a node says of itself on ``/diagnostics``, for rqt_robot_monitor, Foxglove and other nodes.

A node adds one check for each thing that can go wrong; once in a period, or when the node asks for
it, all of its findings are sent together.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
import time
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile

DIAGNOSTICS: Final = '/diagnostics'
"""One topic for all cells of a network; a status tells by its name whose node it is from."""

PERIOD: Final = 1.0
"""Time between two messages [s]; rqt_robot_monitor calls a status stale after five."""

SILENCE: Final = 4.0 * PERIOD
"""A node that has not told of itself for so long has died, or hangs [s]."""

_DEPTH: Final = 10


class Level(IntEnum):
    """How bad it is, in the numbers of ``diagnostic_msgs/msg/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Finding:
    """
    What a check has found.

    Parameters
    ----------
    level : Level
        How bad it is.
    message : str
        One sentence for people.
    values : mapping of str to object
        What it was found from, with units in the names; sent as text.

    """

    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


type Check = Callable[[], Finding]


class Diagnostics:
    """
    The findings of one node, sent on ``/diagnostics``.

    Parameters
    ----------
    node : rclpy.node.Node
        The node; its executor runs the checks, which therefore must not wait.
    hardware_id : str
        Which device it is about, where there is one.
    period : float
        Time between two messages [s], by the steady clock: also while the ROS time stands still.

    """

    def __init__(self, node: Any, hardware_id: str = '', *, period: float = PERIOD) -> None:
        self._node = node
        self._hardware_id = hardware_id
        self._checks: list[tuple[str, Check]] = []
        self._publisher = node.create_publisher(
            DiagnosticArray, DIAGNOSTICS, QoSProfile(depth=_DEPTH)
        )
        self._hurry = node.create_guard_condition(self.publish)
        self._timer = node.create_timer(
            period, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def add(self, name: str, check: Check) -> None:
        """Have `check` asked before each message; `name` tells it from the node's others."""
        self._checks.append((name, check))

    def hasten(self) -> None:
        """Have all findings sent soon, because one has changed; from any thread."""
        self._hurry.trigger()

    def publish(self) -> None:
        """Send all findings now; for the executor's thread."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [self._status(name, check()) for name, check in self._checks]
        self._publisher.publish(message)

    def _status(self, name: str, finding: Finding) -> Any:
        node_name = self._node.get_fully_qualified_name().removeprefix('/')
        return DiagnosticStatus(
            level=bytes([finding.level]),
            name=f'{node_name}: {name}',
            message=finding.message,
            hardware_id=self._hardware_id,
            values=[
                KeyValue(key=key, value=_text(value)) for key, value in finding.values.items()
            ],
        )


class RollCall:
    """
    Which nodes of a cell have told of themselves on ``/diagnostics``, and are silent now.

    Parameters
    ----------
    node : rclpy.node.Node
        Who asks; what counts is the cell that it belongs to, by its namespace.
    names : collection of str
        The nodes' names.

    """

    def __init__(self, node: Any, names: Collection[str]) -> None:
        namespace = node.get_namespace().strip('/')
        self._names = {f'{namespace}/{name}'.removeprefix('/'): name for name in names}
        self._heard: dict[str, float] = {}
        node.create_subscription(
            DiagnosticArray, DIAGNOSTICS, self._on_array, QoSProfile(depth=_DEPTH)
        )

    def _on_array(self, message: Any) -> None:
        for status in message.status:
            name = self._names.get(status.name.partition(':')[0])
            if name is not None:
                self._heard[name] = time.monotonic()

    def begin(self) -> None:
        """Forget who was heard: what has been stopped since is not missed."""
        self._heard.clear()

    @property
    def complete(self) -> bool:
        """Return whether all of them have been heard."""
        return len(self._heard) == len(self._names)

    @property
    def silent(self) -> tuple[str, ...]:
        """Return the names of those that were heard once and are not heard any more, in order."""
        now = time.monotonic()
        return tuple(sorted(name for name, at in self._heard.items() if now - at > SILENCE))


def worst(findings: Sequence[Finding], good: str) -> Finding:
    """
    Return several findings about one thing as one.

    Parameters
    ----------
    findings : sequence of Finding
        What was found.
    good : str
        What to say where all is well.

    Returns
    -------
    Finding
        With the highest level, the messages of all that are not well, and all values.

    """
    level = max((finding.level for finding in findings), default=Level.OK)
    said = ' '.join(finding.message for finding in findings if finding.level is not Level.OK)
    values = {key: value for finding in findings for key, value in finding.values.items()}
    return Finding(level, said or good, values)


class Heard:
    """
    When a stream was last heard, by the steady clock; to be noted from one thread.

    Parameters
    ----------
    name : str
        What the stream is called, as the subject of a sentence.
    key : str
        What its values begin with.

    """

    def __init__(self, name: str, key: str) -> None:
        self._name = name
        self._key = key
        self._last: float | None = None
        self._count = 0

    def note(self, count: int = 1, *, ago: float = 0.0) -> None:
        """
        Note that so many messages have come.

        Parameters
        ----------
        count : int
            How many.
        ago : float
            How long ago the last one came [s]; what is to come yet, by a clock that was set back
            since, came now.

        """
        if count:
            self._last = time.monotonic() - max(0.0, ago)
            self._count += count

    @property
    def age(self) -> float | None:
        """Return how long ago the last message came [s], or None before the first."""
        return None if self._last is None else time.monotonic() - self._last

    def finding(self, longest: float) -> Finding:
        """
        Return whether the stream is heard.

        Parameters
        ----------
        longest : float
            A stream that is silent for longer is missed [s].

        """
        age = self.age
        values = {f'{self._key}_count': self._count, f'{self._key}_age_s': age}
        if age is None:
            return Finding(Level.WARN, f'{self._name} has not come yet.', values)
        if age > longest:
            return Finding(Level.WARN, f'{self._name} has not come for {age:.3g} s.', values)
        return Finding(Level.OK, '', values)


def _text(value: object) -> str:
    match value:
        case bool():
            return 'yes' if value else 'no'
        case float():
            return f'{value:.6g}'
        case None:
            return '-'
    return str(value)

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
The running trial as the rheology fitter keeps it: serialized, until it is fitted.

The messages are decoded, timed and put in order by the same code that reads a bag, so that a
trial gives the same numbers live, in a replay and from its bag.
"""

from array import array
from collections.abc import Mapping
from pathlib import Path
import tempfile
from typing import Final, IO

from hapticvision_ros.bag.cdr import Decoder
from hapticvision_ros.bag.contract import POINTS, Topic
from hapticvision_ros.bag.mcap_scan import Batch, Channel, Place
from hapticvision_ros.bag.reader import TrialStreams
from hapticvision_ros.core.records import Trial
from hapticvision_ros.nodes.clock import Nanoseconds
import numpy as np
from numpy.typing import NDArray

_NOWHERE: Final = Place(Path(), 0, 0, '', 0)


class _Rows:
    """The messages of one topic, one after the other."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.sizes = array('q')
        self.sent = array('q')

    def add(self, data: bytes, sent_ns: int) -> None:
        self.data += data
        self.sizes.append(len(data))
        self.sent.append(sent_ns)


class TrialBuffer:
    """
    What has been received since a trial began.

    Parameters
    ----------
    capacity : int
        Bytes of numbers, and bytes of clouds, that are kept at most.

    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._rows: dict[str, _Rows] = {}
        self._topics: dict[str, Topic] = {}
        self._size = 0
        self._left_out = 0
        self._clouds: IO[bytes] | None = None
        self._cloud_size = 0
        self._cloud_count = 0
        self._streams = TrialStreams()

    def __len__(self) -> int:
        """Return the number of messages."""
        return sum(len(rows.sent) for rows in self._rows.values()) + self._cloud_count

    @property
    def left_out(self) -> int:
        """Return the number of messages for which there was no room."""
        return self._left_out

    def count(self, topic: Topic) -> int:
        """Return the number of messages of a topic other than the clouds'."""
        rows = self._rows.get(topic.name)
        return len(rows.sent) if rows is not None else 0

    def newest_sent(self, topic: Topic) -> int | None:
        """Return when the last message of a topic was sent [ns], or None."""
        rows = self._rows.get(topic.name)
        return rows.sent[-1] if rows is not None and rows.sent else None

    def add(self, topic: Topic, data: bytes, sent_ns: int) -> None:
        """Keep a message; left out, and told in the trial's warnings, if there is no room."""
        if topic is POINTS:
            self._add_cloud(data)
            return
        if self._size + len(data) > self._capacity:
            self._left_out += 1
            return
        self._size += len(data)
        rows = self._rows.get(topic.name)
        if rows is None:
            rows = self._rows[topic.name] = _Rows()
            self._topics[topic.name] = topic
        rows.add(data, sent_ns)

    def _add_cloud(self, data: bytes) -> None:
        """Put a cloud into a file, from which it is read when the trial is fitted."""
        if self._cloud_size + len(data) > self._capacity:
            self._left_out += 1
            return
        stamp = np.array([Decoder(memoryview(data)).stamp()], dtype=np.int64)
        if self._clouds is None:
            # It lives as long as the trial: `close` ends it.
            self._clouds = tempfile.NamedTemporaryFile(prefix='hapticvision_')  # noqa: SIM115
        place = Place(Path(self._clouds.name), self._cloud_size, len(data), '', len(data))
        self._clouds.write(data)
        self._cloud_size += len(data)
        self._cloud_count += 1
        # The stream keeps where the points are, and lets go of the points themselves.
        self._streams.points.add(
            _batch(POINTS, place, np.frombuffer(data, np.uint8), np.array([len(data)]), stamp)
        )

    def trial(
        self, name: str, times: Mapping[str, Nanoseconds], provenance: Mapping[str, str]
    ) -> Trial:
        """
        Return the trial, as a bag of these messages would be read; to be called once.

        Parameters
        ----------
        name : str
            What a person calls the trial.
        times : mapping of str to ndarray of int64
            For each topic but the clouds' when its messages were measured [ns since the epoch];
            fewer than messages if it is not known of all.
        provenance : mapping of str to str
            Where the data come from.

        Raises
        ------
        InputError
            If there is no usable force or no usable tool height.

        """
        for topic_name, rows in self._rows.items():
            stamps = times[topic_name]
            batch = _batch(
                self._topics[topic_name],
                _NOWHERE,
                np.frombuffer(bytes(rows.data), np.uint8),
                np.array(rows.sizes, dtype=np.int64)[: stamps.size],
                stamps,
            )
            self._streams.by_name[topic_name].add(batch)
        if self._clouds is not None:
            self._clouds.flush()
        warnings = []
        if self._left_out:
            warnings.append(
                f'{self._left_out} messages did not fit into the memory for a trial '
                f'({self._capacity} bytes): left out'
            )
        return self._streams.trial(
            name,
            'what was received',
            warnings=warnings,
            provenance=provenance,
            topics=list(self._rows),
        )

    def sent(self) -> dict[str, Nanoseconds]:
        """Return when the messages of each topic but the clouds' were sent [ns]."""
        return {name: np.array(rows.sent, dtype=np.int64) for name, rows in self._rows.items()}

    def close(self) -> None:
        """Forget the clouds."""
        if self._clouds is not None:
            self._clouds.close()
            self._clouds = None


def _batch(
    topic: Topic,
    place: Place,
    data: NDArray[np.uint8],
    sizes: NDArray[np.int64],
    stamps: Nanoseconds,
) -> Batch:
    """Return messages that lie one after the other, as if they had been read from a bag."""
    return Batch(
        channel=Channel(topic.name, topic.msgtype, 'cdr', 'ros2msg'),
        place=place,
        data=data,
        starts=np.cumsum(sizes) - sizes,
        sizes=sizes,
        log_ns=stamps,
        publish_ns=stamps,
    )

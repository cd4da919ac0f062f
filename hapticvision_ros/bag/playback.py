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
A bag's messages in the order in which they were sent, to be played again.

Whatever the state of the bag, its numbers are kept in memory and its clouds stay in the file.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

from hapticvision_ros.bag.bag_files import find_files
from hapticvision_ros.bag.cdr import IntArray
from hapticvision_ros.bag.contract import POINTS, PROVENANCE, Topic, TOPICS
from hapticvision_ros.bag.mcap_scan import McapScanner, Place, unpack
from hapticvision_ros.bag.streams import reconcile
from hapticvision_ros.core.errors import InputError
import numpy as np


@dataclass(frozen=True, slots=True)
class PlayedMessage:
    """A serialized message, its topic, and when it was sent [ns since the epoch]."""

    sent_ns: int
    topic: Topic
    data: bytes


@dataclass(frozen=True, slots=True)
class _Entry:
    """A message in memory, or where it lies in the file."""

    topic: Topic
    data: bytes | None
    place: Place
    start: int
    size: int


class Playback:
    """
    The messages of a bag that the contract knows, in order of their publish times.

    Parameters
    ----------
    path : Path
        A bare ``.mcap`` file or a rosbag2 directory.

    Attributes
    ----------
    topics : tuple of Topic
        The contract's topics that the bag holds.
    warnings : tuple of str
        What could not be read or had to be left out.
    provenance : mapping of str to str
        Where the data come from.

    Raises
    ------
    InputError
        If there is no such bag, or it holds no message of the contract.

    """

    def __init__(self, path: Path) -> None:
        bag = find_files(path)
        by_name = {topic.name: topic for topic in TOPICS}
        entries: list[_Entry] = []
        times: dict[str, list[tuple[IntArray, IntArray]]] = {}
        rows: dict[str, list[_Entry]] = {}
        warnings = list(bag.warnings)
        provenance: dict[str, str] = {}
        for file in bag.files:
            scanner = McapScanner(file, by_name.keys())
            for batch in scanner.batches():
                topic = by_name[batch.channel.topic]
                if batch.channel.msgtype != topic.msgtype:
                    warnings.append(
                        f'{topic.name} holds {batch.channel.msgtype} and not {topic.msgtype}: '
                        'not played'
                    )
                    continue
                times.setdefault(topic.name, []).append((batch.publish_ns, batch.log_ns))
                stops = batch.starts + batch.sizes
                spans = zip(batch.starts.tolist(), stops.tolist(), strict=True)
                rows.setdefault(topic.name, []).extend(
                    _Entry(
                        topic,
                        None if topic is POINTS else batch.data[start:stop].tobytes(),
                        batch.place,
                        start,
                        stop - start,
                    )
                    for start, stop in spans
                )
            warnings += scanner.faults
            provenance |= scanner.metadata.get(PROVENANCE, {})
        if not rows:
            raise InputError(f'{path} holds no message of the contract: there is nothing to play.')
        sent: list[IntArray] = []
        for name, parts in times.items():
            publish = np.concatenate([part[0] for part in parts])
            log = np.concatenate([part[1] for part in parts])
            sent.append(reconcile(publish, log)[0])
            entries += rows[name]
        self._sent = np.concatenate(sent)
        self._order = np.argsort(self._sent, kind='stable')
        self._entries = entries
        self.topics = tuple(topic for topic in TOPICS if topic.name in rows)
        self.warnings = tuple(dict.fromkeys(warnings))
        self.provenance: Mapping[str, str] = MappingProxyType(provenance)

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self._entries)

    @property
    def start_ns(self) -> int:
        """When the first message was sent [ns since the epoch]."""
        return int(self._sent[self._order[0]])

    @property
    def duration(self) -> float:
        """Time from the first message to the last [s]."""
        return float(self._sent[self._order[-1]] - self.start_ns) * 1e-9

    def __iter__(self) -> Iterator[PlayedMessage]:
        """
        Yield the messages in order of time.

        Raises
        ------
        InputError
            If the bag has changed or gone since it was opened.

        """
        reader = _PlaceReader()
        try:
            for row in self._order.tolist():
                entry = self._entries[row]
                data = entry.data if entry.data is not None else reader.read(entry)
                yield PlayedMessage(int(self._sent[row]), entry.topic, data)
        except (OSError, ValueError) as error:
            raise InputError(
                'The bag has changed while it was played: do not write to a bag that is in use.'
            ) from error
        finally:
            reader.close()


class _PlaceReader:
    """Reads messages from the file, one file and one decompressed chunk at a time."""

    def __init__(self) -> None:
        self._path: Path | None = None
        self._file: BinaryIO | None = None
        self._place: Place | None = None
        self._records = b''

    def read(self, entry: _Entry) -> bytes:
        place = entry.place
        if self._file is None or place.path != self._path:
            self.close()
            self._path, self._file = place.path, place.path.open('rb')
        if place.compression == '':
            self._file.seek(place.position + entry.start)
            data = self._file.read(entry.size)
        else:
            if place != self._place:
                self._file.seek(place.position)
                self._records, self._place = unpack(place, self._file.read(place.size)), place
            start, stop = entry.start, entry.start + entry.size
            data = self._records[start:stop]
        if len(data) < entry.size:
            raise ValueError('the file has become shorter')
        return data

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

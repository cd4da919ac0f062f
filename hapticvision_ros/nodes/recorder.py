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
Records one trial at a time to a contract bag, without keeping the node's thread waiting.

The node's thread hands over serialized messages; a thread of the recorder writes them.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import queue
import shutil
import threading
import traceback
from typing import Final

from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    POINTS,
    PROVENANCE,
    Topic,
    TOPICS,
)
from hapticvision_ros.bag.writer import BagWriter
from hapticvision_ros.core.errors import HapticVisionError, InputError

FAILED: Final = '_aborted'
"""Suffix of a bag that could not be written to its end."""
TRIAL: Final = 'trial'
"""Name of the MCAP metadata record that tells how the trial ended."""


@dataclass(frozen=True, slots=True)
class _Message:
    topic: Topic
    data: bytes
    received_ns: int
    sent_ns: int


@dataclass(frozen=True, slots=True)
class _End:
    outcome: Mapping[str, str]
    suffix: str


def missing_topics(counts: Mapping[str, int]) -> list[str]:
    """Return the topics that a trial needs and of which a bag holds no message."""
    missing = [topic.name for topic in TOPICS if topic.required and not counts.get(topic.name)]
    if not (counts.get(POINTS.name) or counts.get(DISPLACEMENT_HEIGHT.name)):
        missing.append(f'{POINTS.name} or {DISPLACEMENT_HEIGHT.name}')
    return missing


class Recording:
    """
    One trial that is being written.

    Parameters
    ----------
    path : Path
        The rosbag2 directory to make.
    provenance : mapping of str to str
        Written into the bag.
    capacity : int
        Bytes that may wait for the disk.

    """

    def __init__(self, path: Path, provenance: Mapping[str, str], capacity: int) -> None:
        self.path = path
        self.counts: Counter[str] = Counter()
        self._provenance = dict(provenance)
        self._capacity = capacity
        self._waiting = 0
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[_Message | _End] = queue.SimpleQueue()
        self._opened = threading.Event()
        self._ending = False
        self._error: str | None = None
        self._thread = threading.Thread(target=self._guarded, name='recorder', daemon=True)
        self._thread.start()

    @property
    def opened(self) -> bool:
        """Whether the bag is there."""
        return self._opened.is_set()

    @property
    def closed(self) -> bool:
        """Whether nothing more is written, because of `close` or of an error."""
        return not self._thread.is_alive()

    @property
    def error(self) -> str | None:
        """Why the bag cannot be written, as one sentence."""
        return self._error

    def write(self, topic: Topic, data: bytes, received_ns: int, sent_ns: int) -> None:
        """Take a message; it is written soon."""
        if self._ending or self._error is not None:
            return
        with self._lock:
            self._waiting += len(data)
            full = self._waiting > self._capacity
        if full:
            self._error = (
                f'{self.path} cannot be written fast enough: record to a faster disk, or lower '
                'the rate of the range sensor.'
            )
            return
        self.counts[topic.name] += 1
        self._queue.put(_Message(topic, data, received_ns, sent_ns))

    def close(self, outcome: Mapping[str, str], suffix: str = '') -> None:
        """
        Finish the bag; it is whole once `closed` is true.

        Parameters
        ----------
        outcome : mapping of str to str
            Written into the bag.
        suffix : str
            Appended to its name, for a trial that is of no use.

        """
        if not self._ending:
            self._ending = True
            self._queue.put(_End(outcome, suffix))

    def join(self, timeout: float) -> None:
        """Wait until the bag is closed, at most `timeout` [s]."""
        self._thread.join(timeout)

    def _guarded(self) -> None:
        try:
            suffix = self._write()
        except (HapticVisionError, OSError) as error:
            self._error = self._error or str(error)
            # What is on the disk stays, under a name that says what it is.
            suffix = FAILED
        except Exception as error:
            # A defect of this package, but its trial must not pass for a complete one.
            self._error = f'{self.path} is not whole: {type(error).__name__}: {error}'
            suffix = FAILED
            traceback.print_exc()
        if suffix and self._opened.is_set():
            marked = self.path.with_name(self.path.name + suffix)
            with suppress(OSError):
                self.path.rename(marked)
                self.path = marked

    def _write(self) -> str:
        """Write until the end, and return the suffix that the bag is to have."""
        with BagWriter(self.path) as writer:
            writer.write_metadata(PROVENANCE, self._provenance)
            self._opened.set()
            while True:
                item = self._queue.get()
                if isinstance(item, _End):
                    break
                with self._lock:
                    self._waiting -= len(item.data)
                writer.write_raw(item.topic, item.data, item.received_ns, item.sent_ns)
            writer.write_metadata(TRIAL, dict(item.outcome))
        return item.suffix


def check_room(folder: Path, least: int) -> None:
    """
    Refuse a disk that is all but full.

    Parameters
    ----------
    folder : Path
        Where the bags go.
    least : int
        Bytes that must be free.

    Raises
    ------
    InputError
        If there is less room, or the disk is gone.

    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise InputError(
            f'{folder} cannot be read ({error.strerror}): see to the disk.'
        ) from error
    if free < least:
        raise InputError(
            f'{folder} has only {free / 1e6:.0f} MB of room; {least / 1e6:.0f} MB are asked for: '
            'make room, or choose another output_folder.'
        )


def writable_folder(path: str, names: Iterable[str]) -> Path:
    """
    Return the folder for an experiment's bags, made if it is missing.

    Parameters
    ----------
    path : str
        The folder.
    names : iterable of str
        The bags that are going to be made in it.

    Raises
    ------
    InputError
        If the folder cannot be made or written, or holds one of the bags already.

    """
    if not path:
        raise InputError('output_folder is empty: set it to the folder for the bags.')
    folder = Path(path).expanduser().absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        present = {item.name for item in folder.iterdir()}
    except OSError as error:
        raise InputError(
            f'{folder} cannot be used for the bags ({error.strerror}): choose another '
            'output_folder.'
        ) from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f'{folder} is write-protected: choose another output_folder.')
    for name in names:
        if any(item == name or item.startswith(f'{name}_') for item in present):
            raise InputError(
                f'{folder / name} exists already: choose another output_folder, nothing is '
                'overwritten.'
            )
    return folder

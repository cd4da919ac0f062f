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

"""A device that may go and come back, and what is told of it."""

from collections.abc import Callable
import threading
import time
from typing import Any, Final, Protocol

from hapticvision_ros.core.devices import StreamCounts
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.nodes.diagnostics import Finding, Level
from hapticvision_ros.nodes.parameters import ParameterSpec

REOPEN_PARAMETERS: Final = (
    ParameterSpec(
        'reopen_interval',
        'double',
        's',
        'Time between two attempts to open a device that has gone.',
        0.05,
        60.0,
        read_only=True,
    ),
    ParameterSpec(
        'reopen_time',
        'double',
        's',
        'How long a device that has gone is waited for before the node ends; 0 to end at once.',
        0.0,
        86400.0,
        read_only=True,
    ),
)
"""The parameters of a node that waits for its device."""


class Device(Protocol):
    """What a load cell and a range sensor have in common."""

    @property
    def counts(self) -> StreamCounts:
        """Return what has been seen on the stream so far."""
        ...

    def close(self) -> None:
        """Let go of the device."""
        ...


class DeviceKeeper[D: Device]:
    """
    Holds a device open: what goes is opened again, for some time.

    Parameters
    ----------
    open_device : callable
        Opens the device, or raises `DeviceError`.
    stopping : threading.Event
        Set when the node ends.
    logger : rclpy logger
        Where it is told that the device goes and comes.
    interval, patience : float
        Time between two attempts, and how long they go on [s].

    Raises
    ------
    DeviceError
        If the device cannot be opened at first: that is a wrong setting, not a loss.

    """

    def __init__(
        self,
        open_device: Callable[[], D],
        stopping: threading.Event,
        logger: Any,
        *,
        interval: float,
        patience: float,
    ) -> None:
        self._open = open_device
        self._stopping = stopping
        self._logger = logger
        self._interval = interval
        self._patience = patience
        self._past = StreamCounts()
        self._trouble: str | None = None
        self._reopened = 0
        self._device: D | None = open_device()

    def run(
        self,
        use: Callable[[D], None],
        lost: Callable[[], None],
        changed: Callable[[], None],
    ) -> None:
        """
        Call `use` with the device again and again until the node ends.

        Parameters
        ----------
        use : callable
            Reads from the device once; its `DeviceError` says that the device has gone.
        lost : callable
            Called when the device has gone: what follows does not belong to what came before.
        changed : callable
            Called when there is another finding.

        Raises
        ------
        DeviceError
            If the device did not come back in time.

        """
        while not self._stopping.is_set():
            device = self._device
            if device is None:
                return
            try:
                use(device)
            except DeviceError as error:
                if self._stopping.is_set():
                    return
                lost()
                self._trouble = str(error)
                changed()
                self._come_back(error)
                changed()

    def close(self) -> None:
        """Let go of the device; the thread of `run` has ended."""
        if self._device is not None:
            self._device.close()
            self._device = None

    @property
    def counts(self) -> StreamCounts:
        """Return what has been seen since the beginning."""
        device = self._device
        return self._past if device is None else self._past + device.counts

    def finding(self) -> Finding:
        """Return how the device is."""
        counts = self.counts
        values: dict[str, object] = {
            'received': counts.received,
            'lost': counts.lost,
            'late': counts.late,
            'garbled': counts.garbled,
            'restarts': counts.restarts,
            'opened_again': self._reopened,
        }
        trouble = self._trouble
        if trouble is not None:
            return Finding(Level.ERROR, f'The device has gone: {trouble}.', values)
        return Finding(Level.OK, 'The device is there.', values)

    def _come_back(self, error: DeviceError) -> None:
        """Open the device again, or raise why it went."""
        assert self._device is not None
        self._past = self.counts
        gone, self._device = self._device, None
        gone.close()
        if self._patience > 0.0:
            self._logger.error(
                f'{error}; it is tried again for {self._patience:g} s.',
            )
        deadline = time.monotonic() + self._patience
        while time.monotonic() < deadline:
            if self._stopping.wait(self._interval):
                return
            try:
                self._device = self._open()
            except DeviceError as again:
                self._trouble = str(again)
                continue
            self._trouble = None
            self._reopened += 1
            self._logger.info('The device is there again.')
            return
        raise error

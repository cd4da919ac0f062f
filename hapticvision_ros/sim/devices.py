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


"""The back ends of the simulated cell: a load cell, an arm and a range sensor on loopback."""

from collections.abc import Sequence
from contextlib import suppress
import select
import socket
import time

from hapticvision_ros.core.devices import (
    Arm,
    ArmState,
    LoadCell,
    RangeFrame,
    RangeSensor,
    StreamCounts,
    WrenchSample,
)
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.sim.config import Block, RangeSensorModel, SoftBodyModel
from hapticvision_ros.sim.protocol import (
    ARM,
    ARM_PACKET,
    decode,
    encode,
    FORCE,
    FORCE_PACKET,
    LEASE,
    LOOPBACK,
    MAX_DATAGRAM,
    Message,
    POINT,
    SHAPE,
    SHAPE_PACKET,
)
from hapticvision_ros.sim.scene import RangeRenderer, Scene
import numpy as np

CONNECT_TIMEOUT = 3.0
"""How long a world that is just starting is waited for [s]."""
RETRY = 0.1
"""Time between two attempts of a request [s]."""
RECEIVE_BUFFER = 1 << 20
"""Bytes asked of the system for datagrams that wait to be read."""


class _Link:
    """A socket to the simulated world, with one stream open or none."""

    def __init__(self, port: int, stream: str | None) -> None:
        self._port = port
        self._stream = stream
        self._renew_at = 0.0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket.setblocking(False)
        try:
            self._socket.connect((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise DeviceError(f'{port} is not a usable UDP port: {error}') from error

    def request(self, message: Message) -> Message:
        """Send a request until it is answered, and return the answer."""
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while (now := time.monotonic()) < deadline:
            self._try_send(message)
            attempt_ends = min(deadline, now + RETRY)
            while self._wait(attempt_ends):
                try:
                    answer = decode(self._socket.recv(MAX_DATAGRAM))
                except ConnectionError:
                    time.sleep(RETRY)
                    break
                if answer is not None:
                    if 'error' in answer:
                        raise DeviceError(str(answer['error']))
                    return answer
        raise DeviceError(
            f'no simulated world answers on UDP port {self._port} of {LOOPBACK}: start one with '
            f'simulated_world --port {self._port}'
        )

    def send(self, message: Message) -> None:
        """Send a message that is not answered."""
        if not self._try_send(message):
            raise self._lost()

    def receive(self, size: int, timeout: float) -> list[bytes]:
        """Return the datagrams of `size` bytes that wait, at least one."""
        now = time.monotonic()
        deadline = now + timeout
        if now >= self._renew_at:
            self.send({'request': 'renew', 'stream': self._stream})
            self._renew_at = now + LEASE / 3.0
        datagrams: list[bytes] = []
        while not datagrams:
            if not self._wait(deadline):
                raise DeviceError(
                    f'the simulated world on UDP port {self._port} has sent no {self._stream} '
                    f'reading for {timeout:g} s: see whether it still runs'
                )
            try:
                while True:
                    datagram = self._socket.recv(MAX_DATAGRAM)
                    if len(datagram) == size and datagram[0] == 0:
                        datagrams.append(datagram)
            except BlockingIOError:
                continue
            except ConnectionError as error:
                raise self._lost() from error
        return datagrams

    def close(self) -> None:
        """End the stream and close the socket; may be called again."""
        if self._socket.fileno() != -1:
            self._try_send({'request': 'close'})
            self._socket.close()

    def _wait(self, deadline: float) -> bool:
        """Return whether a datagram came before `deadline` (monotonic) [s]."""
        if self._socket.fileno() == -1:
            raise DeviceError('the simulated device has been closed')
        remaining = max(0.0, deadline - time.monotonic())
        return bool(select.select([self._socket], [], [], remaining)[0])

    def _try_send(self, message: Message) -> bool:
        """Return whether the message could be sent: not where nothing listens."""
        try:
            self._socket.send(encode(message))
        except OSError:
            return False
        return True

    def _lost(self) -> DeviceError:
        return DeviceError(
            f'the simulated world on UDP port {self._port} has gone: start it again'
        )


class SimulatedLoadCell:
    """The load cell of the simulated cell."""

    def __init__(self, link: _Link) -> None:
        self._link = link
        self.counts = StreamCounts()

    def read(self, timeout: float) -> Sequence[WrenchSample]:
        """Return the samples since the last call, waiting up to `timeout` [s] for the first."""
        samples = []
        for datagram in self._link.receive(FORCE_PACKET.size, timeout):
            stamp, fx, fy, fz, tx, ty, tz = FORCE_PACKET.unpack(datagram)
            samples.append(WrenchSample(stamp, (fx, fy, fz), (tx, ty, tz)))
        self.counts.received += len(samples)
        return samples

    def close(self) -> None:
        """Let go of the device."""
        self._link.close()


class SimulatedArm:
    """The arm of the simulated cell."""

    def __init__(self, link: _Link) -> None:
        self._link = link

    def read(self, timeout: float) -> Sequence[ArmState]:
        """Return the states since the last call, waiting up to `timeout` [s] for the first."""
        datagrams = self._link.receive(ARM_PACKET.size, timeout)
        return [ArmState(*ARM_PACKET.unpack(datagram)) for datagram in datagrams]

    def command(self, push_velocity: float) -> None:
        """Command a speed along the push [m/s], positive toward the object."""
        self._link.send({'request': 'push', 'velocity': float(push_velocity)})

    def close(self) -> None:
        """Stop the arm and let go of it."""
        # Where the world has gone, the arm has gone with it.
        with suppress(DeviceError):
            self.command(0.0)
        self._link.close()


class SimulatedRangeSensor:
    """The range sensor of the simulated cell; its clouds are rendered in the caller's process."""

    def __init__(self, link: _Link, renderer: RangeRenderer, nodes: int = 0) -> None:
        self._link = link
        self._renderer = renderer
        self._size = SHAPE_PACKET.size + 3 * nodes * np.dtype(POINT).itemsize
        self.counts = StreamCounts()

    def grab(self, timeout: float) -> RangeFrame:
        """Return the next frame, waiting up to `timeout` [s]; late frames are skipped."""
        newest = self._link.receive(self._size, timeout)[-1]
        stamp, tool_height, displacement = SHAPE_PACKET.unpack_from(newest)
        points = np.frombuffer(newest, POINT, offset=SHAPE_PACKET.size).astype(np.float64)
        self.counts.received += 1
        cloud = self._renderer.render(tool_height, displacement, points.reshape(-1, 3))
        return RangeFrame(stamp, cloud)

    def close(self) -> None:
        """Let go of the device."""
        self._link.close()


def _open(port: int, stream: str) -> tuple[_Link, Message]:
    """Return a link with an open stream, and what the world says of the scene."""
    link = _Link(port, stream)
    try:
        return link, link.request({'request': 'open', 'stream': stream})
    except DeviceError:
        link.close()
        raise


def connect_load_cell(port: int) -> LoadCell:
    """
    Connect to the load cell of a simulated world.

    Parameters
    ----------
    port : int
        UDP port of the world on loopback.

    Returns
    -------
    LoadCell
        The load cell, streaming.

    Raises
    ------
    DeviceError
        If no world answers within three seconds.

    """
    link, _ = _open(port, FORCE)
    return SimulatedLoadCell(link)


def connect_arm(port: int) -> Arm:
    """
    Connect to the arm of a simulated world.

    Parameters
    ----------
    port : int
        UDP port of the world on loopback.

    Returns
    -------
    Arm
        The arm, streaming its state.

    Raises
    ------
    DeviceError
        If no world answers within three seconds.

    """
    link, _ = _open(port, ARM)
    return SimulatedArm(link)


def connect_range_sensor(
    port: int, *, width: int, height: int, depth_noise: float, seed: int
) -> RangeSensor:
    """
    Connect to the range sensor of a simulated world.

    Parameters
    ----------
    port : int
        UDP port of the world on loopback.
    width, height : int
        Size of the clouds in pixels.
    depth_noise : float
        Standard deviation of the measured depth [m].
    seed : int
        Seed of the noise.

    Returns
    -------
    RangeSensor
        The range sensor, streaming at the world's rate.

    Raises
    ------
    DeviceError
        If no world answers within three seconds.

    """
    link, answer = _open(port, SHAPE)
    match answer:
        case {
            'scene': {
                'block': dict() as block,
                'tool_radius': float() as tool_radius,
                'sensor': dict() as sensor,
                'soft_body': dict() | None as soft_body,
            }
        }:
            model = None if soft_body is None else SoftBodyModel(**soft_body)
            sphere = model is not None and model.sphere
            scene = Scene(Block(**block), tool_radius, RangeSensorModel(**sensor), sphere)
        case _:
            link.close()
            raise DeviceError(f'what answers on UDP port {port} is no simulated world')
    nodes, triangles = 0, None
    if model is not None:
        # It needs numba, which is slow to load and which a block does without.
        from hapticvision_ros.sim.soft_object import soft_surface

        nodes, triangles = soft_surface(scene.block, model)
    renderer = RangeRenderer(
        scene,
        width=width,
        height=height,
        depth_noise=depth_noise,
        seed=seed,
        triangles=triangles,
    )
    return SimulatedRangeSensor(link, renderer, nodes)


def place_new_sample(port: int) -> None:
    """
    Put a fresh object under the tool, as the robot's integrator would between two trials.

    Parameters
    ----------
    port : int
        UDP port of the world on loopback.

    Raises
    ------
    DeviceError
        If no world answers, or the tool is in the way.

    """
    link = _Link(port, None)
    try:
        link.request({'request': 'place_new_sample'})
    finally:
        link.close()

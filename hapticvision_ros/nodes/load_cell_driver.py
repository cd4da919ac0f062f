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

"""Load cell driver: owns the load cell and publishes each reading with the cell's own stamp."""

from collections import deque
from math import isfinite
from typing import Any, Final

from hapticvision_ros.bag.contract import TARE, WRENCH
from hapticvision_ros.core.devices import LoadCell, WrenchSample
from hapticvision_ros.nodes.conversions import NS_PER_S, wrench_to_message
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.qos import create_publisher, create_service
from hapticvision_ros.nodes.runtime import CellNode, run
from hapticvision_ros.sim.devices import connect_load_cell

NAME: Final = 'load_cell_driver'

PARAMETERS: Final = (
    ParameterSpec(
        'backend', 'string', '-', 'Which device to use.', choices=('simulated',), read_only=True
    ),
    ParameterSpec(
        'simulated_world_port',
        'integer',
        '-',
        'UDP port of the simulated world on loopback.',
        1,
        65535,
        read_only=True,
    ),
    ParameterSpec(
        'read_timeout',
        'double',
        's',
        'Without a reading for this time the load cell counts as lost and the node ends.',
        0.01,
        10.0,
    ),
    ParameterSpec(
        'capacity',
        'double',
        'N',
        'Largest magnitude along the push that the load cell can measure; readings at or above it '
        'are reported as saturated.',
        0.1,
        100000.0,
    ),
    ParameterSpec(
        'largest_gap',
        'double',
        's',
        'Time between two stamps above which samples are reported as lost.',
        0.001,
        1.0,
    ),
    ParameterSpec(
        'tare_time',
        'double',
        's',
        'The tare service takes the mean over this time as zero.',
        0.01,
        2.0,
        read_only=True,
    ),
    ParameterSpec(
        'warning_interval',
        'double',
        's',
        'Shortest time between two warnings of the same kind.',
        0.1,
        600.0,
        read_only=True,
    ),
)

type Vector = tuple[float, float, float]


class LoadCellDriver(CellNode):
    """Publish the load cell's readings less the tare; report what is wrong with them."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        self._warning_interval = self.parameters.real('warning_interval')
        self._tare_ns = round(self.parameters.real('tare_time') * NS_PER_S)
        self._recent: deque[WrenchSample] = deque()
        self._zero: tuple[Vector, Vector] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        self._last_stamp_ns: int | None = None
        self._publisher = create_publisher(self, WRENCH)
        self._cell: LoadCell = connect_load_cell(self.parameters.integer('simulated_world_port'))
        create_service(self, TARE, self._tare)
        self.spawn(self._read, 'load cell reader')

    def close(self) -> None:
        """Stop the reader, then let go of the load cell."""
        super().close()
        self._cell.close()

    def _read(self) -> None:
        timeout = self.parameters.real('read_timeout')
        while not self.stopping.is_set():
            for sample in self._cell.read(timeout):
                self._take(sample)

    def _take(self, sample: WrenchSample) -> None:
        if not all(map(isfinite, (*sample.force, *sample.torque))):
            self.get_logger().warning(
                'The load cell gave a reading that is not a number; it was left out.',
                throttle_duration_sec=self._warning_interval,
            )
            return
        last = self._last_stamp_ns
        if last is not None and sample.stamp_ns <= last:
            self.get_logger().warning(
                'The load cell gave a reading that is not newer than the one before; it was '
                'left out.',
                throttle_duration_sec=self._warning_interval,
            )
            return
        self._last_stamp_ns = sample.stamp_ns
        zero_force, zero_torque = self._zero
        self._publisher.publish(
            wrench_to_message(
                WrenchSample(
                    sample.stamp_ns,
                    _difference(sample.force, zero_force),
                    _difference(sample.torque, zero_torque),
                ),
                WRENCH.frame_id,
            )
        )
        self._recent.append(sample)
        while sample.stamp_ns - self._recent[0].stamp_ns > self._tare_ns:
            self._recent.popleft()
        if last is not None:
            gap = (sample.stamp_ns - last) / NS_PER_S
            if gap > self.parameters.real('largest_gap'):
                self.get_logger().warning(
                    f'The load cell gave no reading for {gap:.3g} s.',
                    throttle_duration_sec=self._warning_interval,
                )
        if abs(sample.force[2]) >= self.parameters.real('capacity'):
            self.get_logger().warning(
                f'The load cell is saturated: it reads {sample.force[2]:.4g} N.',
                throttle_duration_sec=self._warning_interval,
            )

    def _tare(self, request: Any, response: Any) -> Any:
        # The reader thread goes on appending, so that only a snapshot can be averaged.
        recent = self._recent.copy()
        if not recent:
            response.success = False
            response.message = 'The load cell has given no reading yet.'
            return response
        self._zero = (
            _mean([sample.force for sample in recent]),
            _mean([sample.torque for sample in recent]),
        )
        response.success = True
        zero = self._zero[0][2]
        response.message = f'The zero is {zero:.6g} N along the push, from {len(recent)} readings.'
        return response


def _difference(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _mean(vectors: list[Vector]) -> Vector:
    x, y, z = (sum(column) / len(vectors) for column in zip(*vectors, strict=True))
    return (x, y, z)


def main() -> int:
    """Run the load cell driver."""
    return run(LoadCellDriver)

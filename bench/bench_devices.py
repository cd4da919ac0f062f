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
Device back ends: CPU time of a reading or a frame, beside the least that Python can do with it.

Records of a Net F/T box and lines of a serial load cell are decoded, checked and stamped; beside
it stands the bare ``struct.unpack`` or ``float``. Depth images and clouds of 640x480 are brought
into the frame of the support plane; beside it stands the textbook formula in numpy with float32.

    OMP_NUM_THREADS=1 python bench/bench_devices.py [--rounds 200]
"""

import argparse
from collections.abc import Callable
from pathlib import Path
import struct
import tempfile
import time

from hapticvision_ros.core.devices import WrenchSample
from hapticvision_ros.devices.low_pass import LowPass
from hapticvision_ros.devices.mounting import Pose
from hapticvision_ros.devices.net_ft import NetFt, NetFtSettings
from hapticvision_ros.devices.numbered import SequenceWatch
from hapticvision_ros.devices.range_frames import Camera, CloudMover, Deprojector
from hapticvision_ros.devices.serial_cell import LineFormat, SerialCell
from hapticvision_ros.sim.emulators.net_ft import NetFtEmulator
from hapticvision_ros.sim.emulators.serial_cell import SerialCellEmulator
import numpy as np

READINGS = 200
RECORD = struct.Struct('>III6i')


def median_ms(work: Callable[[], object], rounds: int) -> float:
    """Return the median CPU time of a call [ms]; a busy machine does not count."""
    times = []
    for _ in range(rounds):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times)) * 1e3


def line(name: str, ours: float, least: float, unit: str) -> str:
    """Return one line of the table."""
    return f'| {name} | {ours:.3g} {unit} | {least:.3g} {unit} | {ours / least:.1f} |'


def net_ft(rounds: int) -> str:
    """Return what a record of a Net F/T box costs."""
    with NetFtEmulator() as box:
        cell = NetFt('127.0.0.1', NetFtSettings(1e6, 1e6, 1000.0), box.port)
        cell._numbers = SequenceWatch(cell.counts)
        number = 0

        def decode() -> None:
            nonlocal number
            for _ in range(READINGS):
                number += 1
                cell._decode(RECORD.pack(number, 0, 0, 1, 2, 3, 4, 5, 6), time.time_ns())

        for _ in range(20):
            decode()
        ours = median_ms(decode, rounds)
        cell.close()
        assert not cell.counts.garbled and not cell.counts.lost
    record = RECORD.pack(1, 2, 3, 4, 5, 6, 7, 8, 9)
    least = median_ms(lambda: [RECORD.unpack(record) for _ in range(READINGS)], rounds)
    return line('a record of RDT', ours / READINGS * 1e3, least / READINGS * 1e3, 'µs')


def checked(text: bytes) -> bytes:
    """Return a line with its checksum."""
    parity = 0
    for byte in text:
        parity ^= byte
    return text + b'*%02X' % parity


def serial(rounds: int) -> str:
    """Return what a line of a serial load cell costs."""
    with (
        tempfile.TemporaryDirectory() as folder,
        SerialCellEmulator(Path(folder) / 'tty') as device,
    ):
        line_format = LineFormat(counter_field=0, force_field=1, checksum=True)
        cell = SerialCell(str(device.link), 115200, line_format, 80.0)
        texts = [checked(b'%d,8123456' % (number % 65536)) for number in range(READINGS)]

        def decode() -> None:
            for text in texts:
                cell._decode(text, time.time_ns())
            # The counter begins again: that is not what is measured.
            cell._numbers = SequenceWatch(cell.counts, 65536)

        ours = median_ms(decode, rounds)
        cell.close()
        assert not cell.counts.garbled and not cell.counts.late
    text = b'8123456'
    least = median_ms(lambda: [float(text) for _ in range(READINGS)], rounds)
    return line(
        'a line of text with checksum', ours / READINGS * 1e3, least / READINGS * 1e3, 'µs'
    )


def low_pass(rounds: int) -> str:
    """Return what the low-pass costs for a reading."""
    passing = LowPass(0.005, 1000.0)
    sample = WrenchSample(1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    ours = median_ms(lambda: [passing.take(sample) for _ in range(READINGS)], rounds)
    rows, weights = np.ones((11, 6)), np.ones(11) / 11.0
    least = median_ms(lambda: [weights @ rows for _ in range(READINGS)], rounds)
    return line('the low-pass, 5 ms at 1 kHz', ours / READINGS * 1e3, least / READINGS * 1e3, 'µs')


def frames(rounds: int) -> list[str]:
    """Return what a depth image and a cloud cost."""
    camera = Camera(640, 480, (600.0, 600.0, 319.5, 239.5))
    pose = Pose.of([0.0, -0.306, 0.257, -2.269, 0.0, 0.0])
    depth = np.random.default_rng(0).integers(300, 600, (480, 640)).astype(np.uint16)
    deprojector, mover = Deprojector(camera, pose, 0.05, 2.0), CloudMover(pose, 0.05, 2.0)
    cloud = deprojector.points(depth)
    u, v = np.meshgrid(np.arange(640, dtype=np.float32), np.arange(480, dtype=np.float32))
    rotation, shift = pose.rotation.T.astype(np.float32), pose.translation.astype(np.float32)

    def textbook() -> object:
        z = np.where(depth > 0, depth * np.float32(0.001), np.float32(np.nan))
        x, y = (u - 319.5) * z / 600.0, (v - 239.5) * z / 600.0
        return np.stack([x, y, z], axis=-1) @ rotation + shift

    return [
        line(
            'a depth image',
            median_ms(lambda: deprojector.points(depth), rounds),
            median_ms(textbook, rounds),
            'ms',
        ),
        line(
            'a cloud',
            median_ms(lambda: mover.points(cloud), rounds),
            median_ms(lambda: cloud @ rotation + shift, rounds),
            'ms',
        ),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--rounds', type=int, default=200)
    rounds = parser.parse_args().rounds
    print('| what | here | bare | ratio |')
    print('| --- | --- | --- | --- |')
    for row in (net_ft(rounds), serial(rounds), low_pass(rounds), *frames(rounds)):
        print(row)


if __name__ == '__main__':
    main()

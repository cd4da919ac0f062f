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
Compare the reading of a bag with the bare rosbags reader, side by side in one run.

The bag is one 130 s trial: wrench at 1 kHz, tool height at 500 Hz, displacement height at 10 Hz.
rosbags deserialises the same messages and does nothing with them; `read_trial` also puts them in
order, checks them and returns arrays. Clouds are compared on a second bag, frame by frame.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from statistics import median
import tempfile
from time import perf_counter

from hapticvision_ros.bag.contract import POINTS
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.bag.writer import Compression, write_signals
from hapticvision_ros.core.records import CloudFrame, Signal
import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores

START_NS = 1_700_000_000_000_000_000


def make_trial(path: Path, compression: Compression) -> None:
    """Write the 130 s trial."""
    t = np.arange(0.0, 130.0, 1e-3)
    force = Signal(t, np.exp(-t / 38.3))
    height = Signal(t[::2], 0.05 - 1e-5 * t[::2])
    displacement = Signal(t[::100], 1e-5 * t[::100])
    write_signals(
        path,
        start_ns=START_NS,
        force=force,
        tool_height=height,
        displacement=displacement,
        compression=compression,
    )


def make_clouds(path: Path, frames: int) -> None:
    """Write a short trial with 640x480 clouds."""
    xyz = np.random.default_rng(0).normal(size=(480, 640, 3)).astype(np.float32)
    t = np.arange(frames) / 30.0
    flat = Signal(t, np.zeros(frames))
    clouds = (CloudFrame(float(time), xyz, POINTS.frame_id) for time in t)
    write_signals(
        path,
        start_ns=START_NS,
        force=flat,
        tool_height=flat,
        displacement=flat,
        clouds=clouds,
        compression='none',
    )


def bare_rosbags(path: Path) -> Callable[[], None]:
    """Return a function that deserialises all messages with rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)

    def run() -> None:
        with Reader(path) as reader:
            for connection, _, data in reader.messages():
                store.deserialize_cdr(data, connection.msgtype)

    return run


def ours(path: Path) -> Callable[[], None]:
    """Return a function that reads the trial and every cloud."""

    def run() -> None:
        for _ in read_trial(path).clouds or ():
            pass

    return run


def compare(name: str, runs: dict[str, Callable[[], None]], rounds: int) -> None:
    """Run the functions in turn and print the medians and the ratio of the first to the second."""
    times: dict[str, list[float]] = {label: [] for label in runs}
    for run in runs.values():
        run()
    for _ in range(rounds):
        for label, run in runs.items():
            begin = perf_counter()
            run()
            times[label].append(perf_counter() - begin)
    middle = {label: median(values) for label, values in times.items()}
    text = ', '.join(f'{label} {1e3 * value:.0f} ms' for label, value in middle.items())
    first, second = middle.values()
    print(f'{name}: {text}: {first / second:.1f} times as fast')


def main() -> None:
    """Compare on bags of each compression, and on clouds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--rounds', type=int, default=5, help='runs of each reader')
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder:
        compressions: tuple[Compression, ...] = ('none', 'lz4', 'zstd')
        for compression in compressions:
            path = Path(folder) / compression
            make_trial(path, compression)
            runs = {'rosbags': bare_rosbags(path), 'read_trial': ours(path)}
            compare(f'130 s trial, {compression}', runs, rounds)
        path = Path(folder) / 'clouds'
        make_clouds(path, 30)
        runs = {'rosbags': bare_rosbags(path), 'read_trial': ours(path)}
        compare('30 clouds of 640x480', runs, rounds)


if __name__ == '__main__':
    main()

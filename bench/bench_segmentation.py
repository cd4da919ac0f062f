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

"""Time the segmentation of one long trial at 1 kHz against plain passes over its samples."""

from collections.abc import Callable
from time import process_time

from hapticvision_ros.core.records import Signal
from hapticvision_ros.core.segmentation import OnlineSegmenter, segment
import numpy as np


def _trial() -> tuple[Signal, Signal]:
    """Return force and height of a push, a hold and a release of 130 s in all."""
    t = np.arange(0.0, 130.0, 1e-3)
    travel = np.interp(
        t, [0.0, 1.0, 9.0, 70.0, 78.0, 130.0], [-2e-3, -2e-3, 1e-2, 1e-2, -2e-3, -2e-3]
    )
    depth = np.maximum(travel, 0.0)
    relaxed = 0.5 + 0.5 * np.exp(-np.maximum(t - 9.0, 0.0) / 20.0)
    noise = 0.02 * np.random.default_rng(1).standard_normal(t.size)
    return Signal(t, 1e3 * depth * relaxed + noise), Signal(t[::2], 0.1 - travel[::2])


def _best(call: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of a call [s]."""
    times = []
    for _ in range(repeats):
        start = process_time()
        call()
        times.append(process_time() - start)
    return min(times)


def main() -> None:
    """Print the times and their ratio to a plain pass."""
    force, height = _trial()
    plain = _best(lambda: np.partition(force.value, len(force) // 2), 20)
    offline = _best(lambda: segment(force, height), 20)
    print(f'offline, {len(force)} + {len(height)} samples: {1e3 * offline:.1f} ms, ', end='')
    print(f'{offline / plain:.0f} times a median of the force')
    samples = list(zip(force.t.tolist(), force.value.tolist(), strict=True))
    heights = list(zip(height.t.tolist(), height.value.tolist(), strict=True))

    def online() -> None:
        segmenter = OnlineSegmenter()
        for i, (t, value) in enumerate(samples):
            segmenter.add_force(t, value)
            if i % 2 == 0:
                segmenter.add_height(*heights[i // 2])

    spent = _best(online, 1) / (len(force) + len(height))
    print(f'online: {1e6 * spent:.1f} us a sample, of the 1000 us between two at 1 kHz')


if __name__ == '__main__':
    main()

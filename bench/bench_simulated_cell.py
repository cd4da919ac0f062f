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
What the simulated cell costs: a frame of its range sensor, and a second of its world.

The frame is compared with casting every ray anew, and with drawing the noise alone, which no
renderer of noisy clouds can do without.
"""

from collections.abc import Callable
from functools import partial
from statistics import median
from time import process_time

from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.scene import RangeRenderer, Scene
from hapticvision_ros.sim.world import World
import numpy as np

FRAMES = 15
SECONDS = 5.0
TICK = 0.001


def milliseconds(work: Callable[[], object]) -> float:
    """Return the median CPU time of `work` [ms]."""
    times = []
    for _ in range(FRAMES):
        start = process_time()
        work()
        times.append(process_time() - start)
    return 1e3 * median(times)


def main() -> None:
    """Print the costs."""
    config = load_config()
    scene = Scene(config.block, config.arm.tool_radius, config.range_sensor)
    random = np.random.default_rng(1)
    print('frame       dent seen  tool down  every ray anew  noise alone')
    for width, height in ((160, 120), (640, 480)):
        cast_anew = partial(
            RangeRenderer, scene, width=width, height=height, depth_noise=5e-4, seed=1
        )
        noise = partial(random.standard_normal, width * height, dtype=np.float32)
        renderer = cast_anew()
        up = milliseconds(partial(renderer.render, 0.08, 0.008))
        down = milliseconds(partial(renderer.render, 0.032, 0.008))
        anew, least = milliseconds(cast_anew), milliseconds(noise)
        print(
            f'{width} x {height}   {up:6.2f} ms  {down:6.2f} ms  {anew:6.2f} ms ({anew / up:.1f}x)'
            f'  {least:5.2f} ms ({least / up:.2f}x)'
        )

    world = World(config, config.material('soft_dough'), seed=1)
    start = process_time()
    for tick in range(1, round(SECONDS / TICK) + 1):
        world.set_push_velocity(0.005)
        world.advance(tick * TICK)
    share = (process_time() - start) / SECONDS
    print(f'world at {1 / TICK:.0f} ticks a second: {100 * share:.1f} % of a core')


if __name__ == '__main__':
    main()

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


"""Make the synthetic bags under ``bags/`` again; the same version makes the same bags."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import shutil
import sys

from hapticvision_ros.core.errors import HapticVisionError
from hapticvision_ros.sim.config import load_config, WorldConfig
from hapticvision_ros.sim.offline import CloudPlan, record_trial, TrialPlan

BAGS = Path(__file__).resolve().parents[1] / 'bags'


@dataclass(frozen=True, slots=True)
class Scenario:
    """One synthetic bag: where it goes, what is pushed, how, and what is recorded of it."""

    folder: str
    trial: str
    material: str
    config: WorldConfig
    plan: TrialPlan
    seed: int
    clouds: CloudPlan | None = None
    displacement_noise: float | None = None


def scenarios() -> Sequence[Scenario]:
    """Return what is shipped."""
    cell = load_config()
    fast = replace(
        cell,
        load_cell=replace(cell.load_cell, rate=250.0),
        arm=replace(cell.arm, state_rate=100.0),
    )
    slow = replace(
        cell,
        load_cell=replace(cell.load_cell, rate=100.0),
        arm=replace(cell.arm, state_rate=50.0),
    )
    # A smaller block, tool and view: enough points on the dent in a cloud of a few kB.
    small = replace(
        slow,
        block=replace(cell.block, length=0.048, width=0.036, height=0.020, rim_width=0.004),
        arm=replace(slow.arm, tool_radius=0.008, start_height=0.042),
        range_sensor=replace(cell.range_sensor, rate=5.0, field_of_view=0.21, table_size=0.070),
    )
    return (
        Scenario(
            'synthetic_soft_block',
            'speed_5mm_s_depth_8mm',
            'soft_dough',
            fast,
            TrialPlan(push_speed=0.005, depth=0.008, hold_time=8.0, recover_time=3.0),
            seed=11,
            displacement_noise=5e-5,
        ),
        Scenario(
            'synthetic_soft_block',
            'speed_2mm_s_depth_6mm',
            'soft_dough',
            slow,
            TrialPlan(push_speed=0.002, depth=0.006, hold_time=8.0, recover_time=3.0),
            seed=12,
            displacement_noise=5e-5,
        ),
        Scenario(
            'synthetic_stiff_block',
            'speed_5mm_s_depth_5mm',
            'spring2',
            slow,
            TrialPlan(push_speed=0.005, depth=0.005, hold_time=2.0, recover_time=3.0),
            seed=13,
            displacement_noise=5e-5,
        ),
        Scenario(
            'synthetic_clouds',
            'speed_5mm_s_depth_5mm',
            'soft_dough',
            small,
            TrialPlan(push_speed=0.005, depth=0.005, hold_time=6.0, recover_time=2.5),
            seed=14,
            clouds=CloudPlan(width=48, height=36, depth_noise=0.0003),
        ),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Make the bags; replace those of the same name."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, default=BAGS, help='folder of the bags')
    out: Path = parser.parse_args(argv).out
    for scenario in scenarios():
        path = out / scenario.folder / scenario.trial
        try:
            shutil.rmtree(path, ignore_errors=True)
            record_trial(
                path,
                scenario.config,
                scenario.config.material(scenario.material),
                scenario.plan,
                seed=scenario.seed,
                clouds=scenario.clouds,
                displacement_noise=scenario.displacement_noise,
            )
        except HapticVisionError as error:
            print(f'{path}: {error}', file=sys.stderr)
            return error.exit_code
        size = sum(file.stat().st_size for file in path.iterdir())
        print(f'{path}: {size / 1000:.0f} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())

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


"""The shipped synthetic bags are what their script makes."""

import os
from pathlib import Path
import subprocess
import sys

from hapticvision_ros.bag.reader import read_trial
import numpy as np

REPOSITORY = Path(__file__).parents[2]


def test_the_script_makes_the_shipped_bags_again(tmp_path: Path) -> None:
    script = REPOSITORY / 'tools' / 'make_synthetic_bags.py'
    subprocess.run(
        [sys.executable, script, '--out', tmp_path],
        check=True,
        stdout=subprocess.DEVNULL,
        env=os.environ | {'OMP_NUM_THREADS': '1'},
    )
    shipped = sorted((REPOSITORY / 'bags').glob('synthetic_*/*'))
    names = [path.relative_to(REPOSITORY / 'bags') for path in shipped]
    assert [path.relative_to(tmp_path) for path in sorted(tmp_path.glob('*/*'))] == names
    assert names
    for name in names:
        old = read_trial(REPOSITORY / 'bags' / name)
        new = read_trial(tmp_path / name)
        assert old.provenance['seed'] == new.provenance['seed']
        assert old.displacement_height is not None
        assert new.displacement_height is not None
        for before, after in (
            (old.force, new.force),
            (old.tool_height, new.tool_height),
            (old.displacement_height, new.displacement_height),
        ):
            # Another processor may round otherwise in the last digits.
            np.testing.assert_allclose(after.t, before.t, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(after.value, before.value, rtol=0.0, atol=2e-6)

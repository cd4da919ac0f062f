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

"""Configuration files that differ from the package's own."""

from pathlib import Path

from hapticvision_ros.cli.configuration import write_config
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.share import share_folder
import pytest
import yaml


def test_what_is_not_changed_is_as_in_the_package(tmp_path: Path) -> None:
    arm, world = 'arm_push_controller.yaml', 'sim_world.yaml'
    changes = {arm: {'stale_time': 1.5}, world: {'arm': {'watchdog': 0.05}}}
    write_config(tmp_path / 'config', changes)
    own, written = (
        [yaml.safe_load((folder / name).read_text()) for name in (arm, world)]
        for folder in (share_folder() / 'config', tmp_path / 'config')
    )
    assert written[0]['/**']['ros__parameters'].pop('stale_time') == 1.5
    assert written[1]['arm'].pop('watchdog') == 0.05
    del own[0]['/**']['ros__parameters']['stale_time'], own[1]['arm']['watchdog']
    assert written == own


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(InputError, match='choose another --out'):
        write_config(tmp_path / 'file' / 'config', {})

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

"""Configuration files that differ from the package's own in a few values."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.share import share_folder


def write_config(folder: Path, changes: Mapping[str, Mapping[str, Any]]) -> None:
    """
    Write files of the package's configuration with some values changed.

    Parameters
    ----------
    folder : Path
        Where they go; it is not there yet.
    changes : mapping of str to mapping
        New values by the names of the files: parameters of a node, or sections of the simulated
        world with what changes in them.

    Raises
    ------
    InputError
        If they cannot be written.

    """
    import yaml

    own = share_folder() / 'config'
    try:
        folder.mkdir(parents=True)
        for name, values in changes.items():
            content = yaml.safe_load((own / name).read_text(encoding='utf-8'))
            settings = content['/**']['ros__parameters'] if '/**' in content else content
            for key, value in values.items():
                if isinstance(value, Mapping):
                    settings[key].update(value)
                else:
                    settings[key] = value
            (folder / name).write_text(yaml.safe_dump(content), encoding='utf-8')
    except OSError as error:
        raise InputError(
            f'{folder} cannot be written ({error.strerror}): choose another --out.'
        ) from error

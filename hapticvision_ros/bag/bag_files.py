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


"""Finds the storage files of a bag: a bare ``.mcap`` file or a rosbag2 directory."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hapticvision_ros.core.errors import InputError
import yaml


@dataclass(frozen=True, slots=True)
class BagFiles:
    """
    The storage files of a bag.

    Parameters
    ----------
    name : str
        What a person calls the bag.
    files : tuple of Path
        The MCAP files, in the order of recording.
    message_count : int or None
        How many messages ``metadata.yaml`` promises.
    warnings : tuple of str
        What is wrong with the directory.

    """

    name: str
    files: tuple[Path, ...]
    message_count: int | None
    warnings: tuple[str, ...]


def find_files(path: Path) -> BagFiles:
    """
    Return the storage files of a bag.

    Parameters
    ----------
    path : Path
        A bare ``.mcap`` file or a rosbag2 directory, with or without ``metadata.yaml``.

    Raises
    ------
    InputError
        If there is no such path, or the directory is not one bag with MCAP storage.

    """
    if not path.is_dir():
        if not path.exists():
            raise InputError(f'{path} does not exist: give a .mcap file or a rosbag2 directory')
        if not path.is_file():
            # Opening a pipe waits for its other end, and its bytes cannot be read twice.
            raise InputError(f'{path} is a pipe or a device: write the bag to a file first')
        return BagFiles(path.stem, (path,), None, ())
    present = sorted(path.glob('*.mcap'))
    if not present:
        raise InputError(f'{path} is no MCAP bag: {_what_else(path)}')
    warnings: list[str] = []
    listed, message_count = _listed(path, warnings)
    files = tuple(file for file in listed if file in present)
    if len(files) < len(listed):
        lost = ', '.join(file.name for file in listed if file not in present)
        warnings.append(f'metadata.yaml lists files that are not there: {lost}')
    if not files:
        files = _unlisted(path, present)
        message_count = None
    elif len(files) < len(present):
        extra = ', '.join(file.name for file in present if file not in files)
        warnings.append(f'files that metadata.yaml does not list were left out: {extra}')
    return BagFiles(path.resolve().name, files, message_count, tuple(warnings))


def _what_else(path: Path) -> str:
    """Say what a directory without MCAP files holds, and what to do."""
    if any(path.glob('*.db3')):
        return 'it has SQLite storage, convert it with "ros2 bag convert" to MCAP storage'
    if any(path.glob('*.mcap.zstd')):
        return 'its files are compressed as a whole, decompress them with "zstd -d" first'
    if any(path.glob('*/*.mcap')):
        return 'it holds bags in directories of their own, name one of these'
    return 'it holds no .mcap file'


def _listed(path: Path, warnings: list[str]) -> tuple[list[Path], int | None]:
    """Return the files and the number of messages that ``metadata.yaml`` tells of."""
    metadata = path / 'metadata.yaml'
    if not metadata.exists():
        return [], None
    try:
        information: Any = yaml.safe_load(metadata.read_text(encoding='utf-8'))
        information = information['rosbag2_bagfile_information']
        # Old rosbag2 versions put the bag's directory before the name.
        names = [Path(str(name)).name for name in information['relative_file_paths']]
        count = information.get('message_count')
    except (OSError, ValueError, TypeError, KeyError, AttributeError, yaml.YAMLError):
        warnings.append('metadata.yaml cannot be understood: the .mcap files were read without it')
        return [], None
    return [path / name for name in dict.fromkeys(names)], count if type(count) is int else None


def _unlisted(path: Path, present: list[Path]) -> tuple[Path, ...]:
    """Return the files of a directory as one bag if they are one, or the parts of one."""
    if len(present) == 1:
        return tuple(present)
    stem = present[0].stem.rpartition('_')[0]
    parts = tuple(path / f'{stem}_{number}.mcap' for number in range(len(present)))
    if set(parts) == set(present):
        return parts
    raise InputError(
        f'{path} holds {len(present)} .mcap files and no metadata.yaml that lists them: name the '
        'bags one by one'
    )

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

"""Files are written whole or not at all."""

from collections.abc import Iterator
import os
from pathlib import Path

from hapticvision_ros.report.writing import write_whole
import pytest


def test_files_that_fail_in_the_middle_leave_what_was_there(tmp_path: Path) -> None:
    folder = tmp_path / 'new'
    write_whole(folder, [('one', b'old'), ('two', b'old')])

    def contents() -> Iterator[tuple[str, bytes]]:
        yield 'one', b'new'
        raise OSError(28, 'No space left on device')

    with pytest.raises(OSError, match='No space'):
        write_whole(folder, contents())
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == {
        'one': b'old',
        'two': b'old',
    }


@pytest.mark.parametrize(('mask', 'mode'), [(0o077, 0o600), (0o022, 0o644)])
def test_others_may_read_what_the_user_lets_them(tmp_path: Path, mask: int, mode: int) -> None:
    before = os.umask(mask)
    try:
        write_whole(tmp_path, [('one', b'')])
    finally:
        os.umask(before)
    assert (tmp_path / 'one').stat().st_mode & 0o777 == mode

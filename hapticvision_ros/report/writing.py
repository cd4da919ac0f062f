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

"""Files that a reader finds as they were or as they are meant to be, and nothing in between."""

from collections.abc import Iterable
from contextlib import suppress
import os
from pathlib import Path
import tempfile


def as_bytes(text: str) -> bytes:
    """Return a text for a file; what a file's name holds that is no UTF-8 is written out."""
    return text.encode(errors='backslashreplace')


def write_whole(folder: Path, files: Iterable[tuple[str, bytes]]) -> None:
    """
    Write files into a folder: none is seen before all of them lie on the disk.

    Parameters
    ----------
    folder : Path
        Where they go; it is made if it is not there.
    files : iterable of tuple of (str, bytes)
        Names and contents; what stands under a name is replaced.

    Raises
    ------
    OSError
        If they cannot be written; then no draft is left.

    """
    folder.mkdir(parents=True, exist_ok=True)
    drafts: list[tuple[Path, Path]] = []
    try:
        for name, content in files:
            handle, draft = tempfile.mkstemp(dir=folder, prefix=f'.{name}.')
            drafts.append((Path(draft), folder / name))
            with os.fdopen(handle, 'wb') as stream:
                stream.write(content)
        # mkstemp makes a file for its owner alone; these are made like any other file.
        mask = os.umask(0)
        os.umask(mask)
        for made, path in drafts:
            made.chmod(0o666 & ~mask)
            made.replace(path)
    except BaseException:
        for made, _ in drafts:
            with suppress(OSError):
                made.unlink()
        raise

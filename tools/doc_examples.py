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
Runs the Python examples of the documentation and writes what they print beneath them.

A block of Python is followed by a block of its output. The blocks of a page share their names, and
run at the root of the repository. Run it without arguments after a change; a test compares.
"""

from collections.abc import Iterator
from contextlib import redirect_stdout
import io
import os
from pathlib import Path
import re
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
PAGES: Final = ('README.md', 'doc/notebook.md', 'doc/diagnosis.md')

_EXAMPLE: Final = re.compile(r'(```python\n)(.*?)(```\n\n```\n)(.*?)(```\n)', re.DOTALL)


def examples(text: str) -> Iterator[tuple[str, str]]:
    """Yield code and output of each example of a page."""
    for match in _EXAMPLE.finditer(text):
        yield match[2], match[4]


def run(code: str, names: dict[str, object], source: str) -> str:
    """Run an example with the names of those before it, and return what it prints."""
    printed = io.StringIO()
    before = Path.cwd()
    os.chdir(ROOT)
    try:
        with redirect_stdout(printed):
            exec(compile(code, source, 'exec'), names)
    finally:
        os.chdir(before)
    return printed.getvalue()


def renewed(page: str) -> str:
    """Return a page with what its examples print now."""
    names: dict[str, object] = {}

    def replaced(match: re.Match[str]) -> str:
        return match[1] + match[2] + match[3] + run(match[2], names, page) + match[5]

    return _EXAMPLE.sub(replaced, (ROOT / page).read_text())


if __name__ == '__main__':
    for name in PAGES:
        text = renewed(name)
        (ROOT / name).write_text(text)

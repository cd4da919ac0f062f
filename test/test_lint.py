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


"""The house rules that a machine can hold: style, types, layers, licence headers."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parent.parent
BIN = Path(sys.executable).parent
SOURCES = ('hapticvision_ros', 'test', 'tools', 'bench', 'launch')
HEADER = (ROOT / 'setup.py').read_text().partition('\n\n')[0]


def _assert_clean(*command: str | Path) -> None:
    done = subprocess.run(
        [*map(str, command)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f'{done.stdout}\n{done.stderr}'


def test_style_is_that_of_ament_flake8_and_ament_pep257() -> None:
    # setup.cfg holds their rules; flake8-docstrings runs pydocstyle, as ament_pep257 does.
    _assert_clean(sys.executable, '-m', 'flake8')


def test_ruff_finds_nothing() -> None:
    _assert_clean(BIN / 'ruff', 'check', '.')


def test_code_is_laid_out_by_ruff() -> None:
    _assert_clean(BIN / 'ruff', 'format', '--check', '.')


def test_types_are_strict_and_fit() -> None:
    _assert_clean(sys.executable, '-m', 'mypy')


def test_imports_point_one_way() -> None:
    _assert_clean(BIN / 'lint-imports')


def _files() -> list[Path]:
    return [
        path
        for folder in SOURCES
        for pattern in ('*.py', '*.sh')
        for path in sorted((ROOT / folder).rglob(pattern))
    ]


@pytest.mark.parametrize('path', _files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_each_source_file_starts_with_its_licence(path: Path) -> None:
    text = path.read_text()
    if text.startswith('#!'):
        text = text.partition('\n')[2]
    assert text.startswith(HEADER), 'copy the header of setup.py'


def test_the_header_is_the_licence_of_the_package() -> None:
    assert 'Licensed under the Apache License, Version 2.0' in HEADER
    assert 'Version 2.0, January 2004' in (ROOT / 'LICENSE').read_text()

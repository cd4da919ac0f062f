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


"""What a user installs: the manifest, the wheel and the set-up script."""

import ast
from collections.abc import Iterator
from configparser import ConfigParser
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zipfile

import pytest

ROOT = Path(__file__).resolve().parent.parent
NAME = 'hapticvision_ros'
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()
ROS_PACKAGES = re.compile(r'rclpy|launch\w*|ament_\w+|std_srvs|\w+_(msgs|interfaces)')
MODULE_OF = {
    'opencv-python-headless': 'cv2',
    'pyserial': 'serial',
    'pyyaml': 'yaml',
    'ros-jazzy-rclpy': 'rclpy',
}
"""Requirements whose module has another name."""
WITHOUT_MODULE = {
    'ros-jazzy-common-interfaces': 'std_msgs',
    'ros-jazzy-rmw-fastrtps-cpp': None,
}
"""A bundle of message packages, and the middleware that rclpy loads by itself."""
KEY_OF = {'cv2': 'python3-opencv', 'rosbags': 'python3-rosbags-pip'} | dict.fromkeys(
    ('mcap', 'lz4', 'zstandard'), 'mcap-ros2-support'
)
"""Modules whose rosdep key is not ``python3-<module>``."""


def _imports(*folders: str) -> set[str]:
    """Return the top-level modules that the package imports, ``import``s in functions included."""
    found = set()
    for folder in folders:
        for path in (ROOT / folder).rglob('*.py'):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition('.')[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module:
                    found.add(node.module.partition('.')[0])
    return found - sys.stdlib_module_names - {NAME}


def _requirements() -> list[str]:
    lines = (ROOT / 'requirements.in').read_text().partition('# What checks.')[0].splitlines()
    return [line for line in lines if not line.startswith('#')]


def test_the_manifest_is_one_of_format_3() -> None:
    # REP-149; ament_xmllint checks the same against the schema, which is not shipped here.
    assert (MANIFEST.tag, MANIFEST.get('format')) == ('package', '3')
    for tag in ('name', 'version', 'description'):
        assert len(MANIFEST.findall(tag)) == 1
    assert MANIFEST.findtext('name') == NAME
    assert re.fullmatch(r'\d+\.\d+\.\d+', MANIFEST.findtext('version', ''))
    assert all(person.get('email') for person in MANIFEST.findall('maintainer'))
    for licence in MANIFEST.findall('license'):
        assert (ROOT / licence.attrib['file']).is_file()
    assert MANIFEST.findtext('export/build_type') == 'ament_python'
    depends = [(e.tag, e.text) for e in MANIFEST if e.tag.endswith('_depend')]
    assert len(depends) == len(set(depends))


def test_the_manifest_declares_each_package_that_is_imported() -> None:
    declared = {element.text for element in MANIFEST.findall('exec_depend')}
    for module in _imports(NAME, 'launch'):
        ros = ROS_PACKAGES.fullmatch(module)
        key = module if ros else KEY_OF.get(module, f'python3-{module}')
        assert key in declared, f'{module} is imported: declare {key} in package.xml'


def test_each_requirement_is_used_and_each_import_is_required() -> None:
    requirements = _requirements()
    modules = {MODULE_OF.get(n, n) for n in requirements if n not in WITHOUT_MODULE}
    imported = _imports(NAME)
    assert modules <= imported, 'a requirement that nothing imports'
    others = {module for module in imported if not ROS_PACKAGES.fullmatch(module)}
    assert others <= modules, 'an import that requirements.in does not name'


def test_the_lock_file_pins_each_requirement_with_hashes() -> None:
    blocks = re.split(r'\n(?=\S)', (ROOT / 'requirements.lock').read_text())
    pinned = {block.partition('==')[0].lower(): block for block in blocks}
    for line in (ROOT / 'requirements.in').read_text().splitlines():
        name = re.split(r'[<>=!~ #]', line)[0].lower()
        if name:
            assert '--hash=sha256:' in pinned[name]


def test_the_changelog_starts_with_the_version_of_the_manifest() -> None:
    first = re.search(r'^(\d+\.\d+\.\d+|Forthcoming)\b.*\n-+$', _changelog(), re.MULTILINE)
    assert first
    assert first[1] in ('Forthcoming', MANIFEST.findtext('version'))


def _changelog() -> str:
    return (ROOT / 'CHANGELOG.rst').read_text()


@pytest.fixture(scope='module')
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[zipfile.ZipFile]:
    """Build a wheel from a copy, so that the checkout stays as it is."""
    source = tmp_path_factory.mktemp('wheel') / 'source'
    unwanted = shutil.ignore_patterns('.*', 'out', 'build', '__pycache__', '*.egg-info')
    shutil.copytree(ROOT, source, ignore=unwanted)
    build = 'from setuptools import build_meta; build_meta.build_wheel(".")'
    subprocess.run([sys.executable, '-c', build], cwd=source, check=True, capture_output=True)
    (built,) = source.glob('*.whl')
    with zipfile.ZipFile(built) as archive:
        yield archive


def test_the_wheel_holds_all_that_the_package_reads(wheel: zipfile.ZipFile) -> None:
    names = {name.partition('.data/data/')[2] or name for name in wheel.namelist()}
    package = ROOT / NAME
    for path in package.rglob('*'):
        if path.is_file() and '__pycache__' not in path.parts:
            assert str(path.relative_to(ROOT)) in names
    for folder, pattern in (
        ('config', '*.*'),
        ('config/layouts', '*'),
        ('config/sros2', '*'),
        ('launch', '*.launch.py'),
        ('msg_docs', '*.md'),
    ):
        files = sorted((ROOT / folder).glob(pattern))
        assert files
        for path in files:
            assert f'share/{NAME}/{folder}/{path.name}' in names
    assert f'share/{NAME}/package.xml' in names
    assert f'share/ament_index/resource_index/packages/{NAME}' in names


def test_each_executable_of_the_wheel_has_its_function(wheel: zipfile.ZipFile) -> None:
    (path,) = (name for name in wheel.namelist() if name.endswith('entry_points.txt'))
    parser = ConfigParser()
    parser.read_string(wheel.read(path).decode())
    assert 'hapticvision' in parser['console_scripts']
    for target in parser['console_scripts'].values():
        module, _, function = target.partition(':')
        tree = ast.parse(wheel.read(f'{module.replace(".", "/")}.py'))
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a copy of what the set-up script needs, in a folder with a space in its name."""
    folder = tmp_path / 'a check out'
    (folder / 'tools').mkdir(parents=True)
    shutil.copy(ROOT / 'tools' / 'setup.sh', folder / 'tools')
    shutil.copy(ROOT / 'requirements.lock', folder)
    (folder / 'home').mkdir()
    (folder / 'bin').mkdir()
    return folder


def _program(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'#!/bin/sh\n{text}\n')
    path.chmod(0o755)
    return path


def _set_up(checkout: Path, **environment: str) -> str:
    """Run the set-up where it must fail, with next to no environment; return what it says."""
    poor = {'PATH': f'{checkout}/bin:/usr/bin:/bin', 'HOME': f'{checkout}/home'}
    done = subprocess.run(
        [str(checkout / 'tools' / 'setup.sh')],
        env=poor | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert not (checkout / '.venv' / 'lock.stamp').exists()
    return done.stderr


def test_set_up_says_that_a_named_python_does_not_run(checkout: Path) -> None:
    said = _set_up(checkout, PYTHON='/nowhere/python3.12')
    assert said == 'setup: PYTHON=/nowhere/python3.12 is not a Python 3.12 that runs.\n'


def test_set_up_says_that_there_are_no_wheels_for_the_machine(checkout: Path) -> None:
    _program(checkout / 'bin' / 'uname', '[ "$1" = -m ] && echo aarch64 || echo Linux')
    said = _set_up(checkout)
    assert said == (
        'setup: this is Linux on aarch64, and the ROS 2 wheels exist for Linux on x86_64 only.\n'
    )


def test_set_up_passes_over_shims_and_says_that_the_venv_module_is_missing(checkout: Path) -> None:
    for name in ('python3', 'python3.12', 'uv'):
        _program(checkout / 'bin' / name, 'echo "shim: no such version" >&2; exit 127')
    python = checkout / 'home' / '.pyenv' / 'versions' / '3.12.9' / 'bin' / 'python3.12'
    _program(python, 'case "$2" in *ensurepip*) exit 1;; *) echo "$0";; esac')
    said = _set_up(checkout)
    assert said == (
        f"setup: {python} lacks its venv module: run 'apt install python3.12-venv', "
        'or install uv.\n'
    )


def test_set_up_without_network_says_so_and_leaves_nothing_that_passes_for_done(
    checkout: Path,
) -> None:
    said = _set_up(
        checkout,
        PYTHON=os.path.realpath(sys.executable),
        PIP_CONFIG_FILE='/dev/null',
        PIP_INDEX_URL='http://127.0.0.1:9/simple',
        PIP_RETRIES='0',
    )
    assert said.startswith('setup: the package index cannot be reached; connect to the network')
    assert said.count('\n') == 1


def test_the_script_that_compiles_the_kernels_calls_what_there_is() -> None:
    """The set-up goes on without it, so that nothing else shows when it fails."""
    script = str(ROOT / 'tools' / 'compile_kernels.py')
    done = subprocess.run(
        [sys.executable, script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr

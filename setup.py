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

from pathlib import Path
import xml.etree.ElementTree as ElementTree

from setuptools import find_namespace_packages, setup

# Through the link that `colcon build --symlink-install` makes.
HERE = Path(__file__).resolve().parent
NAME = 'hapticvision_ros'
MANIFEST = ElementTree.parse(HERE / 'package.xml').getroot()

NODES = (
    'range_sensor_driver',
    'load_cell_driver',
    'arm_push_controller',
    'contact_point_planner',
    'phase_segmenter',
    'rheology_fitter',
    'experiment_orchestrator',
)

WHAT_RUNS = (HERE / 'requirements.in').read_text().partition('# What checks.')[0]
REQUIREMENTS = [line for line in WHAT_RUNS.splitlines() if not line.startswith('#')]
TOOLS = ('bag_player', 'experiment_client', 'velocity_watchdog')


def shared(folder: str, pattern: str) -> tuple[str, list[str]]:
    """Return the entry that installs a folder's files into the package's share."""
    files = sorted(str(path.relative_to(HERE)) for path in (HERE / folder).glob(pattern))
    return f'share/{NAME}/{folder}', files


setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=MANIFEST.findtext('description'),
    license=MANIFEST.findtext('license'),
    packages=find_namespace_packages(
        include=[NAME, f'{NAME}.*'], exclude=['*.__pycache__', '*.__pycache__.*']
    ),
    package_data={NAME: ['py.typed'], f'{NAME}.report.templates': ['*'], f'{NAME}.sim': ['*.c']},
    include_package_data=True,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        shared('launch', '*.launch.py'),
        shared('config', '*.*'),
        shared('config/layouts', '*'),
        shared('config/sros2', '*'),
        shared('msg_docs', '*.md'),
    ],
    # Where ROS is installed already, its own Python packages must not be shadowed by wheels.
    install_requires=[name for name in REQUIREMENTS if not name.startswith('ros-')],
    extras_require={'ros': [name for name in REQUIREMENTS if name.startswith('ros-')]},
    python_requires='>=3.12',
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'hapticvision = hapticvision_ros.cli.main:main',
            'simulated_world = hapticvision_ros.sim.server:main',
            'emulate_net_ft = hapticvision_ros.sim.emulators.net_ft:main',
            'emulate_serial_cell = hapticvision_ros.sim.emulators.serial_cell:main',
            *(f'{node} = {NAME}.nodes.start:main' for node in (*NODES, *TOOLS)),
        ],
    },
)

from pathlib import Path
import xml.etree.ElementTree as ElementTree

from setuptools import find_packages, setup

HERE = Path(__file__).parent
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


def shared(folder: str, pattern: str) -> tuple[str, list[str]]:
    """Return the entry that installs a folder's files into the package's share."""
    files = sorted(str(path.relative_to(HERE)) for path in (HERE / folder).glob(pattern))
    return f'share/{NAME}/{folder}', files


setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=MANIFEST.findtext('description'),
    license=MANIFEST.findtext('license'),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'report/templates/*']},
    include_package_data=True,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        shared('launch', '*.launch.py'),
        shared('config', '*'),
        shared('msg_docs', '*.md'),
    ],
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'hapticvision = hapticvision_ros.cli.main:main',
            'simulated_world = hapticvision_ros.sim.server:main',
            *(f'{node} = {NAME}.nodes.{node}:main' for node in NODES),
        ],
    },
)

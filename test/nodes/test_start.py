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

"""The process of a node before the node has handlers of its own, and its first words."""

import os
import signal
import subprocess
import sys

from hapticvision_ros.cli.processes import program
from hapticvision_ros.nodes.runtime import stay_on_this_machine
import pytest

INTERRUPT = """
import signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == '{at}':
            print('interrupted', flush=True)
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
sys.argv = ['load_cell_driver']
"""
ALONE = 'from hapticvision_ros.nodes.start import main\nsys.exit(main())'


@pytest.mark.parametrize(
    ('code', 'at'),
    [
        (ALONE, 'rclpy'),
        (program('hapticvision_ros.nodes.load_cell_driver')[2], 'hapticvision_ros.cli.processes'),
    ],
    ids=['alone', 'by the supervisor'],
)
def test_a_node_that_is_interrupted_while_it_imports_says_nothing(code, at) -> None:
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPT.format(at=at) + code],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.stdout, done.stderr) == ('interrupted\n', '')
    assert done.returncode == -signal.SIGINT


WARN = """
import time
from hapticvision_ros.nodes.load_cell_driver import NAME, PARAMETERS
from hapticvision_ros.nodes.runtime import CellNode
import rclpy
rclpy.init(args=[])
node = CellNode(NAME, PARAMETERS)
for _ in range(2):
    began = time.thread_time()
    node.get_logger().warning('a gap')
    print(time.thread_time() - began)
"""


def test_the_first_warning_of_a_node_does_not_keep_its_thread_from_a_sensor() -> None:
    # It looked for its caller in all modules: 40 times as long as the next one.
    done = subprocess.run(
        [sys.executable, '-c', WARN], capture_output=True, text=True, timeout=60, check=True
    )
    first, second = map(float, done.stdout.split())
    assert first < 10.0 * second


DISCOVERY = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY')
RANGE = """
import os
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.nodes.runtime import run
def tell():
    print(os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'))
    raise UsageError('that is all.')
run(tell, [])
"""


@pytest.mark.parametrize(
    ('said', 'expected'),
    [
        ({}, 'LOCALHOST'),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': ''}, 'LOCALHOST'),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}, 'OFF'),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, 'SUBNET'),
        ({'ROS_STATIC_PEERS': '192.168.1.2'}, None),
        ({'ROS_LOCALHOST_ONLY': '0'}, None),
    ],
)
def test_discovery_stays_on_this_machine_unless_the_user_says_otherwise(said, expected) -> None:
    environment = dict(said)
    stay_on_this_machine(environment)
    assert environment == said | ({} if expected is None else {DISCOVERY[0]: expected})


def test_a_node_has_chosen_its_discovery_before_ros_starts() -> None:
    environment = {name: value for name, value in os.environ.items() if name not in DISCOVERY}
    done = subprocess.run(
        [sys.executable, '-c', RANGE],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.stdout, done.stderr) == ('LOCALHOST\n', 'error: that is all.\n')

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

import signal
import subprocess
import sys

from hapticvision_ros.cli.processes import program
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

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

"""The process of a node before the node has handlers of its own."""

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

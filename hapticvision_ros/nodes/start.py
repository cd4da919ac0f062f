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
Where the process of a node starts, under the name of the node.

What a node imports takes a second. Ctrl-C in that time ends it without a word, as long as the
node has no handlers of its own; this module therefore imports nothing of that.
"""

from importlib import import_module
from pathlib import Path
import signal
import sys


def main() -> int:
    """Run the node that the command is named after, and return the exit code of the process."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from hapticvision_ros.threads import one_thread

    one_thread()
    node = import_module(f'hapticvision_ros.nodes.{Path(sys.argv[0]).name}')
    code: int = node.main()
    return code

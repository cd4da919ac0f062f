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


"""What holds for all tests."""

import os
from pathlib import Path
import signal

import pytest

# Read when numpy is imported, here and by the processes that tests start: the matrices are small,
# and threads inside each product would only get into each other's way.
os.environ.setdefault('OMP_NUM_THREADS', '1')

# A shell that starts the tests in the background has them ignore SIGINT, and every process that a
# test starts and interrupts would ignore it as well, and never end.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

HERE = Path(__file__).parent
LIVE = (
    'nodes',
    'replay',
    'cli/test_cell',
    'cli/test_demo',
    'cli/test_faults',
    'cli/test_replay',
    'sim/test_faults',
    'sim/test_server',
)
"""Tests of processes that work in real time, one after the other."""
PATIENT = (
    'nodes/test_contact_point_planner',
    'nodes/test_phase_segmenter',
    'nodes/test_range_',
    'nodes/test_rheology_fitter',
    'replay',
    'cli/test_replay',
)
"""Those of them that do not hang on how fast an arm is stopped: they may run beside the others."""
TOGETHER = ('report', 'core/diagnosis')
"""Folders whose tests share what takes long to make."""
LONG = ('test_lint', 'test_doc_examples', 'core/diagnosis', 'report', 'test_package', 'cli')
"""Files that take long, so that they do not come last."""
YIELDS = 10
"""By how much the other tests are nicer than those that work in real time."""


def _place(item: pytest.Item) -> str:
    return item.path.relative_to(HERE).as_posix()


def _is_live(item: pytest.Item) -> bool:
    return _place(item).startswith(LIVE) and not _is_patient(item)


def _is_patient(item: pytest.Item) -> bool:
    return _place(item).startswith(PATIENT)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """
    Let what shares fixtures be run by one worker, and all live tests by one, or by two.

    That one begins with them, the others with what takes long, and the patient ones next.
    """
    if not config.pluginmanager.hasplugin('xdist'):
        return
    for item in items:
        place = _place(item)
        together = [folder for folder in TOGETHER if place.startswith(folder)]
        group = 'live' if _is_live(item) else together[0] if together else place
        if _is_patient(item):
            group = 'patient'
        item.add_marker(pytest.mark.xdist_group(group))
    if 'PYTEST_XDIST_WORKER' in os.environ:
        items.sort(key=_turn)


def _turn(item: pytest.Item) -> int:
    if _is_live(item):
        return 0
    if _is_patient(item):
        return 2
    return 1 if _place(item).startswith(LONG) else 3


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Lower the priority of a worker whose first test is not live, once."""
    if 'PYTEST_XDIST_WORKER' not in os.environ or item.config.stash.get(_BEGUN, False):
        return
    item.config.stash[_BEGUN] = True
    if not _is_live(item):
        os.nice(YIELDS)


_BEGUN = pytest.StashKey[bool]()

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

"""The recorder of trials: the bag, its mark, and what happens when the disk fails."""

import errno
import time

from hapticvision_ros.bag.cdr import encode_float64, encode_wrench
from hapticvision_ros.bag.contract import DISPLACEMENT_HEIGHT, TOOL_HEIGHT, WRENCH
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.bag.writer import BagWriter
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.nodes.recorder import (
    check_room,
    missing_topics,
    Recording,
    writable_folder,
)
import pytest

ROOM = 1 << 20
START = 1_700_000_000_000_000_000


def fill(recording: Recording) -> None:
    """Write ten samples of each stream."""
    for index in range(10):
        stamp = START + index * 1_000_000
        wrench = encode_wrench(stamp, 'load_cell', (0.0, 0.0, -1.0), (0.0, 0.0, 0.0))
        recording.write(WRENCH, wrench, stamp, stamp)
        recording.write(TOOL_HEIGHT, encode_float64(0.05), stamp, stamp)
        recording.write(DISPLACEMENT_HEIGHT, encode_float64(0.0), stamp, stamp)


def test_a_recorded_trial_is_read_back_with_its_provenance(tmp_path):
    recording = Recording(tmp_path / 'trial', {'source': 'test'}, ROOM)
    fill(recording)
    assert not missing_topics(recording.counts)
    recording.close({'outcome': 'complete'})
    recording.join(10.0)
    assert recording.closed
    assert recording.error is None
    trial = read_trial(tmp_path / 'trial')
    assert len(trial.force) == 10
    assert trial.provenance['source'] == 'test'


def test_a_trial_of_no_use_is_kept_under_a_marked_name(tmp_path):
    recording = Recording(tmp_path / 'trial', {}, ROOM)
    fill(recording)
    recording.close({'outcome': 'aborted'}, '_aborted')
    recording.join(10.0)
    assert recording.path == tmp_path / 'trial_aborted'
    assert len(read_trial(recording.path).force) == 10


def test_a_bag_that_exists_is_never_overwritten(tmp_path):
    (tmp_path / 'trial').mkdir()
    recording = Recording(tmp_path / 'trial', {}, ROOM)
    recording.join(10.0)
    assert recording.error is not None
    assert 'exists already' in recording.error


def test_a_disk_that_is_too_slow_is_told_in_a_sentence(tmp_path):
    recording = Recording(tmp_path / 'trial', {}, capacity=10)
    fill(recording)
    assert recording.error is not None
    assert 'fast enough' in recording.error
    recording.close({'outcome': 'aborted'})
    end = time.monotonic() + 10.0
    while not recording.closed and time.monotonic() < end:
        recording.join(0.1)
    assert recording.closed


def test_a_bag_that_a_defect_has_ended_is_marked(tmp_path, monkeypatch):
    def fails(*_: object) -> None:
        raise ValueError('a defect')

    monkeypatch.setattr(BagWriter, 'write_raw', fails)
    recording = Recording(tmp_path / 'trial', {}, ROOM)
    fill(recording)
    recording.close({'outcome': 'complete'})
    recording.join(10.0)
    assert recording.closed
    assert recording.error is not None
    assert 'ValueError: a defect' in recording.error
    assert recording.path.name != 'trial'


def test_what_a_trial_lacks_is_named():
    assert missing_topics({}) == [
        '/load_cell/wrench',
        '/arm/tool_height',
        '/range_sensor/points or /object/displacement_height',
    ]


def test_a_folder_that_holds_one_of_the_bags_is_refused(tmp_path):
    (tmp_path / 'trial_001_aborted').mkdir()
    with pytest.raises(InputError, match='exists already'):
        writable_folder(str(tmp_path), ['trial_001'])
    assert writable_folder(str(tmp_path / 'new'), ['trial_001']).is_dir()


def test_an_empty_output_folder_is_refused():
    with pytest.raises(InputError, match='output_folder is empty'):
        writable_folder('', [])


def test_a_bag_that_meets_a_full_disk_is_marked_and_what_it_holds_reads_back(
    tmp_path, monkeypatch
):
    flush = BagWriter.flush

    def fails(self):
        flush(self)
        if self.message_count >= 30:
            raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('hapticvision_ros.bag.writer.FLUSH_PERIOD_S', 0.0)
    monkeypatch.setattr(BagWriter, 'flush', fails)
    recording = Recording(tmp_path / 'trial', {}, ROOM)
    for _ in range(2):
        fill(recording)
    recording.join(10.0)
    assert 'No space left' in recording.error
    assert recording.path == tmp_path / 'trial_aborted'
    assert len(read_trial(recording.path).force) >= 10


def test_a_disk_without_room_is_refused(tmp_path):
    check_room(tmp_path, 0)
    with pytest.raises(InputError, match='MB of room'):
        check_room(tmp_path, 1 << 60)
    with pytest.raises(InputError, match='cannot be read'):
        check_room(tmp_path / 'nowhere', 0)

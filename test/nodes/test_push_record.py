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

"""The note of a push under way: when it counts, and when it does not."""

import json

from hapticvision_ros.nodes import push_record
from hapticvision_ros.nodes.push_record import PushRecord
import pytest


@pytest.fixture
def record(tmp_path):
    return PushRecord('7/cell/arm_push_controller', 'simulated 5000', tmp_path)


def test_a_push_is_under_way_from_its_note_until_that_is_removed(record, tmp_path):
    record.remove()
    assert record.age() is None
    record.renew()
    (note,) = tmp_path.iterdir()
    assert note.name == '7.cell.arm_push_controller.push.json'
    assert 0.0 <= record.age() < 10.0
    record.remove()
    assert record.age() is None and not list(tmp_path.iterdir())


def test_the_note_ages_until_it_is_renewed(record, monkeypatch):
    record.renew()
    noted = push_record.time.monotonic()
    monkeypatch.setattr(push_record.time, 'monotonic', lambda: noted + 40.0)
    assert 40.0 <= record.age() < 50.0
    record.renew()
    assert record.age() == 0.0


def test_the_note_of_another_arm_or_cell_does_not_count(record, tmp_path):
    record.renew()
    assert PushRecord('7/cell/arm_push_controller', 'simulated 5001', tmp_path).age() is None
    assert PushRecord('7/other/arm_push_controller', 'simulated 5000', tmp_path).age() is None


def test_a_note_from_before_the_start_of_the_machine_does_not_count(record, monkeypatch):
    record.renew()
    monkeypatch.setattr(push_record, '_boot', lambda: 'another')
    assert record.age() is None


@pytest.mark.parametrize('change', [{'time': 'soon'}, {'time': 1e12}, {'arm': None}, None, []])
def test_a_note_that_makes_no_sense_moves_no_arm(record, tmp_path, change):
    record.renew()
    (path,) = tmp_path.iterdir()
    note = json.loads(path.read_text()) | change if isinstance(change, dict) else change
    path.write_text(json.dumps(note))
    assert record.age() is None
    path.write_text('{')
    assert record.age() is None


def test_what_another_user_has_noted_moves_no_arm(record, monkeypatch):
    record.renew()
    user = push_record.os.getuid()
    monkeypatch.setattr(push_record.os, 'getuid', lambda: user + 1)
    assert record.age() is None


def test_a_note_that_cannot_be_removed_keeps_no_controller_from_its_end(tmp_path):
    (tmp_path / 'file').touch()
    PushRecord('cell/arm', 'simulated', tmp_path / 'file').remove()

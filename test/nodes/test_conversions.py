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

"""Clouds of other drivers, whose layout is theirs."""

from hapticvision_ros.core.devices import RangeFrame
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.nodes.conversions import cloud_to_message, xyz_from_message
import numpy as np
import pytest

XYZ = np.arange(24, dtype=np.float32).reshape(2, 4, 3)


def test_a_missing_row_step_follows_from_the_rest():
    message = cloud_to_message(RangeFrame(0, XYZ), 'sensor')
    message.row_step = 0
    assert np.array_equal(xyz_from_message(message), XYZ)


def test_rows_may_be_padded():
    message = cloud_to_message(RangeFrame(0, XYZ), 'sensor')
    padded = np.zeros((2, 64), np.uint8)
    padded[:, :48] = np.frombuffer(bytes(message.data), np.uint8).reshape(2, 48)
    message.data = padded.tobytes()
    message.row_step = 64
    assert np.array_equal(xyz_from_message(message), XYZ)


@pytest.mark.parametrize(
    ('point_step', 'width', 'sentence'),
    [
        # Of a few bytes it would make more points than there is memory.
        (0, 4_000_000_000, 'lies outside of its point of 0 bytes'),
        (8, 4, 'lies outside of its point of 8 bytes'),
        (12, 5, 'needs 120 bytes but holds 96'),
    ],
)
def test_a_cloud_that_contradicts_itself_is_refused(point_step, width, sentence):
    message = cloud_to_message(RangeFrame(0, XYZ), 'sensor')
    message.point_step, message.row_step, message.width = point_step, 0, width
    with pytest.raises(InputError, match=sentence):
        xyz_from_message(message)

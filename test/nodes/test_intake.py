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
"""Messages that are taken when there is time for them."""

import time
from types import SimpleNamespace

from hapticvision_ros.nodes.intake import Intake
import pytest


class Handle:
    """A subscription's, with messages that have come."""

    def __init__(self, *taken) -> None:
        self.taken = list(taken)

    def __enter__(self) -> None:
        """Hold it."""

    def __exit__(self, *error) -> None:
        """Let it go."""

    def take_message(self, kind, raw):
        return self.taken.pop(0) if self.taken else None


@pytest.mark.parametrize('told', [5 * 10**17, 0])
def test_a_middleware_may_not_tell_when_a_message_arrived(told):
    handle = Handle(('a', {'source_timestamp': 7, 'received_timestamp': told}))
    intake = object.__new__(Intake)
    intake._subscription = SimpleNamespace(handle=handle, msg_type=None, raw=False)
    before = time.time_ns()
    ((message, sent_ns, received_ns),) = intake.take()
    assert (message, sent_ns) == ('a', 7)
    assert received_ns == told if told else before <= received_ns <= time.time_ns()

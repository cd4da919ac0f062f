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

"""How the fault campaign takes the answers of the cell; it runs in test/cli/test_faults.py."""

from types import SimpleNamespace

from hapticvision_ros.core.experiment import RUNNING
from hapticvision_ros.nodes import fault_campaign
from hapticvision_ros.nodes.fault_campaign import Campaign
import pytest
from rclpy.task import Future
from std_srvs.srv import Trigger


class LossyOrchestrator:
    """A client of a server that begins when it is asked, and whose first answers are lost."""

    def __init__(self, lost: int, *, running: bool = False) -> None:
        self.lost, self.running, self.asked = lost, running, 0

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, request: Trigger.Request) -> Future:
        self.asked += 1
        answer = Trigger.Response(success=not self.running, message=f'goal 7 {RUNNING}')
        self.running = True
        future = Future()
        if self.asked > self.lost:
            future.set_result(answer)
        return future

    def remove_pending_request(self, future: Future) -> None:
        assert not future.done()


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    monkeypatch.setattr(fault_campaign, 'PATIENCE', 0.05)
    campaign = Campaign.__new__(Campaign)
    campaign.interrupted = False
    campaign._executor = SimpleNamespace(spin_once=lambda timeout_sec: None)
    return campaign


def started_by(campaign: Campaign, server: LossyOrchestrator) -> bool:
    enable = SimpleNamespace(
        service_is_ready=lambda: True,
        call_async=lambda request: LossyOrchestrator(0).call_async(0),
    )
    clients = {fault_campaign.START_EXPERIMENT.name: server}
    campaign._clients = {fault_campaign.ENABLE_EXPERIMENT.name: enable, **clients}
    return campaign._started().success


def test_a_start_whose_answers_were_lost_has_begun(campaign):
    server = LossyOrchestrator(lost=2)
    assert started_by(campaign, server)
    assert server.asked == 3


def test_a_start_that_was_refused_at_once_has_not_begun(campaign):
    """Another goal runs: what the campaign would measure then is not its own trial."""
    server = LossyOrchestrator(lost=0, running=True)
    assert not started_by(campaign, server)
    assert server.asked == 1

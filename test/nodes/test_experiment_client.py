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

"""The command that sends a goal to an orchestrator whose answers are lost."""

from hapticvision_ros.bag.contract import CANCEL_EXPERIMENT, ENABLE_EXPERIMENT, START_EXPERIMENT
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.nodes import experiment_client, qos
from hapticvision_ros.nodes.experiment_client import ExperimentClient, ExperimentError
import pytest

AGAIN = 0.2
PATIENCE = 4.0


class Orchestrator:
    """Answers as it is told, the last way for good; an answer that is None is lost."""

    def __init__(self, node, answers) -> None:
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.task import Future

        self.asked = []
        self._never = Future
        group = ReentrantCallbackGroup()
        self.servers = [
            qos.create_service(
                node, service, self._server(service, list(answers[service])), callback_group=group
            )
            for service in (ENABLE_EXPERIMENT, START_EXPERIMENT, CANCEL_EXPERIMENT)
        ]

    def _server(self, service, answers):
        async def answer(request, response):
            forbidden = service is ENABLE_EXPERIMENT and not request.data
            self.asked.append((service, False) if forbidden else service)
            success = answers.pop(0) if len(answers) > 1 else answers[0]
            if success is None:
                await self._never()
            if service is not CANCEL_EXPERIMENT:
                response.success, response.message = success, f'{service.name} says so'
            return response

        return answer


@pytest.fixture
def run(ros, probe):
    """Return a function that sends a goal to an orchestrator, and what that was asked for."""
    clients = []

    def send(expected, *answers):
        services = (ENABLE_EXPERIMENT, START_EXPERIMENT, CANCEL_EXPERIMENT)
        orchestrator = Orchestrator(probe.node, dict(zip(services, answers, strict=True)))
        clients.append(ExperimentClient(patience=PATIENCE, again=AGAIN))
        try:
            with pytest.raises(expected) as raised:
                clients[0].run()
        finally:
            for server in orchestrator.servers:
                probe.node.destroy_service(server)
        return str(raised.value), orchestrator.asked

    yield send
    for client in clients:
        client.close()


def test_enable_is_asked_for_again_and_the_start_is_not(run) -> None:
    said, asked = run(UsageError, [None, None, True], [False], [True])
    assert said == '/experiment/start says so'
    # On a loaded machine an answer may come late and be asked for once more.
    assert asked[:3] == [ENABLE_EXPERIMENT] * 3
    assert asked.count(START_EXPERIMENT) == 1


def test_an_experiment_whose_start_was_not_answered_is_forbidden_again(run) -> None:
    said, asked = run(ExperimentError, [True], [None], [True])
    assert said == f'/experiment/start: no answer within {PATIENCE:g} s.'
    assert asked.count(START_EXPERIMENT) == 1
    assert asked[-1] == (ENABLE_EXPERIMENT, False)


def test_who_cannot_take_it_back_is_told_that_it_may_have_begun(run, monkeypatch) -> None:
    monkeypatch.setattr(experiment_client, 'CANCEL_ANSWER_DEADLINE', 1.0)
    said, asked = run(ExperimentError, [True, None], [None], [True])
    assert f'no answer within {PATIENCE:g} s, nor could the experiment be cancelled' in said
    assert 'emergency stop' in said
    assert asked[-1] == (ENABLE_EXPERIMENT, False)


def test_who_was_not_answered_before_the_start_takes_back_nobody_elses_goal(run) -> None:
    said, asked = run(ExperimentError, [None], [True], [True])
    assert said == f'/experiment/enable: no answer within {PATIENCE:g} s.'
    assert set(asked) == {ENABLE_EXPERIMENT}


def test_an_orchestrator_that_is_not_there_has_nothing_to_take_back(ros) -> None:
    client = ExperimentClient(patience=0.5)
    with pytest.raises(ExperimentError, match=r'^/experiment/enable: not there within 0\.5 s\.$'):
        client.run()
    client.close()


def test_a_start_that_is_not_allowed_is_not_asked_for(run) -> None:
    said, asked = run(UsageError, [False], [True], [True])
    assert said == '/experiment/enable says so'
    assert set(asked) == {ENABLE_EXPERIMENT}

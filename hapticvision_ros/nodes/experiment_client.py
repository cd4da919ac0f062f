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
Send a goal to the experiment orchestrator, tell its progress, and cancel it on Ctrl-C.

A process of its own, since the command line does not speak ROS.
"""

import argparse
from collections.abc import Callable, Sequence
import signal
import sys
import time
from types import FrameType
from typing import Any, Final

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from hapticvision_ros.bag.contract import (
    CANCEL_EXPERIMENT,
    ENABLE_EXPERIMENT,
    EXPERIMENT_FEEDBACK,
    EXPERIMENT_RESULT,
    EXPERIMENT_STATUS,
    RHEOLOGY_RESULT,
    Service,
    START_EXPERIMENT,
)
from hapticvision_ros.core.errors import HapticVisionError, UsageError
from hapticvision_ros.nodes.conversions import values_from_status
from hapticvision_ros.nodes.qos import create_client, create_subscription
from hapticvision_ros.nodes.runtime import initialise
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args
from std_srvs.srv import SetBool, Trigger

NAME: Final = 'experiment_client'
SERVER: Final = 'experiment_orchestrator'
ANSWER_DEADLINE: Final = 30.0
"""How long the orchestrator may take to come up and to answer [s]."""
ASK_AGAIN: Final = 5.0
"""What may be asked twice is asked again after this long without an answer [s]."""
SILENCE: Final = 15.0
"""An orchestrator that gives no feedback for so long is gone [s]."""
CANCEL_ANSWER_DEADLINE: Final = 6.0
"""How long an orchestrator that has been reporting may take to answer a cancel [s]."""
CANCEL_DEADLINE: Final = 40.0
"""How long a cancelled push may take to retract [s]."""

EXIT_CODES: Final = {
    GoalStatus.STATUS_SUCCEEDED: 0,
    GoalStatus.STATUS_ABORTED: 1,
    GoalStatus.STATUS_CANCELED: 130,
}


class ExperimentError(HapticVisionError):
    """The orchestrator does not answer."""

    exit_code = 1


class ExperimentClient:
    """
    One goal, from the sending to the result.

    Parameters
    ----------
    patience : float
        How long the orchestrator may take to come up and to answer [s].
    again : float
        What may be asked twice is asked again after this long without an answer [s].

    """

    def __init__(self, patience: float = ANSWER_DEADLINE, again: float = ASK_AGAIN) -> None:
        self._patience = patience
        self._again = again
        self._node = rclpy.create_node(NAME)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._goal_id = ''
        self._result: Any = None
        self._status = 0
        self._heard = time.monotonic()
        self._told = ''
        self._found = self._chosen = ''
        self._fitted = 0
        self._interrupted = False
        create_subscription(self._node, EXPERIMENT_FEEDBACK, self._on_feedback)
        create_subscription(self._node, EXPERIMENT_STATUS, self._on_status)
        create_subscription(self._node, EXPERIMENT_RESULT, self._on_result)
        self._rheology = create_subscription(self._node, RHEOLOGY_RESULT, self._on_rheology)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Ask for the cancelling of the goal."""
        self._interrupted = True

    def configure(self, values: dict[str, Any]) -> None:
        """
        Set the orchestrator's parameters: the goal's content.

        Raises
        ------
        UsageError
            If it refuses one.

        """
        client = self._node.create_client(SetParameters, f'{SERVER}/set_parameters')
        request = SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )
        answer = self._call(client, request, f'the parameters of {SERVER}')
        refusals = [item.reason for item in answer.results if not item.successful]
        if refusals:
            raise UsageError(' '.join(refusals))

    def run(self) -> int:
        """
        Send the goal and return the exit code once it has ended.

        Raises
        ------
        ExperimentError
            If the orchestrator does not answer.
        UsageError
            If it refuses the goal.

        """
        # A server may find a client later than the client the server, and what it answers until
        # then is lost: the start, which must not be asked twice, comes when enable got through.
        start = create_client(self._node, START_EXPERIMENT)
        # Who calls this command wants the arm to move, once.
        answer = self._call_service(ENABLE_EXPERIMENT, SetBool.Request(data=True))
        if answer.success:
            try:
                answer = self._call(start, Trigger.Request(), START_EXPERIMENT.name, once=True)
            except ExperimentError as error:
                self._give_up(error)
                raise
        if not answer.success:
            raise UsageError(answer.message)
        self._goal_id = answer.message
        self._heard = time.monotonic()
        deadline: float | None = None
        while self._result is None or self._status not in EXIT_CODES:
            self._executor.spin_once(timeout_sec=0.1)
            now = time.monotonic()
            if self._interrupted and deadline is None:
                deadline = now + CANCEL_DEADLINE
                print('cancelling: the tool retracts', flush=True)
                self._cancel()
            if now - self._heard > SILENCE or (deadline is not None and now > deadline):
                raise ExperimentError(
                    f'{SERVER} has been silent for too long: see whether it runs.'
                )
        complete = int(values_from_status(self._result)['complete'])
        if self._node.count_publishers(self._rheology.topic_name):
            self._spin_until(lambda: self._fitted >= complete or self._interrupted)
        self._tell_result()
        return EXIT_CODES[self._status]

    def _give_up(self, error: ExperimentError) -> None:
        """Take back what was allowed, and what may have begun with nobody who waits for it."""
        try:
            self._call_service(
                ENABLE_EXPERIMENT, SetBool.Request(data=False), CANCEL_ANSWER_DEADLINE
            )
        except ExperimentError:
            said = str(error).rstrip('.')
            raise ExperimentError(
                f'{said}, nor could the experiment be cancelled: it may have begun or begin yet. '
                'See to the cell, the emergency stop at hand.'
            ) from error

    def _cancel(self) -> None:
        self._call_service(CANCEL_EXPERIMENT, CancelGoal.Request(), CANCEL_ANSWER_DEADLINE)

    def _call_service(self, service: Service, request: Any, deadline: float | None = None) -> Any:
        return self._call(create_client(self._node, service), request, service.name, deadline)

    def _call(
        self,
        client: Any,
        request: Any,
        what: str,
        deadline: float | None = None,
        *,
        once: bool = False,
    ) -> Any:
        """Return the answer of a service."""
        deadline = self._patience if deadline is None else deadline
        again = deadline if once else self._again
        try:
            if not self._spin_until(client.service_is_ready, deadline):
                raise ExperimentError(f'{what}: not there within {deadline:g} s.')
            end = time.monotonic() + deadline
            futures = list[Any]()
            while (left := end - time.monotonic()) > 0.0:
                futures.append(client.call_async(request))
                if self._spin_until(
                    lambda: any(each.done() for each in futures), min(again, left)
                ):
                    return next(each.result() for each in futures if each.done())
            raise ExperimentError(f'{what}: no answer within {deadline:g} s.')
        finally:
            self._node.destroy_client(client)

    def _spin_until(
        self, condition: Callable[[], bool], deadline: float = ANSWER_DEADLINE
    ) -> bool:
        end = time.monotonic() + deadline
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.1)
        return True

    def _on_feedback(self, message: Any) -> None:
        values = values_from_status(message)
        if not self._goal_id or values.get('goal_id') != self._goal_id:
            return
        self._heard = time.monotonic()
        found = values.get('found', '')
        if found != self._found:
            self._found = found
            print(f'found: {found}', flush=True)
        chosen = values.get('chosen because', '')
        if chosen and values['name'] != self._chosen:
            self._chosen = values['name']
            print(f'next: {self._chosen}, since {chosen}', flush=True)
        line = f'trial {values["trial"]} of {values["trials"]} ({values["name"]}): '
        if line + message.message != self._told:
            self._told = line + message.message
            left = float(values['time_left_s'])
            print(f'{self._told}, at least {left:.0f} s left', flush=True)

    def _on_status(self, message: Any) -> None:
        for status in message.status_list:
            if bytes(status.goal_info.goal_id.uuid).hex() == self._goal_id:
                self._status = int(status.status)

    def _on_result(self, message: Any) -> None:
        if self._goal_id and values_from_status(message).get('goal_id') == self._goal_id:
            self._result = message

    def _on_rheology(self, message: Any) -> None:
        if self._goal_id:
            self._fitted += 1
            print(f'fitted: {message.message}', flush=True)

    def _tell_result(self) -> None:
        values = values_from_status(self._result)
        for number in range(1, int(values['trials']) + 1):
            bag = values.get(f'bag {number}')
            if bag is not None:
                print(f'{values[f"outcome {number}"]}: {bag or "no bag"}')
        print(
            f'{values["status"]}: {values["complete"]} of {values["trials"]} trials complete; '
            f'{self._result.message}',
            flush=True,
        )


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=NAME, description='Run an experiment and watch it.')
    parser.add_argument('--speeds', nargs='+', type=float, metavar='M_S')
    parser.add_argument('--depths', nargs='+', type=float, metavar='M')
    parser.add_argument('--repeats', type=int)
    parser.add_argument('--hold-time', type=float, metavar='S')
    parser.add_argument('--hold-mode')
    parser.add_argument('--recover-time', type=float, metavar='S')
    parser.add_argument('--rest-time', type=float, metavar='S')
    parser.add_argument('--output-folder', metavar='DIR')
    parser.add_argument(
        '--autonomous',
        action=argparse.BooleanOptionalAction,
        help='go on after the grid with the pushes that the analysis asks for',
    )
    parser.add_argument('--budget-trials', type=int, help='how many of them at most')
    parser.add_argument('--budget-time', type=float, metavar='S', help='for how long at most')
    parser.add_argument(
        '--precision', type=float, help='relative standard error that is good enough'
    )
    return parser.parse_args(argv)


def main() -> int:
    """Run an experiment and return the process's exit code."""
    client: ExperimentClient | None = None
    try:
        initialise()
        # What ROS takes for itself, such as a namespace, is none of the goal's.
        given = vars(_arguments(remove_ros_args()[1:]))
        client = ExperimentClient()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, client.interrupt)
        values = {name: value for name, value in given.items() if value is not None}
        if values:
            client.configure(values)
        return client.run()
    except HapticVisionError as error:
        print(f'error: {error}', file=sys.stderr)
        return error.exit_code
    finally:
        if client is not None:
            client.close()
        rclpy.try_shutdown()

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
Play a bag into the ROS graph: its own bytes, at its own pace, with ``/clock``.

Right before each message that bears no stamp a tick of ``/clock`` tells its time, so that nodes
with ``use_sim_time`` know it exactly (as ``ros2 bag play --clock-topics-all`` does).
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
import signal
import sys
import time
from types import FrameType
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from hapticvision_ros.bag.cdr import decode_string
from hapticvision_ros.bag.contract import (
    FIT,
    PHASE,
    PHASES,
    POINTS,
    RESET,
    RHEOLOGY_RESULT,
    TOOL_HEIGHT,
    Topic,
    WRENCH,
)
from hapticvision_ros.bag.playback import Playback
from hapticvision_ros.core.errors import HapticVisionError, InputError, UsageError
from hapticvision_ros.nodes.clock import CLOCK
from hapticvision_ros.nodes.conversions import stamp_from_ns, values_from_status
from hapticvision_ros.nodes.qos import (
    create_client,
    create_subscription,
    interface_class,
    publisher_profile,
    relative_name,
)
from hapticvision_ros.nodes.rheology_fitter import SYMBOLS, TRIAL
from hapticvision_ros.nodes.runtime import deliver, stay_on_this_machine
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

NAME: Final = 'bag_player'

START_DEADLINE: Final = 60.0
"""How long the listeners are waited for [s]."""
FIT_DEADLINE: Final = 120.0
"""How long the fit may take [s]."""
TICK: Final = 0.02
"""Longest time between two ticks of /clock [s]."""
LARGEST_TICK_NS: Final = 10**9
"""Time of the bag after which a stamped message has a tick of its own as well."""
PROGRESS: Final = 5.0
"""Time between two lines of progress [s]."""
QUEUE: Final = 20000


class ReplayError(HapticVisionError):
    """The nodes do not take part in the replay."""

    exit_code = 1


class BagPlayer:
    """
    Plays one bag.

    Parameters
    ----------
    playback : Playback
        What to play.
    rate : float
        How many times faster than recorded.

    """

    def __init__(self, playback: Playback, rate: float) -> None:
        self._playback = playback
        self._rate = rate
        self._node = rclpy.create_node(NAME)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._clock = self._node.create_publisher(Clock, CLOCK, QoSProfile(depth=QUEUE))
        self._publishers = {topic: self._publisher(topic) for topic in playback.topics}
        self._results: list[Any] = []
        create_subscription(self._node, RHEOLOGY_RESULT, self._on_result)
        self._trial = ''
        self._told_ns = 0
        self._ended = False

    def close(self) -> None:
        """Leave the graph, once what was played has arrived."""
        deliver(self._node)
        self._executor.shutdown()
        self._node.destroy_node()

    def wait_for_listeners(self, *, needed: bool) -> None:
        """
        Wait until someone listens.

        Parameters
        ----------
        needed : bool
            Whether force and tool height must be heard; otherwise anything will do, and after
            the deadline the bag is played all the same.

        Raises
        ------
        ReplayError
            If nobody listens who must.
        UsageError
            If another publisher is on one of the bag's topics.

        """
        topics = [topic for topic in self._publishers if topic in (WRENCH, TOOL_HEIGHT)]

        def heard() -> bool:
            if needed:
                return all(self._publishers[t].get_subscription_count() for t in topics)
            return any(item.get_subscription_count() for item in self._publishers.values())

        if not self._spin_until(heard, START_DEADLINE):
            if needed:
                raise ReplayError(f'nobody listens within {START_DEADLINE:g} s.')
            print('nobody listens: playing all the same', flush=True)
        for topic, publisher in self._publishers.items():
            name = publisher.topic_name
            if self._node.count_publishers(name) > 1:
                raise UsageError(
                    f'another node publishes {topic.name}: stop it, or replay in another ROS '
                    'domain with --domain.'
                )

    def begin_fit(self) -> None:
        """
        Let the fitter forget what it has, and see to it that it hears the bag.

        Raises
        ------
        ReplayError
            If there is no fitter, or it does not hear the bag's force and tool height.

        """
        deadline = time.monotonic() + START_DEADLINE
        wanted = {topic.name for topic in self._publishers if topic is not POINTS} | {CLOCK}
        while True:
            number, *heard = self._call(RESET).message.split()
            # It need not want the clouds; but if it does, none may be lost.
            silent = {topic.name for topic in self._publishers if f'{topic.name}?' in heard}
            if wanted <= set(heard) and not silent:
                break
            if time.monotonic() > deadline:
                raise ReplayError('the fitter does not hear the bag.')
        self._trial = number

    def play(self) -> None:
        """Publish all messages, each at its time."""
        playback, rate = self._playback, self._rate
        begin, start_ns = time.monotonic(), playback.start_ns
        ticked = shown = begin
        self._tick(start_ns)
        for message in playback:
            due = begin + (message.sent_ns - start_ns) * 1e-9 / rate
            while (left := due - (now := time.monotonic())) > 0.0:
                if now - ticked >= TICK:
                    self._tick(start_ns + round((now - begin) * rate * 1e9))
                    ticked = now
                time.sleep(min(left, TICK))
            # A player that was held up catches up with many messages at once.
            late = message.sent_ns - self._told_ns >= LARGEST_TICK_NS
            if not message.topic.stamped or now - ticked >= TICK or late:
                self._tick(message.sent_ns)
                ticked = now
            self._publishers[message.topic].publish(message.data)
            if message.topic is PHASE:
                self._ended = self._ended or _text(message.data) == 'done'
            if now - shown >= PROGRESS:
                shown = now
                played = (message.sent_ns - start_ns) * 1e-9
                print(f'{played:.1f} of {playback.duration:.1f} s', flush=True)
        self._tick(start_ns + round(playback.duration * 1e9))

    def fit(self) -> Any:
        """
        Return the fitter's result on what was played.

        Raises
        ------
        ReplayError
            If there is none in time.

        """
        if not self._ended:
            # Else the request might come before the last samples.
            deliver(self._node)
            answer = self._call(FIT)
            if not answer.success:
                raise ReplayError(f'the fitter cannot fit: {answer.message}')
        if not self._spin_until(lambda: bool(self._results), FIT_DEADLINE):
            raise ReplayError(f'the fitter gave no result in {FIT_DEADLINE:g} s.')
        return self._results[-1]

    def _on_result(self, message: Any) -> None:
        """Keep the result of this bag; an earlier one is latched, and comes late."""
        if self._trial and values_from_status(message).get(TRIAL) == self._trial:
            self._results.append(message)

    def _publisher(self, topic: Topic) -> Any:
        profile = publisher_profile(topic.qos)
        if topic is not POINTS:
            profile.depth = max(profile.depth, QUEUE)
        if topic is PHASE:
            # A listener that comes late gets the last phase, as in the cell.
            profile.depth = len(PHASES)
        return self._node.create_publisher(
            interface_class(topic.msgtype), relative_name(topic.name), profile
        )

    def _tick(self, time_ns: int) -> None:
        self._told_ns = time_ns
        self._clock.publish(Clock(clock=stamp_from_ns(time_ns)))

    def _call(self, service: Any) -> Any:
        client = create_client(self._node, service)
        try:
            if not self._spin_until(client.service_is_ready, START_DEADLINE):
                raise ReplayError(f'{service.name} is not there within {START_DEADLINE:g} s.')
            future = client.call_async(Trigger.Request())
            if not self._spin_until(future.done, START_DEADLINE):
                raise ReplayError(f'{service.name} did not answer in {START_DEADLINE:g} s.')
            return future.result()
        finally:
            self._node.destroy_client(client)

    def _spin_until(self, condition: Callable[[], bool], deadline: float) -> bool:
        """Return whether the condition became true before the deadline [s]."""
        end = time.monotonic() + deadline
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True


def _text(data: bytes) -> str:
    try:
        return decode_string(memoryview(data))
    except ValueError:
        return ''


def result_lines(result: Any) -> list[str]:
    """Return the fitter's result as a person reads it, one line an estimate."""
    from hapticvision_ros.report.quantities import display_unit, format_number, SI_UNITS

    values = values_from_status(result)
    lines = []
    for symbol, si_unit in SYMBOLS:
        if f'{symbol}.value' not in values:
            lines.append(f'{symbol:18s} unknown: {values.get(f"{symbol}.reason", "no reason")}')
            continue
        unit = display_unit(si_unit, SI_UNITS)
        value = unit.from_si(float(values[f'{symbol}.value']))
        std = values.get(f'{symbol}.std')
        number = format_number(value, None if std is None else unit.from_si(float(std)))
        lines.append(f'{symbol:18s} {number} {unit.symbol}')
    lines += [f'warning: {text}' for key, text in values.items() if key.startswith('warning')]
    return lines


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=NAME, description='Play a bag into the ROS graph.')
    parser.add_argument('bag', type=Path, metavar='BAG')
    parser.add_argument('--rate', type=float, default=1.0)
    parser.add_argument('--fit', action='store_true', help='wait for the fitter and its result')
    return parser.parse_args(argv)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _run(arguments: argparse.Namespace) -> int:
    playback = Playback(arguments.bag)
    for warning in playback.warnings:
        print(f'warning: {warning}', flush=True)
    stay_on_this_machine()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    player = BagPlayer(playback, arguments.rate)
    try:
        player.wait_for_listeners(needed=arguments.fit)
        if arguments.fit:
            player.begin_fit()
        player.play()
        if not arguments.fit:
            return 0
        result = player.fit()
        if result.level == DiagnosticStatus.ERROR:
            raise InputError(result.message)
        # The fitter's own log has told what three elements make of the whole waveform.
        print("By the paper's method (what three elements lack, hapticvision fit tells):")
        print('\n'.join(result_lines(result)), flush=True)
        return 0
    finally:
        player.close()
        rclpy.try_shutdown()


def main() -> int:
    """Play a bag and return the process's exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        return _run(_arguments(sys.argv[1:]))
    except HapticVisionError as error:
        print(f'error: {error}', file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130

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
Every bag under ``bags/`` gives the same numbers in a replay through the real nodes and offline.

The load cell's samples bear stamps, and all other messages have a tick of ``/clock`` right before
them; the streams are reliable. So the nodes get the same bytes at the same times, and run the same
code: the numbers agree to the rounding of a sum.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
import os
from pathlib import Path
import re
import socket
import threading
import time
from types import SimpleNamespace

from hapticvision_ros.bag.contract import (
    CONTACT_TIME,
    HOLD_TIME,
    RELEASE_TIME,
    RHEOLOGY_RESULT,
    Topic,
)
from hapticvision_ros.bag.playback import Playback
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.cli.processes import node, Supervisor
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.pipeline import analyse, TrialAnalysis
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.segmentation import OnlineSegmenter
from hapticvision_ros.nodes.bag_player import BagPlayer, LARGEST_TICK_NS, result_lines
from hapticvision_ros.nodes.conversions import ns_from_stamp, values_from_status
from hapticvision_ros.nodes.qos import interface_class, publisher_profile, relative_name
from hapticvision_ros.nodes.rheology_fitter import (
    _told,
    result_values,
    SYMBOLS,
    TRIAL,
    whole_values,
)
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

BAGS = Path(__file__).parents[2] / 'bags'
TRIALS = sorted({path.parent for path in BAGS.rglob('metadata.yaml')})
DEADLINE = 90.0
MESSAGES_PER_SECOND = 600.0
RELATIVE = 1e-9
"""Sums over the samples are taken in the same order; only the start of the arrays in memory, and
with it the blocks of a vectorised sum, may differ."""
LOCK_PORT = 61000


@pytest.fixture(scope='module')
def domain() -> Iterator[int]:
    """Take a free ROS domain, or share that of the node tests in this process."""
    if rclpy.ok():
        yield int(os.environ['ROS_DOMAIN_ID'])
        return
    for number in range(1, 100):
        lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lock.bind(('127.0.0.1', LOCK_PORT + number))
        except OSError:
            lock.close()
            continue
        os.environ['ROS_DOMAIN_ID'] = str(number)
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        with lock:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            yield number
            rclpy.try_shutdown()
        return
    pytest.fail('all ROS domains are taken by other test runs')


class Listener:
    """Hears what the nodes publish, and sets their parameters."""

    def __init__(self) -> None:
        self.node = rclpy.create_node('replay_test')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.times = {
            'contact': self.hear(CONTACT_TIME),
            'hold': self.hear(HOLD_TIME),
            'release': self.hear(RELEASE_TIME),
        }
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        while not self._closing.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def hear(self, topic: Topic) -> list[float]:
        """Return a list that grows by each number on a topic."""
        heard: list[float] = []
        # Each event is told once: a busy machine loses messages that nobody asks for again.
        self.node.create_subscription(
            interface_class(topic.msgtype),
            relative_name(topic.name),
            lambda message: heard.append(message.data),
            publisher_profile(topic.qos),
        )
        return heard

    def set_source(self, source: str) -> None:
        """Tell the fitter what the bag's displacement height is."""
        client = self.node.create_client(SetParameters, 'rheology_fitter/set_parameters')
        wait_until(client.service_is_ready, "the fitter's parameters")
        parameter = Parameter('displacement_source', value=source).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        wait_until(future.done, 'the answer of the fitter')
        assert future.result().results[0].successful
        self.node.destroy_client(client)

    def close(self) -> None:
        """End the thread and the node."""
        self._closing.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()


def wait_until(
    condition: Callable[[], object], what: str, instead: Callable[[], object] = lambda: ''
) -> None:
    """Wait for a condition, with a deadline; say what is there `instead`."""
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, f'{what}: not within {DEADLINE:g} s {instead()}'
        time.sleep(0.01)


@pytest.fixture(scope='module')
def nodes(domain: int) -> Iterator[Listener]:
    """Run the phase segmenter and the rheology fitter, as real processes, for all bags."""
    environment = os.environ | {'OMP_NUM_THREADS': '1'}
    simulated = ['--ros-args', '-p', 'use_sim_time:=true', '-p', 'exact_replay:=true']
    listener = Listener()
    with Supervisor(environment) as supervisor:
        supervisor.start(
            {
                'phase_segmenter': node('phase_segmenter', *simulated),
                'rheology_fitter': node(
                    'rheology_fitter', *simulated, '-p', 'displacement_from_points:=true'
                ),
            }
        )
        heard = (CONTACT_TIME, HOLD_TIME, RELEASE_TIME)
        wait_until(
            lambda: all(listener.node.count_publishers(topic.name) for topic in heard),
            'the topics of the segmenter',
        )
        yield listener
        listener.close()


def replay(path: Path) -> tuple[object, int]:
    """Play a bag through the nodes; return the fitter's result and the number of messages."""
    playback = Playback(path)
    seconds = max(1.0, len(playback) / MESSAGES_PER_SECOND)
    player = BagPlayer(playback, max(1.0, playback.duration / seconds))
    try:
        player.wait_for_listeners(needed=True)
        player.begin_fit()
        player.play()
        return player.fit(), len(playback)
    finally:
        player.close()


def online_times(trial: Trial) -> dict[str, float]:
    """Return what the online segmenter says of a trial's samples in the order of time [s]."""
    segmenter = OnlineSegmenter()
    times: dict[str, float] = {}
    samples = [(t, True, f) for t, f in zip(trial.force.t, trial.force.value, strict=True)]
    height = trial.tool_height
    samples += [(t, False, h) for t, h in zip(height.t, height.value, strict=True)]
    for t, is_force, value in sorted(samples):
        add = segmenter.add_force if is_force else segmenter.add_height
        for event in add(t, value):
            times[event.kind] = event.t
    return times


def test_there_are_bags_to_replay():
    assert len(TRIALS) >= 2
    assert any('synthetic' in str(path) for path in TRIALS)


@pytest.mark.parametrize('path', TRIALS, ids=lambda path: f'{path.parent.name}/{path.name}')
def test_a_replay_through_the_nodes_gives_the_numbers_of_the_offline_fit(nodes, path):
    trial = read_trial(path)
    nodes.set_source('tool' if trial.displacement_source == 'tool' else 'object')
    heard = nodes.times
    before = {kind: len(values) for kind, values in heard.items()}

    result, _ = replay(path)

    values = values_from_status(result)
    # The node knows a trial by its number, and warnings name the trial.
    offline: TrialAnalysis = analyse(replace(trial, name=f'trial {values.pop(TRIAL)}'))
    expected = {**result_values(offline), **whole_values(offline)}
    assert values.pop('start_ns') == expected.pop('start_ns')
    warnings = {key: text for key, text in values.items() if 'warning' in key}
    assert warnings == {key: text for key, text in expected.items() if key in warnings}
    assert values.keys() == expected.keys(), 'the same is known, and the same unknown'
    for key, text in expected.items():
        try:
            number = float(text)
        except ValueError:
            assert values[key] == text, key
            continue
        assert float(values[key]) == pytest.approx(number, rel=RELATIVE), key

    expected_times = online_times(trial)
    interval = float(np.median(np.diff(trial.tool_height.t)))
    for kind, t in expected_times.items():
        if kind in heard:
            # The segmenter is a process of its own: it may be later than the fitter. It starts
            # anew at the commanded approach, some samples into the bag.
            expected_time = pytest.approx(trial.start_ns * 1e-9 + t, rel=0.0, abs=interval)
            first = before[kind]
            wait_until(
                lambda kind=kind, first=first, at=expected_time: heard[kind][first:][-1:] == [at],
                f'the {kind} of the segmenter at {t:g} s',
                lambda kind=kind, first=first: f'but {heard[kind][first:]}',
            )


def test_a_player_that_catches_up_ticks_between_messages_that_are_far_apart(nodes, monkeypatch):
    playback = Playback(next(path for path in TRIALS if path.name == 'ramp_0.1s'))
    # Far behind its schedule from the first message on.
    player = BagPlayer(playback, 1e9)
    ticks, behind = [], []
    monkeypatch.setattr(player, '_clock', SimpleNamespace(publish=ticks.append))
    deaf = SimpleNamespace(publish=lambda data: behind.append(ticks[-1].clock))
    monkeypatch.setattr(player, '_publishers', dict.fromkeys(player._publishers, deaf))
    player.play()
    player.close()
    sent = [message.sent_ns for message in playback]
    told = [ns_from_stamp(stamp) for stamp in behind]
    assert max(np.subtract(sent, told)) < LARGEST_TICK_NS


def test_the_result_is_printed_with_a_reason_for_all_that_is_unknown(nodes):
    path = next(path for path in TRIALS if 'muscle' in str(path))
    nodes.set_source('tool')
    result, _ = replay(path)
    lines = result_lines(result)
    for symbol, _ in SYMBOLS:
        assert any(line.startswith(f'{symbol} ') for line in lines), symbol
    assert any('unknown: ' in line and 'release' in line for line in lines)
    assert RHEOLOGY_RESULT.msgtype == 'diagnostic_msgs/msg/DiagnosticStatus'


def test_a_trial_that_no_model_fits_has_the_reason():
    trial = read_trial(TRIALS[0])
    untouched = Signal(trial.force.t, np.zeros(trial.force.t.size))
    values = whole_values(analyse(replace(trial, force=untouched)))
    assert values['whole.model'] == 'three-element'
    assert values['whole.reason']
    assert not any(key.endswith('.value') for key in values)
    assert _told(values) == values['whole.reason']


def test_by_how_much_three_elements_miss_a_trial_is_told():
    trial = read_trial(next(path for path in TRIALS if 'soft_block' in str(path)))
    values = whole_values(analyse(trial))
    rest, _, miss = _told(values).partition('; ')
    assert re.match(r'K1 = \S+ \+- \S+ N/m, C1 = .*, C2 = ', rest)
    assert miss == (
        f'the force is missed by {float(values["whole.force_rmse.value"]):.2g} N, '
        f'{float(values["whole.force_rmse_over_noise.value"]):.2g} times its noise before contact'
    )
    found = fit([analyse(trial)], Model())
    assert float(values['whole.force_rmse.value']) == found.force_rmse > 0.0
    assert float(values['whole.force_rmse_over_noise.value']) ** 2 == pytest.approx(
        found.force_chi2
    )
    # Where the record has no noise before contact nothing is said of it.
    del values['whole.force_rmse_over_noise.value']
    assert _told(values).endswith(' N')

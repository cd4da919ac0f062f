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

"""What the rheology fitter says of itself while a trial comes, is fitted, or cannot be."""

import os
from pathlib import Path
import subprocess
import sys

from geometry_msgs.msg import WrenchStamped
from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    FIT,
    PHASE,
    RHEOLOGY_RESULT,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.nodes import fit_kernels, rheology_fitter
from hapticvision_ros.nodes.conversions import (
    scalar_to_message,
    stamp_from_ns,
    text_to_message,
    values_from_status,
)
from hapticvision_ros.nodes.diagnostics import Level
from hapticvision_ros.nodes.rheology_fitter import RheologyFitter
import pytest
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

BAG = Path(__file__).parents[2] / 'bags' / 'synthetic_soft_block' / 'speed_5mm_s_depth_8mm'


@pytest.fixture
def fitter(ros):
    node = RheologyFitter()
    yield node
    node.close()
    node.destroy_node()


def wrench(stamp_ns, force):
    message = WrenchStamped()
    message.header.stamp = stamp_from_ns(stamp_ns)
    message.wrench.force.z = -force
    return message


def feed(fitter):
    """Let the node keep a measured trial, as if it had taken each message when it was sent."""
    trial = read_trial(BAG)
    signals = {
        WRENCH: trial.force,
        TOOL_HEIGHT: trial.tool_height,
        DISPLACEMENT_HEIGHT: trial.displacement_height,
    }
    for topic, signal in signals.items():
        for t, value in zip(signal.t.tolist(), signal.value.tolist(), strict=True):
            sent_ns = trial.start_ns + round(t * 1e9)
            message = wrench(sent_ns, value) if topic is WRENCH else scalar_to_message(value)
            fitter._buffer.add(topic, serialize_message(message), sent_ns)
    for heard in fitter._needed.values():
        heard.note()
    return trial


def finish(fitter, until):
    """End the trial, and wait for all that it tells."""
    fitter._end(None)
    fitter._hand_over()

    def told():
        while not fitter._outcomes.empty():
            fitter._publish(fitter._outcomes.get())
        return fitter._find_result().values['fitted']

    until(told, 'the result of the trial')
    return fitter._find_result()


def test_what_a_trial_has_told_is_told(fitter, until):
    assert fitter._find_result().message == 'No trial has come to its end yet.'
    fitter._on_phase('approach', 0)
    trial = feed(fitter)
    at_hand = fitter._find_trial()
    assert (at_hand.level, at_hand.values['state']) == (Level.OK, 'collecting')
    assert at_hand.values['forces'] == trial.force.t.size
    assert at_hand.values['tool_heights'] == trial.tool_height.t.size
    assert at_hand.values['trial'] == 1
    result = finish(fitter, until)
    assert result.level is Level.OK
    assert result.message.startswith('trial 1: K1 = ')
    assert result.values['trials'] == result.values['fitted'] == 1
    assert fitter._find_trial().values['state'] == 'idle'


def test_a_trial_that_waits_for_its_fit_is_told(fitter):
    fitter._trials = 3
    fitter._fitted = 2
    assert fitter._find_result().message == 'Trial 3 is being fitted.'


def test_kernels_that_are_missing_are_compiled_apart_and_the_trial_waits(
    ros, until, monkeypatch, tmp_path
):
    # A compiler that ends when it is allowed to.
    allowed, began = tmp_path / 'allowed', tmp_path / 'began'
    code = (
        'import os, pathlib, time\n'
        f'pathlib.Path({str(began)!r}).write_text(str(os.getpid()))\n'
        f'while not pathlib.Path({str(allowed)!r}).exists():\n'
        '    time.sleep(0.01)\n'
    )
    monkeypatch.setattr(fit_kernels, '_COMMAND', (sys.executable, '-c', code))
    monkeypatch.setattr(rheology_fitter, 'missing', lambda: True)
    node = RheologyFitter()
    try:
        until(began.exists, 'the compiler')
        node._on_phase('approach', 0)
        feed(node)
        node._end(None)
        node._hand_over()
        assert node._find_result().message == 'Trial 1 waits for the fit to be compiled, once.'
        allowed.touch()

        def told():
            node._on_tick()
            return node._find_result().values['fitted']

        until(told, 'the result of the trial')
        assert node._find_result().message.startswith('trial 1: K1 = ')
    finally:
        node.close()
        node.destroy_node()


def test_a_fitter_that_stops_ends_its_compiler(ros, until, monkeypatch, tmp_path):
    began = tmp_path / 'began'
    code = (
        'import os, pathlib, time\n'
        f'pathlib.Path({str(began)!r}).write_text(str(os.getpid()))\n'
        'time.sleep(600)\n'
    )
    monkeypatch.setattr(fit_kernels, '_COMMAND', (sys.executable, '-c', code))
    monkeypatch.setattr(rheology_fitter, 'missing', lambda: True)
    node = RheologyFitter()
    until(lambda: began.exists() and began.read_text(), 'the compiler')
    node.close()
    node.destroy_node()
    with pytest.raises(ProcessLookupError):
        os.kill(int(began.read_text()), 0)


def test_what_is_compiled_apart_is_what_a_fit_calls():
    code = (
        'import gc, sys, threading\n'
        'from pathlib import Path\n'
        'from numba.core.dispatcher import Dispatcher\n'
        'from hapticvision_ros.bag.reader import read_trial\n'
        'from hapticvision_ros.core.pipeline import analyse\n'
        'from hapticvision_ros.nodes import fit_kernels\n'
        'from hapticvision_ros.nodes.rheology_fitter import whole_values\n'
        'def called():\n'
        '    kernels = (k for k in gc.get_objects() if isinstance(k, Dispatcher))\n'
        '    return {(str(k.py_func), s) for k in kernels for s in k.signatures}\n'
        'fit_kernels.main()\n'
        'assert not fit_kernels.missing()\n'
        'before = called()\n'
        'whole_values(analyse(read_trial(Path(sys.argv[1]))))\n'
        'print(len(before), *(called() - before), sep="\\n")\n'
    )
    command = [sys.executable, '-c', code, BAG]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split('\n')
    assert int(said[0]) > 10
    assert said[1:] == ['']


def test_a_trial_without_a_usable_signal_is_told_with_the_reason(fitter, until):
    fitter._on_phase('approach', 0)
    fitter._buffer.add(WRENCH, serialize_message(wrench(1, 0.0)), 1)
    result = finish(fitter, until)
    assert result.level is Level.WARN
    assert result.message.startswith('Trial 1 gave no result: ')
    assert '/arm/tool_height' in result.message


def test_a_trial_that_was_aborted_is_told_until_the_next_begins(fitter):
    fitter._on_phase('approach', 0)
    feed(fitter)
    fitter._on_phase('aborted', 1)
    told = fitter._find_trial()
    assert (told.level, told.values['state']) == (Level.WARN, 'idle')
    assert 'aborted' in told.message
    fitter._on_phase('approach', 2)
    feed(fitter)
    assert fitter._find_trial().level is Level.OK


def test_messages_that_find_no_room_are_told(fitter):
    fitter._on_phase('approach', 0)
    feed(fitter)
    fitter._buffer._capacity = 0
    feed(fitter)
    told = fitter._find_trial()
    assert told.level is Level.WARN
    assert 'found no room: raise memory' in told.message
    assert told.values['left_out'] > 1000


def test_the_fitter_tells_what_it_hears_and_why_there_is_no_result(start_node, probe, diagnosis):
    fitter = diagnosis('rheology_fitter')
    start_node('rheology_fitter', {'quiet_time': 0.5})
    silent = fitter.wait('trial', lambda s, v: s.level == s.WARN, 'the missing streams told')
    assert 'The force on /load_cell/wrench has not come yet.' in silent.message
    phase, height = probe.publisher(PHASE), probe.publisher(TOOL_HEIGHT)
    force = probe.publisher(WRENCH)
    results = probe.listen(RHEOLOGY_RESULT)

    def send():
        height.publish(scalar_to_message(0.05))
        force.publish(wrench(probe.node.get_clock().now().nanoseconds, 0.0))

    phase.publish(text_to_message('approach'))
    timer = probe.node.create_timer(0.01, send)
    try:
        coming = fitter.wait(
            'trial', lambda s, v: s.level == s.OK and int(v['forces']) > 50, 'the samples told'
        )
        assert values_from_status(coming)['state'] == 'collecting'
        assert probe.call(FIT, Trigger.Request()).success
    finally:
        probe.node.destroy_timer(timer)
    # A tool that stays in the air tells nothing of the object.
    told = fitter.wait('result', lambda s, v: s.level == s.WARN, 'the missing result told')
    assert values_from_status(told)['fitted'] == '1'
    assert results[-1].message.rstrip('.') in told.message

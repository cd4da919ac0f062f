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

"""The phase segmenter: news of a trial that comes late, and what the node says of itself."""

from pathlib import Path

from geometry_msgs.msg import WrenchStamped
from hapticvision_ros.bag.contract import PHASE, TOOL_HEIGHT, WRENCH
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.nodes import phase_segmenter
from hapticvision_ros.nodes.conversions import (
    scalar_to_message,
    stamp_from_ns,
    text_to_message,
    values_from_status,
)
from hapticvision_ros.nodes.diagnostics import Level
from hapticvision_ros.nodes.phase_segmenter import PhaseSegmenter
import pytest

BAG = Path(__file__).parents[2] / 'bags' / 'synthetic_soft_block' / 'speed_5mm_s_depth_8mm'
BEGIN, HEIGHT, FORCE = 0, 1, 2


@pytest.fixture
def segmenter(ros):
    node = PhaseSegmenter()
    yield node
    node.close()
    node.destroy_node()


@pytest.fixture
def told(segmenter, monkeypatch):
    """Return the events as they are told: kind and time [s]."""
    events = []
    monkeypatch.setattr(segmenter, '_on_event', lambda e: events.append((e.kind, e.t)))
    return events


def samples():
    trial = read_trial(BAG)
    streams = ((FORCE, trial.force), (HEIGHT, trial.tool_height))
    return trial.start_ns, sorted(
        (trial.start_ns + round(t * 1e9), kind, float(value))
        for kind, signal in streams
        for t, value in zip(signal.t.tolist(), signal.value.tolist(), strict=True)
    )


def use(segmenter, waiting):
    """Let the node use samples, as if its streams had come to an end."""
    segmenter._waiting += waiting
    segmenter._alone = phase_segmenter._PATIENCE
    segmenter._use()


@pytest.mark.parametrize('late', [0, 100, 500])
def test_a_beginning_that_is_heard_late_changes_nothing_of_the_trial(segmenter, told, late):
    start_ns, trial = samples()
    use(segmenter, trial[:late])
    use(segmenter, [(start_ns, BEGIN, 0.0), *trial[late:]])
    events = dict(told)
    # The contact is at 2.61 s, at some 400 samples; what was told before is told again.
    assert events['contact'] == pytest.approx(2.61, abs=0.01)
    assert events['hold'] == pytest.approx(4.205, abs=0.01)


def test_a_trial_that_is_played_again_is_another_one(segmenter, told):
    start_ns, trial = samples()
    begin = (start_ns, BEGIN, 0.0)
    use(segmenter, [begin, *trial])
    once = list(told)
    use(segmenter, [begin])
    use(segmenter, trial)
    assert [kind for kind, _ in once] == ['contact', 'hold', 'release', 'loss']
    assert told == [*once, *once]


@pytest.mark.parametrize('first', [FORCE, HEIGHT])
def test_a_stream_that_comes_later_than_the_other_is_waited_for(segmenter, told, first):
    """At the beginning of a record, and where one that begins sooner was played before it."""
    start_ns, trial = samples()
    begin = [(start_ns, BEGIN, 0.0)]
    streams = {kind: [one for one in trial if one[1] == kind] for kind in (FORCE, HEIGHT)}
    for _ in range(2):
        told.clear()
        for kind in (first, *({FORCE, HEIGHT} - {first})):
            for part in (streams[kind][:50], streams[kind][50:]):
                segmenter._take(*(part if kind == each else [] for each in (FORCE, HEIGHT)), begin)
                begin = []
        begin = [(start_ns, BEGIN, 0.0)]
        segmenter._take([], [], [])
        events = dict(told)
        assert events['contact'] == pytest.approx(2.61, abs=0.01)
        assert events['hold'] == pytest.approx(4.205, abs=0.01)


def test_what_the_signals_have_shown_is_told(segmenter):
    assert segmenter._find_phase().message == 'No sample of a trial has come yet.'
    start_ns, trial = samples()
    use(segmenter, [(start_ns, BEGIN, 0.0), *trial])
    segmenter._command = 'done'
    finding = segmenter._find_phase()
    assert finding.level is Level.OK
    assert finding.values['phase'] == 'recover'
    assert finding.values['contact_s'] == pytest.approx(2.61, abs=0.01)
    assert finding.values['hold_s'] == pytest.approx(4.205, abs=0.01)
    assert finding.values['trial_s'] == pytest.approx((trial[-1][0] - trial[0][0]) / 1e9)


@pytest.mark.parametrize(
    ('command', 'stop', 'missed'),
    [
        # The contact is at 2.61 s, at some 400 samples, the hold from 4.2 s on.
        ('push', 300, None),
        ('release', 300, 'no contact'),
        ('done', 300, 'no contact and no release'),
        ('done', 1000, 'no release'),
        ('aborted', 300, None),
    ],
)
def test_what_the_arm_was_told_but_the_signals_do_not_show_is_a_warning(
    segmenter, command, stop, missed
):
    start_ns, trial = samples()
    use(segmenter, [(start_ns, BEGIN, 0.0), *trial[:stop]])
    segmenter._command = command
    finding = segmenter._find_phase()
    if missed is None:
        assert finding.level is Level.OK
    else:
        assert finding.level is Level.WARN
        assert finding.message == f"The arm is at '{command}', but the signals show {missed}."
    # Another trial begins with nothing found.
    use(segmenter, [(trial[-1][0] + 1, BEGIN, 0.0)])
    values = segmenter._find_phase().values
    assert not [key for key in values if key.endswith('_s') and values[key] is not None]


def test_the_segmenter_tells_which_stream_it_lacks(start_node, probe, diagnosis):
    segmenter = diagnosis('phase_segmenter')
    start_node('phase_segmenter')
    told = segmenter.wait('streams', lambda s, v: s.level == s.WARN, 'the missing streams told')
    assert 'The force on /load_cell/wrench has not come yet.' in told.message
    assert 'The tool height on /arm/tool_height has not come yet.' in told.message
    phase, height = probe.publisher(PHASE), probe.publisher(TOOL_HEIGHT)
    force = probe.publisher(WRENCH)
    number = float('nan')

    def send(*, with_force):
        height.publish(scalar_to_message(0.05))
        if with_force:
            message = WrenchStamped()
            now_ns = probe.node.get_clock().now().nanoseconds
            message.header.stamp = stamp_from_ns(now_ns)
            message.wrench.force.z = number
            force.publish(message)

    phase.publish(text_to_message('approach'))
    timer = probe.node.create_timer(0.01, lambda: send(with_force=True))
    segmenter.wait('streams', lambda s, v: int(v['no_numbers']) > 0, 'what is no number counted')
    number = 0.0
    good = segmenter.wait('streams', lambda s, v: s.level == s.OK, 'both streams')
    values = values_from_status(good)
    assert float(values['force_age_s']) < 0.5
    assert int(values['tool_height_count']) > 0
    begun = segmenter.wait('phase', lambda s, v: v['trial_s'] != '-', 'the trial told')
    assert values_from_status(begun)['commanded'] == 'approach'
    assert begun.message == "The signals show the phase 'approach'."
    probe.node.destroy_timer(timer)
    timer = probe.node.create_timer(0.01, lambda: send(with_force=False))
    try:
        silent = segmenter.wait(
            'streams',
            lambda s, v: s.level == s.WARN and float(v['tool_height_age_s']) < 0.5,
            'the missing force',
        )
    finally:
        probe.node.destroy_timer(timer)
    assert silent.message.startswith('The force on /load_cell/wrench has not come for')


def test_a_replay_without_a_clock_is_told(start_node, diagnosis):
    segmenter = diagnosis('phase_segmenter')
    start_node('phase_segmenter', {'use_sim_time': True})
    told = segmenter.wait('streams', lambda s, v: s.level == s.WARN, 'the missing clock')
    assert 'Nobody tells the time on /clock.' in told.message

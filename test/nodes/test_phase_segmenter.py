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

"""The phase segmenter where the news that a trial has begun comes late."""

from pathlib import Path

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.nodes import phase_segmenter
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

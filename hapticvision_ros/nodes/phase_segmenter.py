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
Tell the phases of the running trial from its signals alone, as they come.

A trial begins at the phase ``approach`` of ``/experiment/phase``. Where nobody publishes that
topic, it begins when the tool comes down again after a recovery; and in any case when time jumps,
as between two replayed bags.
"""

from bisect import bisect_right
from collections import deque
import math
from typing import Final

from hapticvision_ros.bag.contract import (
    CONTACT_TIME,
    DETECTED_PHASE,
    HOLD_TIME,
    PHASE,
    RELEASE_TIME,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.core.segmentation import OnlineSegmenter, PhaseEvent, SegmentationOptions
from hapticvision_ros.nodes.clock import CLOCK, EXACT_REPLAY, MessageClock
from hapticvision_ros.nodes.conversions import (
    contact_force,
    ns_from_stamp,
    scalar_to_message,
    text_to_message,
)
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Heard, Level, worst
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.qos import create_publisher
from hapticvision_ros.nodes.runtime import CellNode, run
import numpy as np
from rclpy.clock import Clock, ClockType

NAME: Final = 'phase_segmenter'

PARAMETERS: Final = (
    EXACT_REPLAY,
    ParameterSpec(
        'contact_sigmas',
        'double',
        '-',
        'Force above its baseline that is a contact, in standard deviations of the noise.',
        1.0,
        100.0,
        read_only=True,
    ),
    ParameterSpec(
        'rest_band',
        'double',
        '-',
        'Part of the travel since contact within which a tool that stays is at rest.',
        0.0001,
        0.4,
        read_only=True,
    ),
    ParameterSpec(
        'rest_slowdown',
        'double',
        '-',
        'A tool at rest takes so many times longer to cross that band than while pushing.',
        1.1,
        1000.0,
        read_only=True,
    ),
    ParameterSpec(
        'loss_fraction',
        'double',
        '-',
        'Part of the peak force below which a withdrawn tool is free.',
        0.0001,
        0.4,
        read_only=True,
    ),
    ParameterSpec(
        'approach_travel',
        'double',
        'm',
        'How far a tool comes down after a recovery when it approaches again.',
        0.0001,
        0.1,
        read_only=True,
    ),
    ParameterSpec(
        'longest_pause',
        'double',
        's',
        'Samples that pause for longer, or whose time goes back by more, are of another trial.',
        1.0,
        36000.0,
        read_only=True,
    ),
    ParameterSpec(
        'tick_period',
        'double',
        's',
        'Period at which messages are taken.',
        0.005,
        0.2,
        read_only=True,
    ),
)

_TICKS: Final = 1000
_REMEMBERED: Final = 20000
"""Samples that may be used before it is heard that a trial has begun."""
_PATIENCE: Final = 25
"""A stream that is silent for so many periods is not waited for."""
_AGAIN_NS: Final = 1_000_000_000
"""A stream whose newest stamp goes back by more is one that is played again [ns]."""
_BEGIN, _HEIGHT, _FORCE, _LAST = range(4)
_FOUND_BY: Final = {
    'release': ('contact',),
    'recover': ('contact',),
    'done': ('contact', 'release'),
}
"""What has been found in the signals by the time that the arm is told so: later it is missed."""
_NS_PER_S: Final = 1e9

type _Sample = tuple[int, int, float]


class PhaseSegmenter(CellNode):
    """The node."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        self._options = SegmentationOptions(
            contact_sigmas=values.real('contact_sigmas'),
            rest_band=values.real('rest_band'),
            rest_slowdown=values.real('rest_slowdown'),
            loss_fraction=values.real('loss_fraction'),
        )
        self._approach_travel = values.real('approach_travel')
        self._longest_pause_ns = round(values.real('longest_pause') * _NS_PER_S)
        self._message_clock = MessageClock(self)
        self._segmenter = OnlineSegmenter(self._options)
        self._start_ns: int | None = None
        self._newest_ns = 0
        self._begun_ns: int | None = None
        self._waiting: list[_Sample] = []
        self._used: deque[_Sample] = deque(maxlen=_REMEMBERED)
        self._newest: dict[int, int] = {}
        self._alone = 0
        self._told: str | None = None
        self._commanded = False
        self._command: str | None = None
        self._found: dict[str, float] = {}
        self._no_numbers = 0
        self._highest: float | None = None
        self._force_heard = Heard(f'The force on {WRENCH.name}', 'force')
        self._height_heard = Heard(f'The tool height on {TOOL_HEIGHT.name}', 'tool_height')
        self._silence = _PATIENCE * values.real('tick_period')

        exact = self._message_clock.exact
        self._phase_intake = Intake.of(self, PHASE)
        self._wrench_intake = Intake.of(self, WRENCH, reliable=exact)
        self._height_intake = Intake.of(self, TOOL_HEIGHT, reliable=exact)
        self._phase_publisher = create_publisher(self, DETECTED_PHASE)
        self._time_publishers = {
            'contact': create_publisher(self, CONTACT_TIME),
            'hold': create_publisher(self, HOLD_TIME),
            'release': create_publisher(self, RELEASE_TIME),
        }
        diagnostics = self._diagnostics = Diagnostics(self)
        diagnostics.add('streams', self._find_streams)
        diagnostics.add('phase', self._find_phase)
        self.create_timer(
            values.real('tick_period'),
            self._on_tick,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def _on_tick(self) -> None:
        """Take what has come, and give it to the segmenter in the order of time."""
        told = [(sent, message.data) for message, sent, _ in self._phase_intake.take()]
        phases = [(sent, phase == 'approach') for sent, phase in told]
        forces = [
            (ns_from_stamp(message.header.stamp), _FORCE, contact_force(message))
            for message, _, _ in self._wrench_intake.take()
        ]
        heights = [(sent, float(message.data)) for message, sent, _ in self._height_intake.take()]
        self._force_heard.note(len(forces))
        self._height_heard.note(len(heights))
        self._command = told[-1][1] if told else self._command
        # After the messages, so that the tick that was sent before each of them is there.
        self._message_clock.update()
        self._commanded = self._commanded or bool(phases)
        begins = self._times([sent for sent, begins in phases if begins])
        stamps = self._times([sent for sent, _ in heights])
        self._message_clock.forget(_TICKS)
        self._take(
            forces,
            [
                (stamp, _HEIGHT, value)
                for stamp, (_, value) in zip(stamps, heights[: len(stamps)], strict=True)
            ],
            [(stamp, _BEGIN, 0.0) for stamp in begins],
        )

    def _take(self, forces: list[_Sample], heights: list[_Sample], begins: list[_Sample]) -> None:
        """Let samples wait until all of their time have come."""
        self._waiting += forces + heights + begins
        for kind, samples in ((_FORCE, forces), (_HEIGHT, heights)):
            if not samples:
                continue
            newest = max(stamp for stamp, _, _ in samples)
            if self._newest.get(kind, newest) - newest > _AGAIN_NS:
                # Played again: how far the other stream had come is of no use any more.
                self._newest.clear()
            self._newest[kind] = newest
        self._alone = 0 if forces and heights else self._alone + 1
        self._use()

    def _times(self, sent: list[int]) -> list[int]:
        """Return when messages were measured [ns], given when they were sent."""
        times: list[int] = self._message_clock.times(np.array(sent, dtype=np.int64)).tolist()
        return times

    def _use(self) -> None:
        """Use all up to where both streams have come, or all if one of them has stopped."""
        self._waiting.sort()
        first = len(self._waiting)
        if self._alone < _PATIENCE:
            first = 0
            if len(self._newest) == len((_FORCE, _HEIGHT)):
                first = bisect_right(self._waiting, (min(self._newest.values()), _LAST, 0.0))
        ready = self._waiting[:first]
        del self._waiting[:first]
        for sample in ready:
            samples = self._of_trial(sample[0]) if sample[1] == _BEGIN else [sample]
            for stamp, kind, value in samples:
                self._add(stamp, kind == _FORCE, value)
                self._used.append((stamp, kind, value))

    def _of_trial(self, begun_ns: int) -> list[_Sample]:
        """
        Begin a trial, and return what is of it of the samples that have been used.

        On a busy machine the news of the beginning may come after them. A trial that begins when
        the last one did is played again.
        """
        again = self._begun_ns is not None and begun_ns <= self._begun_ns
        end_ns = begun_ns + self._longest_pause_ns
        late = [] if again else [one for one in self._used if begun_ns <= one[0] < end_ns]
        self._begun_ns = begun_ns
        self._used.clear()
        self._begin()
        return late

    def _begin(self) -> None:
        """Begin a new trial."""
        self._segmenter = OnlineSegmenter(self._options)
        self._start_ns = None
        self._highest = None
        self._found = {}
        self._tell('approach')

    def _add(self, stamp: int, is_force: bool, value: float) -> None:
        """Give the segmenter one sample."""
        if not math.isfinite(value):
            self._no_numbers += 1
            return
        if self._start_ns is not None and abs(stamp - self._newest_ns) > self._longest_pause_ns:
            self._begun_ns = None
            self._used.clear()
            self._begin()
        if self._start_ns is None:
            self._start_ns = self._newest_ns = stamp
            self._tell(self._segmenter.phase)
        self._newest_ns = max(self._newest_ns, stamp)
        t = (stamp - self._start_ns) / _NS_PER_S
        if is_force:
            events = self._segmenter.add_force(t, value)
        else:
            events = self._segmenter.add_height(t, value)
            self._watch_approach(value)
        for event in events:
            self._on_event(event)

    def _watch_approach(self, height: float) -> None:
        """Without a commanded phase: see whether the tool comes down for the next trial."""
        if self._commanded or self._segmenter.phase != 'recover':
            return
        if self._highest is None or height > self._highest:
            self._highest = height
        elif self._highest - height > self._approach_travel:
            self._begin()

    def _on_event(self, event: PhaseEvent) -> None:
        self._found[event.kind] = event.t
        publisher = self._time_publishers.get(event.kind)
        if publisher is not None and self._start_ns is not None:
            publisher.publish(scalar_to_message(self._start_ns / _NS_PER_S + event.t))
        self._tell(self._segmenter.phase)

    def _tell(self, phase: str) -> None:
        if phase != self._told:
            self._told = phase
            self._phase_publisher.publish(text_to_message(phase))
            self._diagnostics.hasten()

    def _find_streams(self) -> Finding:
        """Return which of the signals are missing."""
        findings = [
            Finding(
                Level.OK,
                '',
                {'waiting': len(self._waiting), 'no_numbers': self._no_numbers},
            ),
            *(heard.finding(self._silence) for heard in (self._force_heard, self._height_heard)),
        ]
        if self._message_clock.replay and not self._message_clock.matched:
            # Without it no message of a replay has a time, and nothing is used.
            findings.append(Finding(Level.WARN, f'Nobody tells the time on {CLOCK}.'))
        return worst(findings, 'Force and tool height come.')

    def _find_phase(self) -> Finding:
        """Return what has been found in the signals, and what is missed in them."""
        began = self._start_ns is not None
        values: dict[str, object] = {
            'phase': self._told,
            'commanded': self._command,
            'trial_s': (self._newest_ns - (self._start_ns or 0)) / _NS_PER_S if began else None,
            **{f'{kind}_s': t for kind, t in self._found.items()},
        }
        if not began:
            return Finding(Level.OK, 'No sample of a trial has come yet.', values)
        missed = [one for one in _FOUND_BY.get(self._command or '', ()) if one not in self._found]
        if missed:
            said = (
                f"The arm is at '{self._command}', but the signals show no "
                f'{" and no ".join(missed)}.'
            )
            return Finding(Level.WARN, said, values)
        return Finding(Level.OK, f"The signals show the phase '{self._told}'.", values)


def main() -> int:
    """Run the node."""
    return run(PhaseSegmenter)

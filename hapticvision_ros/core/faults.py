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
The table of faults that a cell must survive, and what a cell of the table has to show.

Each row is one trial on the simulated cell, in which one thing goes wrong in one phase. What is
measured is the truth of the simulation: the force and the motion as they are, not as any node of
the cell sees them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

type Action = Literal[
    'kill', 'hang', 'distort', 'disk', 'call', 'emergency', 'parameters', 'goal', 'again', 'clock'
]

PHASES: Final = ('approach', 'push', 'hold', 'release', 'recover')
"""Phases of a push in which something may go wrong."""
NEAR: Final = 'near the limit'
"""
In the push too: an object so hard that a push which nobody stops is a quarter over the force
limit, and a force that is nearly there.
"""

ARM: Final = 'arm_push_controller'
LOAD_CELL: Final = 'load_cell_driver'
ORCHESTRATOR: Final = 'experiment_orchestrator'
RANGE: Final = 'range_sensor_driver'
NODES: Final = (
    ARM,
    LOAD_CELL,
    ORCHESTRATOR,
    RANGE,
    'contact_point_planner',
    'phase_segmenter',
    'rheology_fitter',
)

STOP_WITHIN: Final = 0.8
"""A tool that must stop goes down no longer than this after the fault [s]: 0.3 s until a reading
is stale, and what a busy machine takes. The pushes of the campaign last 2 s."""
STOP_WITHOUT_HEARTBEAT: Final = 1.2
"""The same where only the heartbeat is missed, for 0.7 s [s]."""
CLOCK_STEPS: Final = {
    '50 ms ahead': 0.05,
    '50 ms back': -0.05,
    'a second ahead': 1.0,
    'a second back': -1.0,
    'an hour ahead': 3600.0,
    'an hour back': -3600.0,
}
"""By how much the machine's clock is set [s]."""
LARGEST_LOSS: Final = 1.0
"""The last second may be lost with a recorder that dies [s]."""
LARGEST_OVERSHOOT: Final = 0.1
"""Share of the force limit by which a stop may come late."""
TOLD_TO_STOP: Final = {
    'stop': '/arm_push_controller/stop',
    'disable': '/arm_push_controller/enable',
    'cancel': '/experiment/cancel',
    'deactivate': '/arm_push_controller/change_state',
}


@dataclass(frozen=True, slots=True)
class Fault:
    """
    One cell of the table.

    Parameters
    ----------
    action : str
        What the campaign does.
    target : str
        The node, the stream of the simulated world or the request that it does it to.
    phase : str
        When: one of `PHASES`, `NEAR`, or `start` for before the goal is sent.
    how : str
        Further detail, such as the kind of distortion.
    must_stop : bool
        Whether the push must not go on, nor be called complete.

    """

    action: Action
    target: str
    phase: str
    how: str = ''
    must_stop: bool = True

    @property
    def stop_within(self) -> float:
        """Return how long after it a tool that must stop may go down [s]."""
        silent = self.target == ORCHESTRATOR and self.action in ('kill', 'hang')
        return STOP_WITHOUT_HEARTBEAT if silent else STOP_WITHIN

    @property
    def line(self) -> str:
        """Return what goes wrong and when, as a list of the table tells it."""
        return f'{self.name} in {self.phase}'

    @property
    def name(self) -> str:
        """Return what goes wrong, in words."""
        match self.action:
            case 'kill':
                return f'{self.target} killed'
            case 'hang':
                return f'{self.target} hangs'
            case 'distort':
                return f'{self.target} {self.how}'
            case 'emergency':
                return 'emergency stop'
            case 'call':
                return f'told to {self.target}'
            case 'parameters':
                return f'{self.target} gets garbage parameters'
            case 'clock':
                return f"machine's clock set {self.how}"
            case 'again':
                return 'a second goal is sent'
            case _:
                return f'{self.target}: {self.how}'


def _distortions() -> Iterable[Fault]:
    """Yield what the devices may do wrong: name, and whether the push has to stop for it."""
    sensors = {
        # What a load cell says counts for the touch and for the limit. A single wrong reading may
        # stop the push or be overtaken by the next one. Stamps that jump back and stay there are
        # taken for a clock that was set: the readings are as fresh as before.
        'force': {
            'silent': True,
            'late': True,
            'slow': False,
            'noisy': False,
            'nan': True,
            'saturated': True,
            'frozen': True,
            'an hour ahead': False,
            'an hour back': False,
            'lossy': False,
            'twice': False,
            'swapped': False,
            'spike': False,
            'garbage': False,
        },
        'arm': {
            'silent': True,
            'late': True,
            'slow': False,
            'noisy': False,
            'nan': True,
            'frozen': True,
            'an hour ahead': False,
            'an hour back': False,
            'lossy': False,
            'twice': False,
            'swapped': False,
            'spike': False,
            'garbage': False,
            'deaf': False,
        },
        # Nothing that moves the arm relies on the range sensor during a push.
        'shape': dict.fromkeys(
            (
                'silent',
                'late',
                'slow',
                'noisy',
                'nan',
                'frozen',
                'an hour ahead',
                'an hour back',
                'lossy',
                'twice',
                'swapped',
                'spike',
                'garbage',
            ),
            False,
        ),
    }
    for stream, kinds in sensors.items():
        for how, must_stop in kinds.items():
            yield Fault('distort', stream, 'push', how, must_stop)
    for stream, how in (('force', 'silent'), ('force', 'nan'), ('arm', 'silent'), ('arm', 'nan')):
        yield Fault('distort', stream, 'approach', how)
        yield Fault('distort', stream, 'hold', how)
    # A force that stands still in the air is found out in time, or by the missing touch.
    yield Fault('distort', 'force', 'approach', 'frozen')


def _near_the_limit() -> Iterable[Fault]:
    """Yield what may go wrong just before the force limit: a push stops, if not for it, there."""
    for node in (ARM, LOAD_CELL, ORCHESTRATOR):
        yield Fault('kill', node, NEAR)
        yield Fault('hang', node, NEAR)
    for how in ('silent', 'late', 'slow', 'noisy', 'nan', 'saturated', 'frozen', 'an hour back'):
        yield Fault('distort', 'force', NEAR, how)
    for how in ('lossy', 'twice', 'swapped', 'garbage'):
        yield Fault('distort', 'force', NEAR, how)
    for how in ('silent', 'late', 'nan', 'frozen', 'garbage'):
        yield Fault('distort', 'arm', NEAR, how)


def _clock_steps() -> Iterable[Fault]:
    """Yield when the clock of the whole machine may be set, under all nodes at once."""
    for how in CLOCK_STEPS:
        yield Fault('clock', 'clock', 'push', how)
    for how in ('an hour ahead', 'an hour back'):
        for phase in ('approach', 'hold', NEAR):
            yield Fault('clock', 'clock', phase, how)


def table() -> tuple[Fault, ...]:
    """Return all cells of the table; one node does not die twice in a row."""
    faults: list[Fault] = []
    for phase in PHASES:
        faults += [
            Fault('kill', node, phase, must_stop=node in (ARM, LOAD_CELL, ORCHESTRATOR))
            for node in NODES
        ]
        faults.append(Fault('emergency', 'emergency stop', phase))
    faults += [
        Fault('hang', node, phase, must_stop=node != RANGE)
        for phase in ('push', 'hold')
        for node in (ARM, LOAD_CELL, ORCHESTRATOR, RANGE)
    ]
    faults += _distortions()
    faults += _near_the_limit()
    faults += _clock_steps()
    faults += [Fault('call', target, 'push') for target in TOLD_TO_STOP]
    faults += [
        Fault('parameters', node, phase, must_stop=False)
        for node, phase in (*((node, 'push') for node in NODES), (ARM, 'hold'))
    ]
    faults += [
        Fault('again', ORCHESTRATOR, 'push', must_stop=False),
        Fault('goal', 'force limit', 'push', 'the object is harder than it may be'),
        Fault('goal', 'goal', 'start', 'deeper than the arm allows'),
        Fault('goal', 'goal', 'start', 'into a folder that cannot be written'),
        Fault('disk', 'disk', 'push', 'full'),
        Fault('disk', 'disk', 'hold', 'full'),
    ]
    return tuple(faults)


@dataclass(frozen=True, slots=True)
class Measured:
    """
    What a cell of the table has shown.

    Parameters
    ----------
    outcome : str
        How the experiment ended, in a word.
    peak_force, force_limit : float
        Largest true force on the tool, and what is allowed [N].
    stopped : float or None
        How long after the fault the tool last went down [s]; None if there was no fault to count
        from.
    clear : float or None
        How long after it the tool last touched the object [s]; None if it still does.
    bag_expected : bool
        Whether something was to be recorded.
    readable : bool
        Whether what was recorded reads back.
    kept, lost : float
        Recorded time, and recorded time before the fault or the end that is not in the bag [s].
    trouble : str
        What else was not as it has to be; empty if nothing.

    """

    outcome: str
    peak_force: float
    force_limit: float
    stopped: float | None
    clear: float | None
    bag_expected: bool
    readable: bool
    kept: float
    lost: float
    trouble: str = ''

    @property
    def over_limit(self) -> float:
        """Return by how much the force went beyond its limit [N]."""
        return max(0.0, self.peak_force - self.force_limit)


def verdict(fault: Fault, measured: Measured) -> str:
    """Return `safe`, or what is not, in a few words."""
    found = []
    if measured.over_limit > LARGEST_OVERSHOOT * measured.force_limit:
        found.append('too much force')
    stopped = measured.stopped
    if fault.must_stop and stopped is not None and stopped > fault.stop_within:
        found.append('went on')
    if fault.must_stop and measured.outcome == 'complete':
        found.append('was not noticed')
    if measured.clear is None:
        found.append('left in contact')
    if measured.bag_expected and not measured.readable:
        found.append('bag does not read back')
    if measured.lost > LARGEST_LOSS:
        found.append('data lost')
    if measured.trouble:
        found.append(measured.trouble)
    return '; '.join(found) or 'safe'


def _number(value: float | None, digits: int) -> str:
    return '-' if value is None else f'{value:.{digits}f}'


COLUMNS: Final = (
    'fault',
    'phase',
    'outcome',
    'peak force [N]',
    'over limit [N]',
    'time to safe [s]',
    'clear of the object [s]',
    'kept [s]',
    'lost [s]',
    'verdict',
)


def row(fault: Fault, measured: Measured) -> tuple[str, ...]:
    """Return a cell of the table as texts, in the order of `COLUMNS`."""
    return (
        fault.name,
        fault.phase,
        measured.outcome,
        _number(measured.peak_force, 2),
        _number(measured.over_limit, 2),
        _number(measured.stopped, 2),
        _number(measured.clear, 2),
        _number(measured.kept, 1),
        _number(measured.lost, 2),
        verdict(fault, measured),
    )


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return the table as Markdown."""
    lines = [COLUMNS, ('---',) * len(COLUMNS), *rows]
    return ''.join(f'| {" | ".join(line)} |\n' for line in lines)

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
Fit each trial as soon as it is over, and publish what it tells.

A trial begins at the phase ``approach``, or at ``/rheology_fitter/reset``, from where all is kept,
and ends at ``done``; ``/rheology_fitter/fit`` ends one that nobody else ends. The coefficients are
published as soon as the paper's method has them; the result follows once the three-element model
is fitted to the whole waveform. The numbers are those of ``hapticvision fit --model
three-element`` on a bag of the same messages: both run the same code on the same bytes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import auto, Enum
import math
import queue
import time
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from hapticvision_ros.bag.contract import (
    C1,
    C2,
    FIT,
    K1,
    PHASE,
    POINTS,
    RESET,
    RHEOLOGY_RESULT,
    TOOL_HEIGHT,
    TOPICS,
    WRENCH,
)
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.pipeline import analyse, TrialAnalysis
from hapticvision_ros.core.records import Estimate
from hapticvision_ros.nodes.clock import CLOCK, EXACT_REPLAY, MessageClock, Nanoseconds
from hapticvision_ros.nodes.conversions import scalar_to_message, status_to_message
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Heard, Level, worst
from hapticvision_ros.nodes.fit_kernels import compile_apart, missing
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.qos import create_publisher, create_service
from hapticvision_ros.nodes.runtime import CellNode, run
from hapticvision_ros.nodes.trial_buffer import TrialBuffer
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

NAME: Final = 'rheology_fitter'

PARAMETERS: Final = (
    EXACT_REPLAY,
    ParameterSpec(
        'displacement_from_points',
        'bool',
        '-',
        'Whether to compute the displacement height from the clouds, where no node publishes it.',
        read_only=True,
    ),
    ParameterSpec(
        'displacement_source',
        'string',
        '-',
        "What /object/displacement_height is: the object's own, or the tool's while they touch.",
        choices=('object', 'tool'),
    ),
    ParameterSpec(
        'grace_time',
        'double',
        's',
        'How long after the end of a trial its late messages are waited for.',
        0.0,
        10.0,
    ),
    ParameterSpec(
        'quiet_time',
        'double',
        's',
        'A load cell and an arm that are silent for so long send nothing more of the trial.',
        0.05,
        10.0,
    ),
    ParameterSpec(
        'memory',
        'integer',
        'byte',
        'Room for the numbers of a trial, and for its clouds.',
        1 << 20,
        1 << 34,
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

SYMBOLS: Final = (
    ('relaxation_time', 's'),
    ('F0', 'N'),
    ('F_inf', 'N'),
    ('retardation_time', 's'),
    ('H0', 'm'),
    ('H_inf', 'm'),
    ('K1', 'N/m'),
    ('C1', 'N.s/m'),
    ('C2', 'N.s/m'),
)
"""Names and units of the estimates, as in `hapticvision_ros.core.fit.paper.PaperResult`."""

WHOLE: Final = 'whole.'
"""What the keys begin with that tell of the fit to the whole waveform."""
MISS: Final = f'{WHOLE}force_rmse'
MISS_BY_NOISE: Final = f'{WHOLE}force_rmse_over_noise'
"""What it leaves of the force."""

TRIAL: Final = 'trial'
"""Key of the number that `/rheology_fitter/reset` has answered."""

_TICKS_BEFORE_A_TRIAL: Final = 1000


class _State(Enum):
    COLLECTING = auto()
    ENDING = auto()
    IDLE = auto()


_DOING: Final = {
    _State.COLLECTING: 'A trial is kept, or what may become one.',
    _State.ENDING: 'The trial is over: its last messages are waited for.',
    _State.IDLE: 'No trial is under way.',
}


@dataclass(frozen=True, slots=True)
class _Job:
    """A trial that is over, as it was received."""

    number: int
    buffer: TrialBuffer
    times: Mapping[str, Nanoseconds]
    source: str


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What a trial tells; `whole` is None before the fit to the whole waveform has ended."""

    number: int
    analysis: TrialAnalysis | InputError
    whole: Mapping[str, str] | None = None


def result_values(analysis: TrialAnalysis) -> dict[str, str]:
    """
    Return all that a trial tells, as the key-value pairs of ``/rheology/result``.

    Parameters
    ----------
    analysis : TrialAnalysis
        Of the trial.

    Returns
    -------
    dict of str to str
        For each estimate ``<symbol>.value``, ``.std`` and ``.unit``, or ``.reason``; the times of
        the phases [s since the first stamp] and that stamp; each warning.

    """
    values: dict[str, str] = {}
    for symbol, unit in SYMBOLS:
        values |= _pairs(symbol, getattr(analysis.paper, symbol), unit)
    segmentation = analysis.segmentation
    values['start_ns'] = str(analysis.trial.start_ns)
    for name in ('t_contact', 't_hold', 't_release', 't_loss', 't_end'):
        t = getattr(segmentation, name)
        if t is not None:
            values[f'{name}_s'] = repr(float(t))
    for name, unit in (('push_speed', 'm_s'), ('depth', 'm')):
        value = getattr(segmentation, name)
        if value is not None:
            values[f'{name}_{unit}'] = repr(float(value))
    for number, warning in enumerate(analysis.warnings, start=1):
        values[f'warning {number}'] = warning
    return values


def whole_values(analysis: TrialAnalysis) -> dict[str, str]:
    """
    Fit the three-element model to the whole waveform of a trial.

    Parameters
    ----------
    analysis : TrialAnalysis
        Of the trial.

    Returns
    -------
    dict of str to str
        ``whole.model``, for each of its parameters the same pairs as in `result_values`, by how
        much it misses the force [N], and over the noise before contact where that is known, and
        each warning of the fit; or ``whole.reason`` where the trial cannot be fitted.

    """
    # These take longer to import than a node may take to answer.
    from hapticvision_ros.core.composition import Model
    from hapticvision_ros.core.fit.campaign import fit

    model = Model()
    values = {f'{WHOLE}model': model.name}
    try:
        found = fit([analysis], model)
    except UsageError as error:
        return values | {f'{WHOLE}reason': str(error)}
    for name, unit in zip(model.names, model.units, strict=True):
        values |= _pairs(f'{WHOLE}{name}', found.parameters[name], unit)
    values |= _pairs(MISS, Estimate(found.force_rmse), 'N')
    chi2 = found.force_chi2
    if chi2 is not None:
        values |= _pairs(MISS_BY_NOISE, Estimate(math.sqrt(chi2)), '-')
    for number, warning in enumerate(found.warnings, start=1):
        values[f'{WHOLE}warning {number}'] = warning
    return values


def _pairs(key: str, estimate: Estimate, unit: str) -> dict[str, str]:
    """Return an estimate as key-value pairs."""
    values = {}
    if estimate.value is not None:
        values[f'{key}.value'] = repr(float(estimate.value))
        values[f'{key}.unit'] = unit
    if estimate.std is not None and math.isfinite(estimate.std):
        values[f'{key}.std'] = repr(float(estimate.std))
    if estimate.reason is not None:
        values[f'{key}.reason'] = estimate.reason
    return values


def summary(analysis: TrialAnalysis) -> str:
    """Return the parameters in one line."""
    parts = []
    for symbol, unit in (('K1', 'N/m'), ('C1', 'N.s/m'), ('C2', 'N.s/m')):
        estimate: Estimate = getattr(analysis.paper, symbol)
        if estimate.value is None:
            parts.append(f'{symbol} unknown ({estimate.reason})')
        elif estimate.std is None:
            parts.append(f'{symbol} = {estimate.value:.4g} {unit}')
        else:
            parts.append(f'{symbol} = {estimate.value:.4g} +- {estimate.std:.2g} {unit}')
    return ', '.join(parts)


class RheologyFitter(CellNode):
    """The node: its timer takes the messages, a thread of its own fits."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        self._message_clock = MessageClock(self)
        self._buffer = TrialBuffer(self.parameters.integer('memory'))
        self._state = _State.COLLECTING
        # Whether someone has said where the trial begins; else it begins at the approach.
        self._reset = False
        self._ended_ns: int | None = None
        self._heard = time.monotonic()
        self._trials = 0
        self._fitted = 0
        self._aborted = False
        self._compiling = False
        self._last: Finding | None = None
        self._needed = {
            WRENCH: Heard(f'The force on {WRENCH.name}', 'force'),
            TOOL_HEIGHT: Heard(f'The tool height on {TOOL_HEIGHT.name}', 'tool_height'),
        }
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._outcomes: queue.SimpleQueue[_Outcome] = queue.SimpleQueue()

        wanted = self.parameters.flag('displacement_from_points')
        # The phase first: the samples that come with it are of the trial that it begins.
        topics = (PHASE, *(t for t in TOPICS if t is not PHASE and (wanted or t is not POINTS)))
        exact = self._message_clock.exact
        self._intakes = {
            topic: Intake.of(self, topic, raw=True, reliable=exact) for topic in topics
        }
        self._coefficients = {
            symbol: create_publisher(self, topic)
            for symbol, topic in (('K1', K1), ('C1', C1), ('C2', C2))
        }
        self._result = create_publisher(self, RHEOLOGY_RESULT)
        create_service(self, FIT, self._on_fit)
        create_service(self, RESET, self._on_reset)
        diagnostics = self._diagnostics = Diagnostics(self)
        diagnostics.add('trial', self._find_trial)
        diagnostics.add('result', self._find_result)
        self.create_timer(
            self.parameters.real('tick_period'),
            self._on_tick,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self.spawn(self._work, 'fit')

    def close(self) -> None:
        """Stop, and let go of the trial."""
        super().close()
        self._buffer.close()

    def _on_fit(self, request: Any, response: Any) -> Any:
        """End the trial as if it were done."""
        self._take()
        response.success = len(self._buffer) > 0
        if response.success:
            self._end(None)
            response.message = (
                f'fitting {len(self._buffer)} messages: see {self._result.topic_name}'
            )
        else:
            response.message = 'nothing has been received since the last trial began.'
        return response

    def _on_reset(self, request: Any, response: Any) -> Any:
        """
        Forget the trial, and keep all that comes from now on.

        The answer is its number, the topics that are heard, and with a question mark those that
        nobody publishes so far.
        """
        self._take()
        self._begin()
        self._reset = True
        self._message_clock.forget(0)
        heard = [
            topic.name if intake.matched else f'{topic.name}?'
            for topic, intake in self._intakes.items()
        ]
        if self._message_clock.matched:
            heard.append(CLOCK)
        response.success = True
        response.message = ' '.join([str(self._trials + 1), *heard])
        return response

    def _on_tick(self) -> None:
        self._take()
        if self._state is _State.ENDING and self._is_complete():
            self._hand_over()
        while not self._outcomes.empty():
            self._publish(self._outcomes.get())

    def _take(self) -> None:
        """Keep what has come."""
        for topic, intake in self._intakes.items():
            for data, sent_ns, _ in intake.take():
                if topic is PHASE:
                    self._on_phase(str(deserialize_message(data, String).data), sent_ns)
                if topic in self._needed:
                    self._heard = time.monotonic()
                    self._needed[topic].note()
                if self._state is not _State.IDLE:
                    self._buffer.add(topic, data, sent_ns)
        # After the messages, so that the tick that was sent before each of them is there.
        self._message_clock.update()

    def _on_phase(self, phase: str, sent_ns: int) -> None:
        if phase == 'approach':
            if not self._reset:
                self._begin()
            self._reset = False
        elif phase == 'done' and self._state is _State.COLLECTING:
            self._end(sent_ns)
        elif phase == 'aborted' and self._state is _State.COLLECTING:
            self._state = _State.IDLE
            self._aborted = True

    def _begin(self) -> None:
        """Begin a new trial with empty hands."""
        if self._state is _State.ENDING:
            self._hand_over()
        self._buffer.close()
        self._buffer = TrialBuffer(self.parameters.integer('memory'))
        self._message_clock.forget(_TICKS_BEFORE_A_TRIAL)
        self._state = _State.COLLECTING
        self._aborted = False
        self._ended_ns = None

    def _end(self, sent_ns: int | None) -> None:
        self._state = _State.ENDING
        self._ended_ns = sent_ns
        self._heard = time.monotonic()

    def _is_complete(self) -> bool:
        """Return whether nothing of the trial is still on its way."""
        if time.monotonic() - self._heard > self.parameters.real('quiet_time'):
            return True
        if self._ended_ns is None:
            return False
        after = self._ended_ns + round(self.parameters.real('grace_time') * 1e9)
        newest = [self._buffer.newest_sent(topic) for topic in (WRENCH, TOOL_HEIGHT)]
        return all(sent is not None and sent > after for sent in newest)

    def _hand_over(self) -> None:
        """Give the trial to the thread that fits."""
        self._trials += 1
        times = {
            name: self._message_clock.times(sent) for name, sent in self._buffer.sent().items()
        }
        source = self.parameters.text('displacement_source')
        self._jobs.put(_Job(self._trials, self._buffer, times, source))
        self._buffer = TrialBuffer(self.parameters.integer('memory'))
        self._state = _State.IDLE

    def _work(self) -> None:
        """Fit one trial after the other."""
        if missing():
            self._compiling = True
            self.get_logger().info('compiling the fit, as once after an installation')
            compile_apart(self.stopping)
            self._compiling = False
        while not self.stopping.is_set():
            try:
                job = self._jobs.get(timeout=0.1)
            except queue.Empty:
                continue
            try:
                provenance = {'displacement_source': job.source}
                trial = job.buffer.trial(f'trial {job.number}', job.times, provenance)
                analysis = analyse(trial)
            except InputError as error:
                self._outcomes.put(_Outcome(job.number, error))
                continue
            finally:
                job.buffer.close()
            self._outcomes.put(_Outcome(job.number, analysis))
            self._outcomes.put(_Outcome(job.number, analysis, whole_values(analysis)))

    def _find_trial(self) -> Finding:
        """Return what is kept of the trial at hand, and what it lacks."""
        buffer = self._buffer
        values: dict[str, object] = {
            'trial': self._trials + (self._state is not _State.IDLE),
            'state': self._state.name.lower(),
            'messages': len(buffer),
            'forces': buffer.count(WRENCH),
            'tool_heights': buffer.count(TOOL_HEIGHT),
            'left_out': buffer.left_out,
        }
        findings = [Finding(Level.OK, '', values)]
        longest = self.parameters.real('quiet_time')
        findings += [heard.finding(longest) for heard in self._needed.values()]
        if buffer.left_out:
            said = f'{buffer.left_out} messages of the trial found no room: raise memory.'
            findings.append(Finding(Level.WARN, said))
        if self._aborted:
            said = 'The push was aborted: the trial is not fitted.'
            findings.append(Finding(Level.WARN, said))
        return worst(findings, _DOING[self._state])

    def _find_result(self) -> Finding:
        """Return what the last trial has told, or why nothing."""
        values: dict[str, object] = {'trials': self._trials, 'fitted': self._fitted}
        last = self._last
        if self._fitted < self._trials and self._compiling:
            said = f'Trial {self._fitted + 1} waits for the fit to be compiled, once.'
            return Finding(Level.OK, said, values)
        if self._fitted < self._trials:
            return Finding(Level.OK, f'Trial {self._fitted + 1} is being fitted.', values)
        if last is None:
            return Finding(Level.OK, 'No trial has come to its end yet.', values)
        return Finding(last.level, last.message, values | dict(last.values))

    def _remember(self, number: int, level: Level, message: str) -> None:
        """Keep what a trial has told for the diagnostics."""
        self._fitted = number
        self._last = Finding(level, message, {TRIAL: number})
        self._diagnostics.hasten()

    def _publish(self, outcome: _Outcome) -> None:
        result = outcome.analysis
        if isinstance(result, InputError):
            said = f'Trial {outcome.number} gave no result: {result}'
            self._remember(outcome.number, Level.WARN, said)
            values = {TRIAL: str(outcome.number)}
            message = status_to_message('rheology', str(result), values)
            message.level = DiagnosticStatus.ERROR
            self.get_logger().error(str(result))
            self._result.publish(message)
            return
        text = summary(result)
        estimates = {symbol: getattr(result.paper, symbol) for symbol in self._coefficients}
        if outcome.whole is None:
            for symbol, publisher in self._coefficients.items():
                if estimates[symbol].value is not None:
                    publisher.publish(scalar_to_message(estimates[symbol].value))
            self.get_logger().info(f'{result.trial.name}: {text}')
            return
        values = {TRIAL: str(outcome.number), **result_values(result), **outcome.whole}
        known = all(estimate.known for estimate in estimates.values())
        self._result.publish(status_to_message('rheology', text, values, warning=not known))
        level = Level.OK if known else Level.WARN
        self._remember(outcome.number, level, f'{result.trial.name}: {text}.')
        self.get_logger().info(f'{result.trial.name}, whole waveform: {_told(outcome.whole)}')


def _told(whole: Mapping[str, str]) -> str:
    """Return the fit to the whole waveform in one line."""
    if f'{WHOLE}reason' in whole:
        return whole[f'{WHOLE}reason']
    parts = []
    for name in ('K1', 'C1', 'C2'):
        key = f'{WHOLE}{name}'
        if f'{key}.value' not in whole:
            parts.append(f'{name} unknown ({whole[f"{key}.reason"]})')
            continue
        error = f' +- {float(whole[f"{key}.std"]):.2g}' if f'{key}.std' in whole else ''
        parts.append(f'{name} = {float(whole[f"{key}.value"]):.4g}{error} {whole[f"{key}.unit"]}')
    miss = f'the force is missed by {float(whole[f"{MISS}.value"]):.2g} N'
    if f'{MISS_BY_NOISE}.value' in whole:
        miss += f', {float(whole[f"{MISS_BY_NOISE}.value"]):.2g} times its noise before contact'
    return f'{", ".join(parts)}; {miss}'


def main() -> int:
    """Run the node."""
    return run(RheologyFitter)

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

"""A diagnosis in plain words, for the command line and the report."""

from hapticvision_ros.core.diagnosis.records import Bootstrap, Diagnosis, NextTrial, SCATTER
from hapticvision_ros.core.effects.declaration import LAW
from hapticvision_ros.report.quantities import format_number, format_quantity, UnitSystem


def findings(diagnosis: Diagnosis, units: UnitSystem) -> list[str]:
    """
    Return what a diagnosis says, one sentence each.

    Parameters
    ----------
    diagnosis : Diagnosis
        What the base model lacks.
    units : mapping of str to Unit
        Units of display.

    Returns
    -------
    list of str
        The answer first, then what it leaves open.

    """
    sentences = [_answer(diagnosis)]
    if diagnosis.bootstrap is not None:
        sentences.append(_chance(diagnosis.bootstrap))
    for leader, alike in zip(diagnosis.effects, diagnosis.sets, strict=True):
        others = [name for name in alike if name != leader]
        if others:
            sentences.append(
                f'These trials cannot tell {leader} from {_listed(others, "or")}: any one of '
                f'them may be the cause.'
            )
    for name in diagnosis.laws:
        effect, _, law = name.partition(LAW)
        sentences.append(
            f'It is {effect} by another law than the usual one: {law.replace("_", " ")}.'
        )
    if diagnosis.unexplained is not None:
        share = format_number(100.0 * diagnosis.unexplained.share_of_chi2, digits=2)
        sentences.append(
            f'Of the squares that the base model misses beyond the noise, {share}\u00a0% are left.'
        )
        sentences += [f'{where.rstrip(".")}.' for where in diagnosis.unexplained.where]
    if diagnosis.advice is not None:
        sentences.append(_advice(diagnosis.advice, units))
    return sentences


def _answer(diagnosis: Diagnosis) -> str:
    """Return the status as a sentence."""
    if diagnosis.status == 'none':
        return (
            'The base model explains these trials to within their noise: nothing that it lacks '
            'shows.'
        )
    # What these trials cannot tell apart has no leader for a reader.
    effects = ' and by '.join(_listed(each, 'or') for each in diagnosis.sets)
    if diagnosis.status == 'explained':
        return f'What the base model lacks is explained by {effects}.'
    if diagnosis.status == 'partly_explained':
        return f'What the base model lacks is explained in part by {effects}.'
    return 'The base model lacks something that no effect of the library explains.'


def _chance(found: Bootstrap) -> str:
    """Return what chance does as a sentence."""
    p = format_number(found.p_value, digits=2)
    return (
        f'Of {found.campaigns} campaigns that the base model simulates, chance has an effect '
        f'accepted in {found.false_alarms}; as large a gain as here has p\u00a0=\u00a0{p}.'
    )


def _advice(trial: NextTrial, units: UnitSystem) -> str:
    """Return the trial to push next as a sentence."""
    speed = format_quantity(trial.push_speed, units['speed'], digits=3)
    depth = format_quantity(trial.depth, units['length'], digits=3)
    hold = format_quantity(trial.hold_time, units['time'], digits=3)
    gain = format_number(trial.gain, digits=2)
    again = SCATTER in trial.separates
    if len(trial.separates) > 1:
        purpose = f'tell {_listed(trial.separates, "and")} apart, by {gain} standard deviations'
    else:
        purpose = f'sharpen {trial.separates[0]} by a factor of {gain}'
    times = ''
    if trial.repeats > 1:
        times = f', {trial.repeats} times'
        purpose += ' for each'
    return (
        f'Push {"again" if again else "next"} at {speed}, {depth} deep, and hold for {hold}'
        f'{times}: expected to {purpose} ({trial.reason.rstrip(".")}).'
    )


def _listed(names: tuple[str, ...] | list[str], last: str) -> str:
    """Return names as in a sentence."""
    if len(names) < 2:
        return ''.join(names)
    return f'{", ".join(names[:-1])} {last} {names[-1]}'

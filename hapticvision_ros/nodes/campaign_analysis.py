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
The analysis of a campaign in a process of its own, and the node's side of it.

It takes seconds of a processor, holds Python's lock meanwhile, and may fail: neither may keep the
node from watching over the cell. The process gets the paths of the bags and what the cell allows,
as JSON on its standard input, and answers with lines: ``doing ...`` and, at its end,
``found ...`` with JSON or ``error ...`` with a sentence. It ends when its input is closed, as it
is when the node dies. A bag that cannot be read is left out, with a warning. Kernels that are not
compiled yet, as after an installation, take longer than the analysis itself: ``compiling`` and
``compiled`` tell of the begin of one and of its end.
"""

from collections.abc import Sequence
import contextlib
import json
import os
from pathlib import Path
import subprocess
import sys
import threading
import time
from typing import Final

from hapticvision_ros.core.autonomy import Cell, Findings, look
from hapticvision_ros.core.errors import HapticVisionError, InputError, UsageError

NICENESS: Final = 10
"""What watches over the cell goes first."""
LONGEST_COMPILATION: Final = 600.0
"""A kernel that takes longer to compile than this hangs [s]."""
_COMMAND: Final = (sys.executable, '-m', 'hapticvision_ros.nodes.campaign_analysis')


class CampaignAnalysis:
    """
    One analysis under way.

    Parameters
    ----------
    bags : sequence of Path
        The trials.
    cell : Cell
        What may be pushed next.
    command : sequence of str
        What to run.

    Attributes
    ----------
    findings : Findings or None
        What it has found, once it is `over`.
    error : str
        Why it has found nothing, as a sentence.

    """

    def __init__(
        self, bags: Sequence[Path], cell: Cell, command: Sequence[str] = _COMMAND
    ) -> None:
        self._doing = ''
        self._compiled = 0.0
        self._compiling_since: float | None = None
        self.findings: Findings | None = None
        self.error = ''
        request = json.dumps({'bags': [str(bag) for bag in bags], 'cell': cell.document()})
        self._over = threading.Event()
        self._dropped = False
        environment = dict(os.environ) | {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
        try:
            self._popen = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                encoding='utf-8',
                errors='replace',
                env=environment,
                # Ctrl-C in a terminal reaches the node, which ends this.
                start_new_session=True,
            )
        except OSError as error:
            self.error = f'the analysis cannot be started: {error.strerror}'
            self._over.set()
            return
        self._thread = threading.Thread(target=self._follow, args=(request,), daemon=True)
        self._thread.start()

    @property
    def doing(self) -> str:
        """Return what it is doing, in a few words."""
        if self._compiling_since is not None:
            return 'compiling, as once after an installation'
        return self._doing

    @property
    def compiled(self) -> float:
        """Return how much of its time so far went into compiling kernels [s]."""
        since = self._compiling_since
        if since is None:
            return self._compiled
        return self._compiled + min(time.monotonic() - since, LONGEST_COMPILATION)

    @property
    def over(self) -> bool:
        """Whether it has come to its end."""
        return self._over.is_set()

    def drop(self) -> None:
        """End it, whatever it is doing."""
        self._dropped = True
        if not self.over:
            self._popen.kill()
            self._thread.join(1.0)

    def _follow(self, request: str) -> None:
        """Pass the request on, and take what the process says until it ends."""
        popen = self._popen
        assert popen.stdin is not None
        assert popen.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            popen.stdin.write(request + '\n')
            popen.stdin.flush()
        with popen.stdout as said:
            for line in said:
                self._take(line.rstrip('\n'))
        code = popen.wait()
        with contextlib.suppress(BrokenPipeError):
            popen.stdin.close()
        if self.findings is None and not self.error:
            how = f'by signal {-code}' if code < 0 else f'with exit code {code}'
            self.error = f'the process that analyses the bags ended {how} and gave no answer'
        if self._dropped:
            self.findings, self.error = None, 'the analysis was dropped'
        self._over.set()

    def _take(self, line: str) -> None:
        kind, _, rest = line.partition(' ')
        match kind:
            case 'doing':
                self._doing = rest
            case 'compiling':
                self._compiling_since = time.monotonic()
            case 'compiled':
                self._compiled, self._compiling_since = self.compiled, None
            case 'error':
                self.error = rest
            case 'found':
                try:
                    self.findings = Findings.from_document(json.loads(rest))
                except (ValueError, KeyError, TypeError, AttributeError):
                    self.error = 'the analysis gave an answer that cannot be read'


def _say(kind: str, text: str = '') -> None:
    print(kind, text.replace('\n', ' '), flush=True)


def _tell_compilations() -> None:
    """Tell of the kernels that are compiled; those that others need are compiled within them."""
    # The node does without numba.
    from numba.core import event

    class Compilations(event.Listener):
        """Counts how deep they are."""

        def __init__(self) -> None:
            self._depth = 0

        def on_start(self, event: object) -> None:
            if self._depth == 0:
                _say('compiling')
            self._depth += 1

        def on_end(self, event: object) -> None:
            self._depth -= 1
            if self._depth == 0:
                _say('compiled')

    event.register('numba:compile', Compilations())  # type: ignore[no-untyped-call]


def _end_with_input() -> None:
    """Wait for the end of the input, which is that of the node."""
    sys.stdin.read()
    os._exit(1)


def main() -> int:
    """Analyse the bags of the request on standard input, and return the exit code."""
    request = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_input, daemon=True).start()
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    from hapticvision_ros.bag.reader import read_trial

    _tell_compilations()
    try:
        _say('doing', 'reading the bags')
        trials, places, left_out = [], [], []
        for place, bag in enumerate(request['bags']):
            try:
                trials.append(read_trial(Path(bag)))
                places.append(place)
            except HapticVisionError as error:
                left_out.append(f'{Path(bag).name} is left out: {str(error).rstrip(".")}')
        if not trials:
            raise InputError('; '.join(left_out))
        found = look(
            trials,
            Cell.from_document(request['cell']),
            progress=lambda what: _say('doing', what),
        ).among(places, left_out)
        _say('found', json.dumps(found.document(), allow_nan=False))
    except HapticVisionError as error:
        _say('error', str(error).rstrip('.'))
        return UsageError.exit_code
    return 0


if __name__ == '__main__':
    sys.exit(main())

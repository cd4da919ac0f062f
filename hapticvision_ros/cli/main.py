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
``hapticvision``: where the command starts.

Nothing else is imported here before `main` is ready for Ctrl-C.
"""

from contextlib import suppress
import os
import signal
import sys

INTERRUPTED = 130
"""Exit code after Ctrl-C, as of a shell: 128 + SIGINT."""
TERMINATED = 143
"""Exit code after SIGTERM: 128 + SIGTERM."""


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line and return its exit code.

    Parameters
    ----------
    argv : list of str or None
        The arguments; None for those of the process.

    Returns
    -------
    int
        0: done. 2: bad input or usage, told in one sentence on standard error. 130: interrupted.
        143: ended by SIGTERM.

    """
    for name in ('stdout', 'stderr'):
        # A caller may have closed them: what is found is written to its files all the same.
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), 'w'))
    former = None
    try:
        # Another thread, as of a program that calls this, may set none.
        with suppress(ValueError):
            former = signal.signal(signal.SIGTERM, terminated)
        from hapticvision_ros.threads import one_thread

        one_thread()
        from hapticvision_ros.cli.command import run

        return run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        print('hapticvision: interrupted.', file=sys.stderr)
        return INTERRUPTED
    except SystemExit as ended:
        if ended.code != TERMINATED:
            raise
        print('hapticvision: ended by SIGTERM.', file=sys.stderr)
        return TERMINATED
    finally:
        if former is not None:
            signal.signal(signal.SIGTERM, former)


def terminated(signum: int, frame: object) -> None:
    """Unwind what runs, as Ctrl-C does."""
    sys.exit(TERMINATED)

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
Processes that live and end together; one that dies may be started again.

Each process is a session of its own, so that Ctrl-C reaches only the supervisor, which then stops
them in order; and each asks the kernel for SIGTERM at the supervisor's death, so that none is
left over whatever ends it.
"""

from collections.abc import Callable, Mapping, Sequence
import contextlib
import ctypes
from dataclasses import dataclass, field
import os
from pathlib import Path
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from types import TracebackType
from typing import Final, Self

from hapticvision_ros.cli.main import terminated
from hapticvision_ros.core.errors import HapticVisionError
from hapticvision_ros.share import share_folder

STEADY: Final = 4.0
"""A process that has never run for so long is not started again: its start is what fails [s]."""
DEAF: Final = re.compile(r'Failed init_port fastrtps_port(7[4-9]\d\d|[89]\d{3}|\d{5})\b')
"""
What Fast DDS says when a process cannot listen to its own port in shared memory.

It happens when another looks, at the same moment, whether the one who had the port before is dead,
as after a kill. The process then goes on and is heard by nobody: it has to be started again. Of
the ports below 7400 it simply takes the next one.
"""
SHARED_MEMORY: Final = Path('/dev/shm')
HALF_MADE: Final = 2.0
"""A port in shared memory that is empty for longer was being made by a process that died [s]."""
STOP_GRACE: Final = 6.0
"""How long a process may take to end after SIGTERM, before SIGKILL [s]."""
_PR_SET_PDEATHSIG: Final = 1


class ProcessError(HapticVisionError):
    """A process that others need has ended, or did not come up."""

    exit_code = 1


@dataclass(slots=True)
class _Child:
    """One supervised process and what it has said."""

    name: str
    popen: subprocess.Popen[str]
    prefix: str
    grace: float
    command: list[str]
    restarts: int
    started: float
    proven: bool = False
    lines: 'queue.Queue[str]' = field(default_factory=queue.Queue)


def program(module: str, *arguments: str) -> list[str]:
    """
    Return the command that runs the `main` of a module with the present interpreter.

    The program gets SIGTERM when the present process dies.
    """
    # Until a program has its own handlers, Ctrl-C ends it without a word.
    code = (
        'import signal\n'
        'signal.signal(signal.SIGINT, signal.SIG_DFL)\n'
        'import sys\n'
        f'from {__name__} import end_with\n'
        f'end_with({os.getpid()})\n'
        f'from {module} import main\n'
        'sys.exit(main())'
    )
    return [sys.executable, '-c', code, *arguments]


def node(name: str, *arguments: str) -> list[str]:
    """Return the command that runs a node of this package."""
    return program(f'hapticvision_ros.nodes.{name}', *arguments)


def end_with(parent: int) -> None:
    """Let the present process be told to end when the process `parent`, its parent, dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        # It died before the kernel was asked.
        sys.exit(128 + signal.SIGTERM)


def ros_environment(domain: int | None = None) -> dict[str, str]:
    """
    Return the environment of the nodes: discovery on this machine only, and the DDS profile.

    What the user has set stands.

    Parameters
    ----------
    domain : int, optional
        ROS domain; that of the present environment if not given.

    Returns
    -------
    dict of str to str
        A whole environment.

    """
    environment = dict(os.environ)
    environment.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    profile = share_folder() / 'config' / 'fastdds_profile.xml'
    if 'FASTDDS_DEFAULT_PROFILES_FILE' not in environment:
        environment.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
    environment['PYTHONUNBUFFERED'] = '1'
    if domain is not None:
        environment['ROS_DOMAIN_ID'] = str(domain)
    return environment


def remove_half_made_ports(folder: Path = SHARED_MEMORY) -> None:
    """
    Remove the ports of Fast DDS in shared memory that were never finished.

    A process that is killed while it makes one leaves an empty file, and every process that needs
    a port waits for its end from then on, on the whole machine.
    """
    for port in folder.glob('fastrtps_port*'):
        with contextlib.suppress(OSError):
            state = port.stat()
            made = not port.name.endswith('_el') and not port.name.endswith('_sl')
            if made and state.st_size == 0 and time.time() - state.st_mtime > HALF_MADE:
                port.unlink()
                (folder / f'sem.{port.name}_mutex').unlink(missing_ok=True)


class Supervisor:
    """
    Starts processes, passes on what they say, and stops all of them at its end.

    A context manager, to be used in the main thread: SIGTERM unwinds it like Ctrl-C, with exit
    code 143.

    Parameters
    ----------
    environment : mapping of str to str
        Environment of the processes.
    show : callable, optional
        Takes each line of output; prints it if not given.

    """

    def __init__(
        self, environment: Mapping[str, str], show: Callable[[str], None] | None = None
    ) -> None:
        self._environment = dict(environment)
        self._show = show or (lambda line: print(line, flush=True))
        self._stages: list[list[_Child]] = []
        self._exits: queue.Queue[str] = queue.Queue()
        self._print_lock = threading.Lock()
        self._broken: BrokenPipeError | None = None
        self._readers: list[threading.Thread] = []

    def __enter__(self) -> Self:
        self._former = signal.signal(signal.SIGTERM, terminated)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.stop()
        finally:
            signal.signal(signal.SIGTERM, self._former)

    def start(
        self,
        commands: Mapping[str, Sequence[str]],
        *,
        labelled: bool = True,
        grace: float = STOP_GRACE,
        restarts: int = 0,
    ) -> None:
        """
        Start processes that belong together; they are stopped before those started earlier.

        Parameters
        ----------
        commands : mapping of str to sequence of str
            Name to command.
        labelled : bool
            Whether each line of output is shown with the process's name before it.
        grace : float
            How long they may take to end after SIGTERM [s].
        restarts : int
            How often each may end by itself and be started again, by `wait`.

        Raises
        ------
        ProcessError
            If a command cannot be run.

        """
        remove_half_made_ports()
        stage: list[_Child] = []
        self._stages.append(stage)
        for name, command in commands.items():
            prefix = f'[{name}] ' if labelled else ''
            popen = self._open(name, command)
            now = time.monotonic()
            child = _Child(name, popen, prefix, grace, list(command), restarts, now)
            stage.append(child)
            self._listen(child)

    def _open(self, name: str, command: Sequence[str]) -> subprocess.Popen[str]:
        try:
            return subprocess.Popen(
                list(command),
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                encoding='utf-8',
                errors='replace',
                start_new_session=True,
            )
        except OSError as error:
            raise ProcessError(f'cannot start {name}: {error.strerror}.') from error

    def _listen(self, child: _Child) -> None:
        reader = threading.Thread(target=self._read, args=(child,), daemon=True)
        self._readers.append(reader)
        reader.start()

    def _start_again(self, child: _Child) -> bool:
        """Return whether a process that has ended has been started again."""
        killed = child.popen.wait() < 0
        child.proven |= killed or time.monotonic() - child.started >= STEADY
        if not (child.restarts and child.proven):
            return False
        child.restarts -= 1
        with self._print_lock:
            self._pass_on(f'{child.prefix}ended with {_how(child.popen)}; it is started again.')
        child.popen = self._open(child.name, child.command)
        child.started = time.monotonic()
        self._listen(child)
        return True

    def wait_for_line(self, name: str, start: str, timeout: float) -> str:
        """
        Return the first line of a process that begins with `start`.

        Raises
        ------
        ProcessError
            If the process ends before, or does not say it in `timeout` [s].

        """
        child = self._child(name)
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0.0:
            # An ended process says nothing more: look at it between short waits.
            with contextlib.suppress(queue.Empty):
                line = child.lines.get(timeout=min(left, 0.1))
                if line.startswith(start):
                    return line
                continue
            if child.popen.poll() is not None and child.lines.empty():
                raise ProcessError(f'{name} ended with {_how(child.popen)} before it was ready.')
        raise ProcessError(f'{name} was not ready in {timeout:g} s: see its output above.')

    def wait(self, client: str | None = None) -> int:
        """
        Wait until `client` ends, and return its exit code; forever if there is none.

        Raises
        ------
        ProcessError
            If another process ends that is not to be started again.

        """
        while True:
            if self._broken is not None:
                raise self._broken
            try:
                name = self._exits.get(timeout=0.5)
            except queue.Empty:
                remove_half_made_ports()
                continue
            child = self._child(name)
            popen = child.popen
            if name == client:
                return popen.returncode if popen.returncode >= 0 else 128 - popen.returncode
            if self._start_again(child):
                continue
            raise ProcessError(f'{name} ended with {_how(popen)}; all others are being stopped.')

    def pid(self, name: str) -> int:
        """Return the number of a process."""
        return self._child(name).popen.pid

    def stop(self) -> None:
        """Stop all processes, the last started first; safe to call again."""
        former = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            while self._stages:
                _stop_all(self._stages.pop())
            for reader in self._readers:
                reader.join(1.0)
        finally:
            signal.signal(signal.SIGINT, former)

    def _child(self, name: str) -> _Child:
        return next(child for stage in self._stages for child in stage if child.name == name)

    def _pass_on(self, line: str) -> None:
        try:
            self._show(line)
        except BrokenPipeError as error:
            # Whoever reads our output has left: `wait` tells the main thread.
            self._broken = error

    def _read(self, child: _Child) -> None:
        """Pass on what a process says, until it ends."""
        popen = child.popen
        assert popen.stdout is not None
        with popen.stdout as stream:
            for line in stream:
                text = line.rstrip('\n')
                child.lines.put(text)
                with self._print_lock:
                    self._pass_on(child.prefix + text)
                if child.restarts and DEAF.search(text):
                    # Not by SIGKILL, which may leave a port half made.
                    child.proven = True
                    popen.terminate()
        popen.wait()
        self._exits.put(child.name)


def _how(popen: subprocess.Popen[str]) -> str:
    """Return how a process ended, in words."""
    code = popen.wait()
    return f'signal {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'


def _signal_group(child: _Child, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.popen.pid, number)


def _stop_all(stage: list[_Child]) -> None:
    """
    Ask processes to end, and end those that do not.

    By SIGTERM, which ends an interpreter that has just started without a word.
    """
    for child in stage:
        if child.popen.poll() is None:
            _signal_group(child, signal.SIGTERM)
    start = time.monotonic()
    for child in stage:
        left = max(0.0, start + child.grace - time.monotonic())
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.popen.wait(left)
        if child.popen.poll() is None:
            _signal_group(child, signal.SIGKILL)
            child.popen.wait()

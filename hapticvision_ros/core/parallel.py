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
Work on several processors.

Threads share one interpreter, which most of a fit waits for: a second one hardly helps. Processes
that are forked see all that there is already, and only what they find is sent back. A process that
has threads is never forked, as any of them may hold a lock: there, threads have to do.

The pools of the standard library are not used for processes: all workers of one send through the
same pipe, and who ends one of them amid a result (as those do who have enough, an interrupt, or a
machine short of memory) may leave the reader waiting for the rest of it for ever. Here each has a
pipe of its own, which ends with it.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
import copyreg
import ctypes
import io
import multiprocessing
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import pickle
import signal
import threading
from types import MappingProxyType
from typing import Any, Final

_TASKS: Final = Path('/proc/self/task')
"""Where Linux lists the threads of this process, those of libraries too."""
_MOST_THREADS: Final = 2
"""More hardly help."""
_crowded: list[OSError] = []
"""Why no process could be started, as where memory is short: each trial leaves files open."""
_ENDING: Final = (signal.SIGINT, signal.SIGTERM)
_END_WITH_PARENT: Final = 1
"""PR_SET_PDEATHSIG of linux/prctl.h."""


def each[T, R](
    function: Callable[[T], R],
    items: Sequence[T],
    workers: int,
    known: Sequence[object] = (),
) -> Iterator[R]:
    """
    Call a function with each of some items, on several processors.

    Parameters
    ----------
    function : callable
        What it changes outside of what it returns is lost. Where it fails in another process, or
        what it returns cannot be pickled, it is called again in this one.
    items : sequence
        Its arguments, one call each.
    workers : int
        Processors.
    known : sequence of object
        What results may refer to, so that it is not sent back with them.

    Yields
    ------
    object
        The results, in the order of the items.

    """
    if workers < 2 or len(items) < 2 or _crowded:
        yield from map(function, items)
    elif _can_fork():
        yield from _forked(function, items, min(workers, len(items)), known)
    else:
        with ThreadPoolExecutor(min(workers, _MOST_THREADS)) as pool:
            yield from pool.map(function, items)


def _can_fork() -> bool:
    """Return whether this process has but one thread, sees others end, and is no worker itself."""
    if multiprocessing.current_process().daemon or threading.active_count() > 1:
        return False
    if signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN:
        return False
    return 'fork' in multiprocessing.get_all_start_methods() and _threads() == 1


def _threads() -> int:
    """Return how many threads this process has; zero where that cannot be seen."""
    try:
        return len(list(_TASKS.iterdir()))
    except OSError:
        return 0


def _forked[T, R](
    function: Callable[[T], R], items: Sequence[T], workers: int, known: Sequence[object]
) -> Iterator[R]:
    """Yield the results of forked processes."""
    team = dict[Connection, BaseProcess]()
    places = iter(range(len(items)))
    at = dict[Connection, int]()
    made = dict[int, bytes]()

    def go_on(link: Connection) -> None:
        place = next(places, None)
        if place is not None:
            # Where it has ended, nobody is at this one.
            with suppress(OSError):
                link.send(place)
                at[link] = place

    try:
        with _undisturbed():
            try:
                for _ in range(workers):
                    _start(team, function, items, known)
            except OSError as error:
                # Those that there are do it, or the caller.
                _crowded.append(error)
        for link in team:
            go_on(link)
        for place, item in enumerate(items):
            while place in at.values():
                ready = wait(list(at))
                for link in [link for link in at if link in ready]:
                    done = at.pop(link)
                    # It may have been ended from outside, as where memory is short.
                    with suppress(EOFError, OSError):
                        made[done] = link.recv_bytes()
                        go_on(link)
            if sent := made.pop(place, b''):
                yield _Reader(io.BytesIO(sent), known).load()
            else:
                # Nobody has done it. An error is the caller's own so.
                yield function(item)
    finally:
        for link, worker in team.items():
            # Where some are at work still, as after an interrupt, nobody waits for that.
            worker.kill()
            link.close()
        for worker in team.values():
            worker.join()


def _start(
    team: dict[Connection, BaseProcess],
    function: Callable[[Any], object],
    items: Sequence[Any],
    known: Sequence[object],
) -> None:
    """Start one worker more."""
    here, there = multiprocessing.Pipe()
    worker = multiprocessing.get_context('fork').Process(
        target=_work,
        args=(there, function, items, known, os.getpid()),
        daemon=True,
    )
    worker.start()
    team[here] = worker
    # What only the worker has ends with it.
    there.close()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let signals wait: of processes that are interrupted as they start, nobody may know."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        # What has come before that is raised here.
        signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _work(
    link: Connection,
    function: Callable[[Any], object],
    items: Sequence[Any],
    known: Sequence[object],
    parent: int,
) -> None:
    """Be a worker, who ends with the process that has started it, and at an interrupt."""
    # In the background of a shell nobody is interrupted.
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        # It has ended before that.
        os._exit(1)
    while True:
        place = link.recv()
        made = io.BytesIO()
        try:
            _Writer(made, known).dump(function(items[place]))
        except Exception:
            # Who has asked for it does it again, and sees why it fails.
            made = io.BytesIO()
        link.send_bytes(made.getbuffer())


def _mapping(of: MappingProxyType[Any, Any]) -> tuple[Any, ...]:
    """Return how a mapping that does not change is made anew: its type has no name to be sent."""
    return _unchanging, (dict(of),)


def _unchanging(of: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return a mapping that does not change."""
    return MappingProxyType(of)


class _Writer(pickle.Pickler):
    """Writes results, but not what both processes have."""

    dispatch_table = copyreg.dispatch_table | {MappingProxyType: _mapping}

    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._place = {id(one): place for place, one in enumerate(known)}

    def persistent_id(self, obj: object) -> int | None:
        """Return the place of what both have."""
        return self._place.get(id(obj))


class _Reader(pickle.Unpickler):
    """Reads them."""

    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, pid: int) -> object:
        """Return what both have."""
        return self._known[pid]

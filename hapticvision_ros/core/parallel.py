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
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import copyreg
import ctypes
from dataclasses import dataclass
import io
import multiprocessing
import os
from pathlib import Path
import pickle
import signal
import threading
import time
from types import MappingProxyType
from typing import Any, Final

_TASKS: Final = Path('/proc/self/task')
"""Where Linux lists the threads of this process, those of libraries too."""
_MOST_THREADS: Final = 2
"""More hardly help."""
_JOINED: Final = 0.5
_LOOK: Final = 1e-4
"""Longest time for which a thread that has ended is seen, and how often to look [s]."""
_staying: dict[int, int] = {}
"""How many threads a process was seen not to lose in this time."""
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
        What it changes outside of what it returns is lost.
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
    if workers < 2 or len(items) < 2:
        yield from map(function, items)
    elif _can_fork():
        yield from _forked(function, items, min(workers, len(items)), known)
    else:
        with ThreadPoolExecutor(min(workers, _MOST_THREADS)) as pool:
            yield from pool.map(function, items)


def _can_fork() -> bool:
    """Return whether this process has but one thread, and is no worker itself."""
    worker = bool(_given) or multiprocessing.current_process().daemon
    if worker or threading.active_count() > 1:
        return False
    if 'fork' not in multiprocessing.get_all_start_methods():
        return False
    # A thread that has been joined is seen for a moment still; those of a library stay.
    deadline = time.monotonic() + _JOINED
    while (threads := _threads()) > 1:
        if threads == _staying.get(os.getpid()):
            return False
        if time.monotonic() > deadline:
            _staying[os.getpid()] = threads
            return False
        time.sleep(_LOOK)
    return threads == 1


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
    context = multiprocessing.get_context('fork')
    others = multiprocessing.active_children()
    done = 0
    with ProcessPoolExecutor(
        workers, context, _take, (function, items, known, os.getpid())
    ) as pool:
        try:
            with _undisturbed():
                results = pool.map(_one, range(len(items)))
            for made in results:
                yield _Reader(io.BytesIO(made), known).load()
                done += 1
        except BrokenProcessPool:
            # A worker was ended from outside, as where memory is short.
            pass
        finally:
            if done < len(items):
                # Nobody waits for what they are at, as after an interrupt.
                for child in multiprocessing.active_children():
                    if child not in others:
                        child.terminate()
    yield from map(function, items[done:])


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let signals wait: a pool that is interrupted as it starts its processes never ends."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


@dataclass(slots=True)
class _Work:
    """What a forked process has to do."""

    function: Callable[[Any], object]
    items: Sequence[Any]
    known: Sequence[object]


_given: list[_Work] = []
"""The work of this process, if it is a worker."""


def _take(
    function: Callable[[Any], object],
    items: Sequence[Any],
    known: Sequence[object],
    parent: int,
) -> None:
    """Begin as a worker, who ends with the process that has started it, and at an interrupt."""
    # In the background of a shell nobody is interrupted.
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        # It has ended before that.
        os._exit(1)
    _given.append(_Work(function, items, known))


def _one(index: int) -> bytes:
    """Return the result for one item as it is sent."""
    work = _given[-1]
    made = io.BytesIO()
    _Writer(made, work.known).dump(work.function(work.items[index]))
    return made.getvalue()


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

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
Kernels: functions compiled once for a machine, that let other threads run.

numba keeps what it has compiled beside the source, or in the user's cache where that folder cannot
be written to. Where neither can, as in a container without a home, it refuses the function; here
it is then compiled anew by each process, which is slow to start but works. Of several processes
that need the same kernel one compiles it, and the others wait for that.
"""

from collections.abc import Callable
import contextlib
import fcntl
from importlib import import_module
import os
from pathlib import Path
import sys
import time
from types import ModuleType
from typing import Any, Final

from numba import njit
from numba.core import environment, event
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

_LONGEST_WAIT: Final = 600.0
"""Who takes longer to compile a kernel than this hangs [s]."""
_LOOK_AGAIN: Final = 0.05
"""Period at which it is looked whether another process has compiled a kernel [s]."""


def _environment(module: str, constants: Any, name: str) -> Any:
    """
    Return what numba keeps of a function within a kernel, without loading the module it is from.

    Machine code looks up constants there; names of the module only by the interpreter, which runs
    no kernel. Each kernel with a `numpy.zeros` in it would load numba's arrays and strings.
    """
    known = environment.lookup_environment(name)  # type: ignore[no-untyped-call]
    if known is not None:
        return known
    if module.startswith('numba.') and module not in sys.modules:
        names: dict[str, Any] = {'__name__': module}
    else:
        names = import_module(module).__dict__
    made = environment.Environment(names)
    made.consts[:] = constants
    made.env_name = name
    environment.Environment._memo[name] = made
    return made


# Under numba's own name: what other packages keep meanwhile does not ask for this one.
_environment.__module__ = environment.__name__
_environment.__name__ = _environment.__qualname__ = '_rebuild_env'
environment._rebuild_env = _environment


class _Cache(FunctionCache):
    """
    What numba keeps of a kernel, read without all that numba needs to compile one.

    numba loads its whole library first, 0.3 s and more of each process, of which machine code that
    is there already needs only the memory management. What is not there is compiled as ever, and
    the compiler loads the library itself; meanwhile a lock holds up other processes that need it.
    """

    _lock: int | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel for some types; None where it is to be compiled."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            found = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                return found
            self._take_lock()
            try:
                # Another process may have kept it since.
                found = self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            except BaseException:
                self.give_lock_back()
                raise
            if found is not None:
                self.give_lock_back()
            return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, for the processes that wait for it as well."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        finally:
            self.give_lock_back()

    def _take_lock(self) -> None:
        """Wait until no other process compiles the kernel; go on where no lock can be had."""
        path = Path(self.cache_path) / f'{self._impl.filename_base}.lock'
        with contextlib.suppress(OSError):
            self._impl.locator.ensure_cache_path()
            lock = self._lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            # Those who count the time of compilations count this as well.
            with event.trigger_event('numba:compile'):
                deadline = time.monotonic() + _LONGEST_WAIT
                while time.monotonic() < deadline:
                    time.sleep(_LOOK_AGAIN)
                    with contextlib.suppress(BlockingIOError):
                        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                        return

    def give_lock_back(self) -> None:
        """Let other processes compile the kernel."""
        if self._lock is not None:
            # A process that was forked meanwhile has the same lock.
            with contextlib.suppress(OSError):
                fcntl.flock(self._lock, fcntl.LOCK_UN)
            os.close(self._lock)
            self._lock = None


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """
    Return a decorator that compiles a function.

    Parameters
    ----------
    **options
        Those of ``numba.njit``, such as ``error_model`` and ``inline``.

    Returns
    -------
    callable
        The decorator.

    """

    def compile_(function: Callable[..., Any]) -> Any:
        compiled = njit(nogil=True, **options)(function)
        with contextlib.suppress(RuntimeError):
            cache = compiled._cache = _Cache(function)  # type: ignore[no-untyped-call]
            compile_types = compiled._compiler.compile

            def guarded(*types: Any) -> Any:
                try:
                    return compile_types(*types)
                except BaseException:
                    cache.give_lock_back()
                    raise

            compiled._compiler.compile = guarded
        return compiled

    return compile_


def kept(module: ModuleType) -> bool:
    """
    Return whether kernels of a module were compiled since its last change.

    Parameters
    ----------
    module : ModuleType
        One that has kernels of its own.

    Returns
    -------
    bool
        Whether any of them is kept, or none of them can be.

    """
    caches = [getattr(member, '_cache', None) for member in vars(module).values()]
    # Without a place to keep them in there are none, nor where they are not compiled at all.
    own = [
        cache
        for cache in caches
        if isinstance(cache, _Cache) and cache._py_func.__module__ == module.__name__
    ]
    return not own or any(
        cache._cache_file._load_index()  # type: ignore[no-untyped-call]
        for cache in own
    )

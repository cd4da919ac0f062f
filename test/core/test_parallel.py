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


"""Work on several processors."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from hapticvision_ros.core import parallel
import pytest

# A process of its own has one thread; what pytest loads may have started more.
ALONE = """
import os, signal, sys, time
from hapticvision_ros.core.parallel import each

own = os.getpid()
"""


def alone(what: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run some lines in a process of its own."""
    return subprocess.run(
        [sys.executable, '-W', 'error', '-c', ALONE + what],
        capture_output=True,
        text=True,
        timeout=180.0,
        check=False,
        **options,
    )


@pytest.mark.parametrize('workers', [1, 2, 8])
def test_results_come_in_the_order_of_the_items(workers: int) -> None:
    assert list(parallel.each(lambda x: 2 * x, range(7), workers)) == list(range(0, 14, 2))


def test_other_processes_do_the_work() -> None:
    """Each of two items waits for the other: they are done at once, and by two processes."""
    ran = alone(
        """
reading, writing = os.pipe()
def one(index):
    # Each waits for the other.
    if index:
        os.write(writing, b'.')
    else:
        os.read(reading, 1)
    return os.getpid()
print(len({own, *each(one, range(2), 2)}))
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == '3\n'


def test_the_work_before_does_not_keep_others_from_it() -> None:
    ran = alone(
        """
print(all(own not in each(lambda _: os.getpid(), range(2), 2) for _ in range(50)))
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == 'True\n'


def test_a_worker_starts_no_workers() -> None:
    ran = alone(
        """
def inner(_):
    return os.getpid()
def outer(_):
    return os.getpid(), set(each(inner, range(4), 2))
print(all(pids == {pid} for pid, pids in each(outer, range(2), 2)))
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == 'True\n'


def test_what_both_have_is_not_sent_back() -> None:
    ran = alone(
        """
class Big:
    def __reduce__(self):
        raise RuntimeError('it was sent')
big = Big()
found = list(each(lambda k: (k, [big]), range(3), 2, [big]))
print(all(one[1][0] is big for one in found), [one[0] for one in found])
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == 'True [0, 1, 2]\n'


def test_mappings_that_do_not_change_are_sent_back() -> None:
    ran = alone(
        """
from types import MappingProxyType
print(list(each(lambda k: MappingProxyType({'k': k}), range(2), 2)))
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == "[mappingproxy({'k': 0}), mappingproxy({'k': 1})]\n"


def test_a_worker_that_is_ended_is_done_without() -> None:
    ran = alone(
        """
def one(index):
    if os.getpid() != own and index == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return index
print(list(each(one, range(4), 2)))
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == '[0, 1, 2, 3]\n'


def test_workers_that_end_at_once_are_done_without() -> None:
    ran = alone(
        """
from multiprocessing.context import ForkProcess

start = ForkProcess.start

def ended(process):
    start(process)
    process.kill()
    process.join()

ForkProcess.start = ended
print(list(each(abs, range(4), 2)))
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == '[0, 1, 2, 3]\n'


@pytest.mark.parametrize('room', [0, 1])
def test_where_there_is_no_room_for_workers_others_do_it(room: int) -> None:
    ran = alone(
        f"""
forks = []
fork = os.fork

def fails():
    if len(forks) == {room}:
        raise BlockingIOError('no more processes')
    forks.append(True)
    return fork()

os.fork = fails
first = list(each(abs, range(4), 3))
files = len(os.listdir('/proc/self/fd'))
print(first, *(list(each(abs, range(4), 3)) == first for _ in range(9)))
print(len(os.listdir('/proc/self/fd')) - files)
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == '[0, 1, 2, 3]' + 9 * ' True' + '\n0\n'


def test_where_nobody_is_told_of_ended_processes_none_are_started() -> None:
    """Some shells hand that on: a process that has ended would be taken for one that works."""
    ran = alone(
        """
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
print(set(each(lambda _: os.getpid(), range(4), 2)) == {own})
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == 'True\n'


def test_who_is_ended_amid_a_result_is_done_without() -> None:
    """A pipe that others write to as well has no end then, and is waited at for ever."""
    ran = alone(
        """
import multiprocessing

reading, writing = os.pipe()
def one(index):
    if os.getpid() != own:
        if index == 1:
            # Nobody reads the result once another has begun with the third.
            os.read(reading, 1)
            signal.setitimer(signal.ITIMER_REAL, 1.0)
            return bytes(10_000_000)
        if index == 2:
            os.write(writing, b'.')
            signal.pause()
    return index

results = each(one, range(4), 2)
found = [next(results)]
# One waits for a reader until its time is over, and the other for ever.
while len(left := multiprocessing.active_children()) > 1:
    time.sleep(0.01)
left[0].kill()
print([*found, *results])
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == '[0, 1, 2, 3]\n'


def test_an_error_is_the_callers() -> None:
    ran = alone(
        """
def one(index):
    if index == 2:
        raise ValueError('the third')
    return index
try:
    list(each(one, range(4), 2))
except ValueError as error:
    print(error)
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == 'the third\n'


def test_who_has_enough_does_not_wait_for_what_is_being_sent() -> None:
    ran = alone(
        """
for _ in range(20):
    for _ in each(lambda index: bytes(3_000_000 * index), range(6), 2):
        break
print('done')
"""
    )
    assert ran.stderr == ''
    assert ran.stdout == 'done\n'


def test_who_has_enough_does_not_wait_for_the_rest() -> None:
    begin = time.monotonic()
    ran = alone(
        """
def one(index):
    if index:
        time.sleep(50.0)
    return index
print(next(each(one, range(4), 2)))
"""
    )
    assert ran.stdout == '0\n'
    assert time.monotonic() - begin < 30.0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_the_process_that_has_started_them(number: int, tmp_path: Path) -> None:
    ran = subprocess.Popen(
        [
            sys.executable,
            '-c',
            ALONE
            + f"""
signal.signal(signal.SIGINT, signal.default_int_handler)
from pathlib import Path
def one(index):
    made = Path({str(tmp_path)!r}) / 'part'
    made = made.with_suffix(f'.{{os.getpid()}}')
    made.write_text('')
    made.rename(made.with_suffix(made.suffix + '.worker'))
    time.sleep(50.0)
list(each(one, range(2), 2))
""",
        ],
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 30.0
        while len(workers := list(tmp_path.glob('*.worker'))) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        ran.send_signal(number)
        ran.wait(20.0)
        pids = [int(each.name.split('.')[1]) for each in workers]
        while any(_runs(pid) for pid in pids):
            assert time.monotonic() < deadline + 20.0
            time.sleep(0.01)
    finally:
        ran.kill()
        ran.wait()


def _runs(pid: int) -> bool:
    """Return whether a process is there and not only waits to be buried."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False


def test_a_process_with_threads_is_not_forked() -> None:
    with ThreadPoolExecutor(1) as pool:
        pool.submit(int).result()
        assert set(parallel.each(lambda _: os.getpid(), range(4), 2)) == {os.getpid()}


def test_a_thread_of_a_library_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of these Python knows nothing."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(int).result()
        monkeypatch.setattr(parallel.threading, 'active_count', lambda: 1)
        assert set(parallel.each(lambda _: os.getpid(), range(4), 2)) == {os.getpid()}


def test_processes_find_what_one_process_finds() -> None:
    """Problems, searches and refits are sent between processes, and refer to the same trials."""
    ran = alone(
        """
from hapticvision_ros.core import parallel
from hapticvision_ros.core.pipeline import analyse, analyse_campaign
from hapticvision_ros.core.diagnosis.refit import Workbench
from hapticvision_ros.core.diagnosis.selection import try_all
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, Sensors, run
from hapticvision_ros.sim.specimen import Body, Undeclared

pushes = tuple(Push(v, d, 6.0, 4.0) for v, d in ((0.002, 0.004), (0.008, 0.006), (0.008, 0.003)))
sensors = Sensors(ForceNoise(0.05), 3e-5, force_rate=100.0, tool_rate=100.0)
campaign = Campaign(Body(1000.0, 900.0, 1600.0), pushes, sensors)
trials = [analyse(t) for t in run(campaign, [Undeclared('yield_force', (0.5,))], seed=2).trials]
forked = []
plainly = parallel._forked
def counted(function, items, workers, known):
    forked.append(len(items))
    return plainly(function, items, workers, known)
parallel._forked = counted
one, two = (analyse_campaign(trials, workers=workers) for workers in (1, 2))
assert forked, 'nothing was forked'
assert one.diagnosis.effects == two.diagnosis.effects == ('yield_force',)
assert one.diagnosis.ranking == two.diagnosis.ranking
assert one.change == two.change
fit = one.diagnosis.before
bench = Workbench(fit.problem.trials, None, fit.noise.memory)
tried = try_all(bench, bench.base(fit), ['yield_force', 'springpot', 'shear_thinning'], workers=2)
assert all(a is b for e in tried if e.refit for a, b in zip(e.refit.problem.trials, bench.trials))
print('as one')
""",
        env=dict(os.environ, OMP_NUM_THREADS='1', OPENBLAS_NUM_THREADS='1'),
    )
    assert ran.stderr == ''
    assert ran.stdout == 'as one\n'


def test_an_interrupt_waits_until_the_processes_are_there() -> None:
    """Of one that is interrupted as it starts, nobody knows."""
    done = alone("""
import multiprocessing
from multiprocessing.context import ForkProcess

# In the background of a shell it is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
start = ForkProcess.start

def interrupted(process):
    start(process)
    signal.raise_signal(signal.SIGINT)

ForkProcess.start = interrupted
try:
    print(list(each(abs, [1, 2, 3, 4], 2)))
except KeyboardInterrupt:
    print('interrupted', multiprocessing.active_children())
""")
    assert done.stdout == 'interrupted []\n', done.stderr

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
Run the table of faults on a cell that stands: one trial for each, in which one thing goes wrong.

A process of its own beside the nodes, which it kills, stops and misleads; whoever has started the
nodes starts the dead ones again. What happened to the tool and the object is asked of the
simulated world, what was kept is read from the bags.
"""

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
import json
from operator import sub
import os
from pathlib import Path
import resource
import signal
import sys
import time
from types import FrameType
from typing import Any, Final

from action_msgs.srv import CancelGoal
from hapticvision_ros.bag.contract import (
    CANCEL_EXPERIMENT,
    EMERGENCY_STOP,
    ENABLE,
    ENABLE_EXPERIMENT,
    EXPERIMENT_RESULT,
    PHASE,
    PUSH_REPORT,
    Service,
    START_EXPERIMENT,
    STOP,
    WRENCH,
)
from hapticvision_ros.bag.mcap_scan import McapScanner
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.errors import HapticVisionError
from hapticvision_ros.core.experiment import RUNNING
from hapticvision_ros.core.faults import (
    ARM,
    CLOCK_STEPS,
    Fault,
    LOAD_CELL,
    markdown,
    Measured,
    NEAR,
    ORCHESTRATOR,
    RANGE,
    row,
    table,
    verdict,
)
from hapticvision_ros.nodes.conversions import NS_PER_S, values_from_status
from hapticvision_ros.nodes.qos import (
    create_client,
    create_publisher,
    create_subscription,
)
from hapticvision_ros.sim.faults import FaultLink
from hapticvision_ros.sim.settable_clock import can_be_set, set_clock
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

NAME: Final = 'fault_campaign'
PATIENCE: Final = 3.0
"""Time after which a request is sent again: its server may have been killed meanwhile [s]."""
ANSWER_DEADLINE: Final = 40.0
DEAF_AFTER: Final = 15.0
"""An orchestrator that has not answered for so long is started again [s]."""
PHASE_DEADLINE: Final = 40.0
END_DEADLINE: Final = 50.0
"""How long an experiment may take to end after the fault [s]."""
REST_DEADLINE: Final = 20.0
"""How long the tool may take to come up again [s]."""
ATTEMPTS: Final = 3
"""How often a trial is made that ends before the fault is due."""
NEVER: Final = 'never came to'
DURATION: Final = 1.5
"""How long a device goes wrong or a process hangs [s]."""
AT_REST: Final = 0.2
"""A tool that has not gone down for so long stands still [s]."""
AT_LIMIT: Final = 0.97
"""Share of the force limit from which on a push that takes too much has come to it."""
DUE: Final = 0.9
"""Share of the force limit at which something goes wrong near it."""
STRIDE_NS: Final = 10**9
"""A longer step from one message to the next is one of the clock, which was set [ns]."""
STILL_GOING: Final = 0.02
"""A tool that went down so short a time ago goes down [s]."""
MATERIALS: Final = {NEAR: 'hard_dough'}
USUAL: Final = 'soft_dough'
"""What is pressed, of the simulated world's objects."""
DEPTH: Final = 0.006
"""How deep the pushes go [m]."""
SPEED: Final = 0.003
"""How fast: a push that does not stop goes on for 2 s after the touch [m/s]."""
SPEEDS: Final = {'the object is harder than it may be': 0.01}
"""Speeds that take what is not allowed [m/s]."""
DEPTHS: Final = {
    'deeper than the arm allows': 0.05,
    'the object is harder than it may be': 0.025,
}
"""Depths that take what is not allowed [m]."""
GARBAGE: Final[dict[str, dict[str, Any]]] = {
    # The last one is sound, but comes in a push.
    ARM: {'push_speed': float('nan'), 'max_force': 1e6, 'touch_force': 'much', 'depth': 0.005},
    ORCHESTRATOR: {'repeats': -1, 'speeds': [float('inf')], 'tick_period': 1e9, 'rest_time': 'a'},
    LOAD_CELL: {'rate': 0.0, 'tare_spread': float('nan'), 'largest_gap': 'wide', 'capacity': -1.0},
    RANGE: {'frame_timeout': float('nan'), 'least_share': 'all', 'least_points': 60},
    'contact_point_planner': {
        'tool_axis_x': float('inf'),
        'clouds': 0,
        'several_objects': 'both',
        'seed': 3,
    },
    'phase_segmenter': {'contact_sigmas': float('nan'), 'rest_band': 'wide', 'tick_period': -1.0},
    'rheology_fitter': {'memory': 1, 'displacement_source': 'guess', 'tick_period': float('inf')},
}


class Interrupted(Exception):
    """Ctrl-C."""


class Campaign:
    """
    The faults, one after the other.

    Parameters
    ----------
    port : int
        UDP port of the world with faults.
    out : Path
        Folder for the bags.
    force_limit : float
        What the arm's controller allows [N].

    """

    def __init__(self, port: int, out: Path, force_limit: float) -> None:
        self._node = rclpy.create_node(NAME)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._world = FaultLink(port)
        self._out = out
        self._force_limit = force_limit
        self._phases: list[str] = []
        self._results: list[Any] = []
        self._reports: list[Any] = []
        self._clients: dict[str, Any] = {}
        self._asked = 0
        self.interrupted = False
        self.second_restarts = 0
        self._button = create_publisher(self._node, EMERGENCY_STOP)
        create_subscription(self._node, PHASE, lambda item: self._phases.append(item.data))
        create_subscription(self._node, EXPERIMENT_RESULT, self._results.append)
        create_subscription(self._node, PUSH_REPORT, self._reports.append)

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """End the campaign soon."""
        self.interrupted = True

    def close(self) -> None:
        """Leave the graph."""
        self._world.close()
        self._executor.shutdown()
        self._node.destroy_node()

    def run(self, name: str, fault: Fault) -> Measured:
        """Make one trial with a fault, with its bag in a folder of this name."""
        folder = self._out / 'bags' / name
        if fault.how == 'into a folder that cannot be written':
            folder = Path('/proc/nowhere')
        goal = {
            'output_folder': str(folder),
            'speeds': [SPEEDS.get(fault.how, SPEED)],
            'depths': [DEPTHS.get(fault.how, DEPTH)],
        }
        self._heal()
        self._configure(ORCHESTRATOR, goal)
        self._world.ask('material', name=MATERIALS.get(fault.phase, USUAL))
        self._world.ask('watch')
        self._phases.clear()
        self._results.clear()
        answer = self._started()
        if not answer.success:
            return self._refused(fault)
        if fault.phase != 'start':
            self._until(lambda: self._due(fault) or self._results, PHASE_DEADLINE)
            if not self._due(fault):
                said = self._results[-1].message if self._results else 'nothing'
                self._end()
                return self._measured(fault, folder, 0, f'{NEVER} {fault.phase}: {said}')
        fault_ns = time.time_ns()
        trouble = self._inject(fault)
        ended = self._until(lambda: bool(self._results) or self._gone(fault), END_DEADLINE)
        if not ended:
            trouble = trouble or 'the experiment did not end'
            self._end()
        self._heal()
        self._until(self._safe, REST_DEADLINE)
        if fault.action == 'emergency':
            self._button.publish(Bool(data=False))
        return self._measured(fault, folder, fault_ns, trouble)

    def _end(self) -> None:
        """Let there be no experiment that still runs."""
        if not self._results:
            self._tell('cancel')
            self._until(lambda: bool(self._results), END_DEADLINE)

    def _heal(self) -> None:
        """Let the devices and the clock be right again."""
        self._world.ask('heal')
        if can_be_set():
            set_clock(0.0)

    def _started(self) -> Any:
        """Send a goal that may move the arm, and return the answer, lost ones included."""
        answer = self._start()
        # Asked again, it refuses what it has begun already.
        answer.success |= self._asked > 1 and answer.message.endswith(RUNNING)
        return answer

    def _start(self) -> Any:
        request = SetBool.Request(data=True)
        self._call(self._service(ENABLE_EXPERIMENT), request, ENABLE_EXPERIMENT.name)
        return self._call(
            self._service(START_EXPERIMENT), Trigger.Request(), START_EXPERIMENT.name
        )

    def _due(self, fault: Fault) -> bool:
        """Return whether the push has come to where the fault belongs."""
        if fault.phase != NEAR:
            return fault.phase in self._phases
        force = _real(self._world.ask('report')['peak_force'])
        return force is not None and force >= DUE * self._force_limit

    def _pushes(self) -> bool:
        """Return whether the tool goes down at this moment."""
        resting = _real(self._world.ask('report')['resting'])
        return resting is not None and resting < STILL_GOING

    # -- what goes wrong ------------------------------------------------------------------------

    def _inject(self, fault: Fault) -> str:
        """Let it go wrong, and return what was not as it has to be."""
        if fault.target == 'force limit':
            # A little before: what is read has noise, so that the limit itself may not be reached.
            self._world.ask('mark_at', force=AT_LIMIT * self._force_limit)
            return ''
        self._world.ask('mark')
        if fault.phase == NEAR and not self._pushes():
            return f'{NEVER} {NEAR}: the limit ended the push before'
        match fault.action:
            case 'kill':
                os.kill(process_of(fault.target), signal.SIGKILL)
            case 'hang':
                pid = process_of(fault.target)
                os.kill(pid, signal.SIGSTOP)
                self._spin(DURATION)
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
            case 'distort':
                self._world.ask('distort', stream=fault.target, how=fault.how)
                self._spin(DURATION)
                self._world.ask('heal')
            case 'clock':
                set_clock(CLOCK_STEPS[fault.how])
            case 'disk':
                pid = process_of(ORCHESTRATOR)
                soft, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, hard))
                self._until(lambda: bool(self._results), END_DEADLINE)
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (soft, hard))
            case 'emergency':
                self._button.publish(Bool(data=True))
            case 'call':
                self._tell(fault.target)
            case 'parameters':
                return self._mislead(fault.target)
            case 'again':
                if self._start().success:
                    return 'a second goal was accepted'
        return ''

    def _tell(self, what: str) -> None:
        """Ask for the end of the push in one of the ways that there are."""
        match what:
            case 'stop':
                self._call(self._service(STOP), Trigger.Request(), what)
            case 'disable':
                self._call(self._service(ENABLE), SetBool.Request(data=False), what)
            case 'cancel':
                client = self._service(CANCEL_EXPERIMENT)
                self._call(client, CancelGoal.Request(), what)
            case 'deactivate':
                request = ChangeState.Request()
                request.transition.id = Transition.TRANSITION_DEACTIVATE
                client = self._client(ChangeState, f'{ARM}/change_state')
                self._call(client, request, what)

    def _mislead(self, name: str) -> str:
        """Send parameters that a node must refuse, and return those that it took."""
        taken = []
        for key, value in GARBAGE[name].items():
            if self._configure(name, {key: value}, strict=False):
                taken.append(key)
        return f'{", ".join(taken)} was taken' if taken else ''

    # -- what has come of it --------------------------------------------------------------------

    def _gone(self, fault: Fault) -> bool:
        """Whether there is nobody left to tell the end, and the arm has told its own."""
        if (fault.action, fault.target) != ('kill', ORCHESTRATOR):
            return False
        return bool(self._phases) and self._phases[-1] in ('done', 'aborted')

    def _safe(self) -> bool:
        told = self._world.ask('report')
        resting = told['resting']
        return not told['touching'] and isinstance(resting, float) and resting > AT_REST

    def _refused(self, fault: Fault) -> Measured:
        expected = fault.phase == 'start'
        told = self._world.ask('report')
        return Measured(
            outcome='refused',
            peak_force=_real(told['peak_force']) or 0.0,
            force_limit=self._force_limit,
            stopped=None,
            clear=0.0,
            bag_expected=False,
            readable=False,
            kept=0.0,
            lost=0.0,
            trouble='' if expected else 'the goal was refused',
        )

    def given_up(self, trouble: str) -> Measured:
        """Return what is left to say of a trial that could not be made."""
        told = self._world.ask('report')
        return Measured(
            outcome='given up',
            peak_force=_real(told['peak_force']) or 0.0,
            force_limit=self._force_limit,
            stopped=_real(told['stopped']),
            clear=_real(told['clear']),
            bag_expected=False,
            readable=False,
            kept=0.0,
            lost=0.0,
            trouble=trouble,
        )

    def _measured(self, fault: Fault, folder: Path, fault_ns: int, trouble: str) -> Measured:
        told = self._world.ask('report')
        outcome = 'no word' if not self._results else 'aborted'
        if self._results:
            values = values_from_status(self._results[-1])
            outcome = values.get('outcome 1', values['status']).partition(':')[0].lower()
        expected = fault.phase != 'start'
        kept, lost, readable = _bag(folder, fault_ns) if expected else (0.0, 0.0, False)
        return Measured(
            outcome=outcome,
            peak_force=_real(told['peak_force']) or 0.0,
            force_limit=self._force_limit,
            stopped=_real(told['stopped']),
            clear=_real(told['clear']) if expected else 0.0,
            bag_expected=expected,
            readable=readable,
            kept=kept,
            lost=lost,
            trouble=trouble,
        )

    # -- asking ---------------------------------------------------------------------------------

    def _service(self, service: Service) -> Any:
        """Return the client of a contract service, always the same one."""
        if service.name not in self._clients:
            self._clients[service.name] = create_client(self._node, service)
        return self._clients[service.name]

    def _client(self, kind: Any, name: str) -> Any:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        return self._clients[name]

    def _configure(self, name: str, values: dict[str, Any], *, strict: bool = True) -> bool:
        """Set parameters of a node, and return whether it took them."""
        request = SetParameters.Request(
            parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        )
        client = self._client(SetParameters, f'{name}/set_parameters')
        end = time.monotonic() + REST_DEADLINE
        while True:
            results = self._call(client, request, f'the parameters of {name}').results
            refusals = [item.reason for item in results if not item.successful]
            if not refusals or not strict:
                return not refusals
            if time.monotonic() > end:
                raise HapticVisionError(f'{name} refuses its parameters: {" ".join(refusals)}')
            # A tool that was left low may still be on its way up.
            self._spin(AT_REST)

    def _call(self, client: Any, request: Any, what: str) -> Any:
        end = time.monotonic() + ANSWER_DEADLINE
        again = time.monotonic() + DEAF_AFTER
        self._asked = 0
        while time.monotonic() < end:
            if not self._until(client.service_is_ready, PATIENCE):
                continue
            future = client.call_async(request)
            self._asked += 1
            if self._until(future.done, PATIENCE):
                return future.result()
            client.remove_pending_request(future)
            if what.endswith(ORCHESTRATOR) and time.monotonic() > again:
                # Its middleware may have found the remains of the one before it.
                again = end
                self.second_restarts += 1
                os.kill(process_of(ORCHESTRATOR), signal.SIGKILL)
        raise HapticVisionError(f'{what}: no answer within {ANSWER_DEADLINE:g} s.')

    def _spin(self, duration: float) -> None:
        self._until(lambda: False, duration)

    def _until(self, condition: Callable[[], Any], deadline: float) -> bool:
        end = time.monotonic() + deadline
        while not condition():
            if self.interrupted:
                raise Interrupted
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True


def _real(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _bag(folder: Path, fault_ns: int) -> tuple[float, float, bool]:
    """Return how much of a trial is in its bag, how much of it is lost [s], and if it reads."""
    bag = next(iter(sorted(folder.glob('trial_*'))), None)
    if bag is None:
        return 0.0, 0.0, False
    stamps: list[int] = []
    for file in bag.glob('*.mcap'):
        # A recorder that dies at once leaves an empty file.
        with suppress(HapticVisionError):
            for batch in McapScanner(file, [WRENCH.name]).batches():
                stamps += batch.log_ns.tolist()
    if not stamps:
        # The folder was made when the recording began, and its recorder died soon after.
        lost = (fault_ns - bag.stat().st_mtime_ns) / NS_PER_S
        return 0.0, max(0.0, lost), lost < 1.0
    kept = sum(step for step in map(sub, stamps[1:], stamps) if 0 < step < STRIDE_NS) / NS_PER_S
    # A clock that was set ahead stamps what comes after the fault only.
    before = [stamp for stamp in stamps if stamp <= fault_ns] or stamps
    lost = max(0.0, (fault_ns - max(before)) / NS_PER_S)
    try:
        read_trial(bag)
    except HapticVisionError as error:
        print(f'  {bag}: {error}', flush=True)
        return kept, lost, False
    return kept, lost, True


def process_of(name: str) -> int:
    """
    Return the process of a node that was started by the same parent as this one.

    Raises
    ------
    HapticVisionError
        If it does not run.

    """
    wanted = f'hapticvision_ros.nodes.{name} import'.encode()
    for entry in Path('/proc').glob('[0-9]*'):
        with suppress(OSError, IndexError):
            parent = int((entry / 'stat').read_text().rpartition(')')[2].split()[1])
            if parent == os.getppid() and wanted in (entry / 'cmdline').read_bytes():
                return int(entry.name)
    raise HapticVisionError(f'{name} does not run.')


def _write(page: Path, rows: Sequence[Sequence[str]], safe: int, took: float, said: str) -> None:
    text = (
        '# What happens when something goes wrong\n\n'
        f'Written by `hapticvision faults`: {len(rows)} faults, {safe} of them safe, in '
        f'{took:.0f} s. {said}\n\n'
        'Each row is one trial on the simulated cell, all seven nodes running, in which one thing '
        'goes wrong in one\nphase. Forces and times are the truth of the simulation, whatever the '
        'nodes think. Time to safe: from the fault\nuntil the tool last went down, which for a '
        'fault that the push survives is the rest of the push. Clear: until the\ntool last '
        'touched the object, by its own retraction or, where the controller itself was killed, by '
        'that of the\ncontroller that took its place. Kept: what the bag holds of the load cell. '
        'Lost: what it lacks of the time before\nthe fault.\n\n'
    )
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text + markdown(rows), encoding='utf-8')


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=NAME, description='Run the table of faults.')
    parser.add_argument('--port', type=int, required=True)
    parser.add_argument('--out', type=Path, required=True)
    parser.add_argument('--page', type=Path, required=True)
    parser.add_argument('--force-limit', type=float, required=True)
    parser.add_argument('--only', nargs='*', default=[])
    return parser.parse_args(argv)


def chosen(only: Sequence[str]) -> list[tuple[int, Fault]]:
    """Return the faults whose name and phase contain one of the texts, with their numbers."""
    return [
        (number, fault)
        for number, fault in enumerate(table(), start=1)
        if (fault.action != 'clock' or can_be_set())
        and (not only or any(text in fault.line for text in only))
    ]


def main() -> int:
    """Run the campaign and return the process's exit code: 0 if all is safe."""
    args = _arguments(sys.argv[1:])
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    campaign = Campaign(args.port, args.out, args.force_limit)
    for stop in (signal.SIGINT, signal.SIGTERM):
        signal.signal(stop, campaign.interrupt)
    rows, safe, repeated, began = [], 0, 0, time.monotonic()
    faults = chosen(args.only)
    try:
        for number, fault in faults:
            start = time.monotonic()
            for attempt in range(ATTEMPTS):
                try:
                    measured = campaign.run(f'{number:03d}{"abc"[attempt]}', fault)
                except HapticVisionError as error:
                    measured = campaign.given_up(str(error))
                if not measured.trouble.startswith(NEVER):
                    break
                # A machine that is held up aborts a push as well, before anything was done to it.
                repeated += 1
                print(f'{fault.name}: {measured.trouble}', flush=True)
            said = verdict(fault, measured)
            safe += said == 'safe'
            rows.append(row(fault, measured))
            print(f'{number:3d}  {"  ".join(rows[-1])}  ({time.monotonic() - start:.1f} s)')
            sys.stdout.flush()
    except Interrupted:
        return 130
    except HapticVisionError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    finally:
        campaign.close()
        rclpy.try_shutdown()
    took = time.monotonic() - began
    limit = (
        f'The force limit is {args.force_limit:g} N. A restarted orchestrator that could not be '
        f'reached was started once more: {campaign.second_restarts} times. A trial that ended '
        f'before its fault was due, because the machine was held up, was made again: {repeated} '
        'times.'
    )
    if not can_be_set():
        limit += " Faults of the machine's clock are not among them."
    _write(args.page, rows, safe, took, limit)
    (args.out / 'faults.json').write_text(json.dumps(rows, indent=1), encoding='utf-8')
    print(f'{safe} of {len(rows)} faults are safe, in {took:.0f} s: {args.page}')
    return 0 if safe == len(rows) else 1

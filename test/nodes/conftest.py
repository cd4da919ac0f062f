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
What the tests of the nodes share: real node processes, a probe in the test process, deadlines.

Each test process takes a ROS domain of its own, so that several runs do not hear each other.
"""

from collections.abc import Callable, Iterator, Mapping
import contextlib
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any

from hapticvision_ros.bag.contract import (
    CANCEL_EXPERIMENT,
    ENABLE,
    ENABLE_EXPERIMENT,
    PUSH,
    Service,
    STOP,
    Topic,
)
from hapticvision_ros.nodes import qos
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

# Read when a message package is imported, when ROS starts, and by the node processes.
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['OMP_NUM_THREADS'] = '1'

START_DEADLINE = 90.0
"""A node takes a second of CPU time to start; six at once on a loaded machine take longer [s]."""
STOP_DEADLINE = 30.0
ASK_AGAIN = 10.0
"""What may be asked twice is asked again after this long without an answer [s]."""
REPEATABLE = tuple(
    each.name for each in (ENABLE, STOP, PUSH, ENABLE_EXPERIMENT, CANCEL_EXPERIMENT)
)
DOMAIN_LOCK_PORT = 61000


def wait_until(condition: Callable[[], Any], what: str, deadline: float = 60.0) -> Any:
    """Return the first true value of `condition`; fail the test after `deadline` [s]."""
    end = time.monotonic() + deadline
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.01)
    pytest.fail(f'{what}: not within {deadline:g} s')


class NodeProcess:
    """A node of the package in a process of its own, as a user starts it."""

    def __init__(self, name: str, arguments: list[str], log: Path) -> None:
        self.name = name
        self._log = log
        executable = Path(sys.executable).parent / name
        with log.open('wb') as output:
            self._process = subprocess.Popen(
                [str(executable), *arguments], stdout=output, stderr=subprocess.STDOUT
            )

    @property
    def output(self) -> str:
        """Return what the process has written so far."""
        return self._log.read_text(encoding='utf-8', errors='replace')

    @property
    def returncode(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        return self._process.poll()

    def wait(self, deadline: float = START_DEADLINE) -> int:
        """Return the exit code of a process that ends by itself."""
        return self._process.wait(deadline)

    def send_signal(self, number: int) -> None:
        """Send a signal to the process if it runs."""
        if self._process.poll() is None:
            self._process.send_signal(number)

    def stop(self, number: int = signal.SIGINT) -> int:
        """Stop the process with a signal and return its exit code; kill it when it hangs."""
        self.send_signal(number)
        try:
            return self._process.wait(STOP_DEADLINE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise


class Probe:
    """A node in the test process that hears and says what a test needs."""

    def __init__(self) -> None:
        self.node = rclpy.create_node('probe')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        while not self._closing.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def listen(self, topic: Topic) -> list[Any]:
        """Return a list that grows by each message of the topic."""
        heard: list[Any] = []
        qos.create_subscription(self.node, topic, heard.append)
        return heard

    def publisher(self, topic: Topic) -> Any:
        """Return a publisher of the topic that some node already listens to."""
        publisher = qos.create_publisher(self.node, topic)
        wait_until(publisher.get_subscription_count, f'a subscriber of {topic.name}')
        return publisher

    def send(self, topic: Topic, message: Any) -> None:
        """Publish one message, and return once those who listen have it in their queues."""
        from rclpy.duration import Duration

        publisher = self.publisher(topic)
        publisher.publish(message)
        assert publisher.wait_for_all_acked(Duration(seconds=20))

    def call(self, service: Service, request: Any, deadline: float = 60.0) -> Any:
        """
        Return the answer of a service.

        What may be done twice is asked for again if nothing comes back.
        """
        client = qos.create_client(self.node, service)
        wait_until(client.service_is_ready, f'the service {service.name}', START_DEADLINE)
        again = service.name.endswith(REPEATABLE)
        answer = self._ask(client, request, service.name, deadline, 3 if again else 1)
        self.node.destroy_client(client)
        return answer

    def _ask(self, client: Any, request: Any, what: str, deadline: float, times: int) -> Any:
        """Return a server's answer; ask again if it is lost."""
        end = time.monotonic() + deadline
        futures = [client.call_async(request)]

        def answered() -> Any:
            return next((future for future in futures if future.done()), None)

        for _ in range(times - 1):
            # A client is ready once it has found the server, which may not have found it yet.
            with contextlib.suppress(pytest.fail.Exception):
                return wait_until(answered, f'the answer of {what}', ASK_AGAIN).result()
            futures.append(client.call_async(request))
        return wait_until(answered, f'the answer of {what}', end - time.monotonic()).result()

    def set_parameters(self, node_name: str, values: Mapping[str, Any]) -> list[Any]:
        """Set parameters of a node over its service and return the results."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        client = self.node.create_client(SetParameters, f'{node_name}/set_parameters')
        wait_until(client.service_is_ready, f'the parameters of {node_name}', START_DEADLINE)
        request = SetParameters.Request(
            parameters=[
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
            ]
        )
        results = self._ask(client, request, f'the parameters of {node_name}', 60.0, 4).results
        self.node.destroy_client(client)
        return list(results)

    def forget(self, node_name: str) -> None:
        """
        Return once a node that was killed is taken for alive no more.

        Until then its services are asked too, and do not answer. The middleware has been seen to
        keep the name for more than a minute, which is no fault of a node: then the test after it
        asks again.

        """
        with contextlib.suppress(pytest.fail.Exception):
            wait_until(
                lambda: node_name not in self.node.get_node_names(),
                f'the end of {node_name}',
                deadline=30.0,
            )

    def start_push(self) -> None:
        """Allow motion and start a push, once the controller has fresh readings."""
        from std_srvs.srv import SetBool, Trigger

        assert self.call(ENABLE, SetBool.Request(data=True)).success

        def started() -> bool:
            answer = self.call(PUSH, Trigger.Request())
            # The first readings may still be on their way, and the answer that it begins may have
            # been lost; anything else is final.
            begun = answer.success or 'is running already' in answer.message
            assert begun or 'within the last' in answer.message, answer.message
            return bool(begun)

        wait_until(started, 'a start with fresh readings')

    def close(self) -> None:
        """End the thread and the node."""
        self._closing.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture(autouse=True)
def own_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what a controller that is killed leaves for its successor to the test at hand."""
    monkeypatch.setenv('TMPDIR', str(tmp_path))


@pytest.fixture
def until() -> Callable[..., Any]:
    """Return ``wait_until``, which test modules cannot import from here."""
    return wait_until


@pytest.fixture(scope='session', autouse=True)
def ros_domain() -> Iterator[int]:
    """Take a free ROS domain for this test process and its children."""
    for domain in range(1, 100):
        lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lock.bind(('127.0.0.1', DOMAIN_LOCK_PORT + domain))
        except OSError:
            lock.close()
            continue
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        with lock:
            yield domain
        return
    pytest.fail('all ROS domains are taken by other test runs')


@pytest.fixture(scope='session')
def ros(ros_domain: int) -> Iterator[None]:
    """Run ROS in the test process."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


class Diagnosis:
    """What one node says of itself on ``/diagnostics``."""

    def __init__(self, probe: Probe, node_name: str) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from hapticvision_ros.nodes.diagnostics import DIAGNOSTICS

        self._name = node_name
        self._heard: list[Any] = []
        probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._heard.append, 100)

    def wait(self, name: str, condition: Callable[[Any, dict[str, str]], Any], what: str) -> Any:
        """Return the first status from now on for which a condition on it and its values holds."""
        seen = len(self._heard)

        def found() -> Any:
            for array in self._heard[seen:]:
                for status in array.status:
                    values = {item.key: item.value for item in status.values}
                    if status.name == f'{self._name}: {name}' and condition(status, values):
                        return status
            return None

        return wait_until(found, what)


@pytest.fixture
def diagnosis(probe: Probe) -> Callable[[str], Diagnosis]:
    """Return what listens to a node's diagnostics, given the name of the node."""
    return lambda node_name: Diagnosis(probe, node_name)


@pytest.fixture
def probe(ros: None) -> Iterator[Probe]:
    """Give the test a node of its own."""
    made = Probe()
    yield made
    made.close()


@pytest.fixture
def connected(ros: None) -> Iterator[Callable[..., Any]]:
    """
    Connect a device in the test process, which is closed with the test.

    What is returned takes the module of its node, the function that connects it and the values of
    parameters.

    """
    from hapticvision_ros.nodes.parameters import Parameters
    from rclpy.parameter import Parameter

    made: list[Any] = []
    nodes: list[Any] = []

    def make(module: Any, connect: Callable[..., Any], values: Mapping[str, Any]) -> Any:
        node = rclpy.create_node(
            module.NAME,
            automatically_declare_parameters_from_overrides=True,
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
        )
        nodes.append(node)
        made.append(connect(node, Parameters(node, module.NAME, module.PARAMETERS)))
        return made[-1]

    yield make
    for device in made:
        device.close()
    for node in nodes:
        node.destroy_node()


class SimulatedWorld:
    """A simulated cell in a process of its own."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [str(Path(sys.executable).with_name('simulated_world')), *arguments],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        # Empty when the process has ended instead.
        words = self._process.stdout.readline().split()
        assert words[:1] == ['ready'], 'the simulated world did not start'
        self.port = int(words[1])

    def stop(self) -> None:
        """End the process; may be called again."""
        self._process.terminate()
        try:
            self._process.wait(STOP_DEADLINE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            raise
        finally:
            if self._process.stdout is not None:
                self._process.stdout.close()


@pytest.fixture
def start_world() -> Iterator[Callable[..., SimulatedWorld]]:
    """Start simulated worlds that end with the test; arguments as on the command line."""
    started: list[SimulatedWorld] = []

    def start(*arguments: str) -> SimulatedWorld:
        world = SimulatedWorld(*arguments)
        started.append(world)
        return world

    yield start
    for world in started:
        world.stop()


@pytest.fixture
def start_node(
    tmp_path: Path, start_world: Callable[..., SimulatedWorld]
) -> Iterator[Callable[..., NodeProcess]]:
    """
    Start node processes that end with the test, also with a failed one, and before their world.

    ``start_node('load_cell_driver', {'frame_rate': 10.0}, '-r', '__ns:=/cell')``; a whole path
    is that of a node that a test has made of one.
    """
    started: list[NodeProcess] = []

    def start(
        name: str, parameters: Mapping[str, Any] | None = None, *ros_arguments: str
    ) -> NodeProcess:
        arguments = ['--ros-args', *ros_arguments]
        for key, value in (parameters or {}).items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ['-p', f'{key}:={text}']
        process = NodeProcess(name, arguments, tmp_path / f'{name}-{len(started)}.log')
        started.append(process)
        return process

    yield start
    for process in started:
        process.stop()
    for process in started:
        sys.stdout.write(f'--- {process.name}: {process.returncode}\n{process.output}\n')

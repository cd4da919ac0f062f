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


"""The simulated world as a process, seen through its devices."""

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

from hapticvision_ros.core.devices import Arm, ArmState
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.sim.config import default_config_path, load_config, WorldConfig
from hapticvision_ros.sim.devices import (
    connect_arm,
    connect_load_cell,
    connect_range_sensor,
    place_new_sample,
)
from hapticvision_ros.sim.protocol import decode, encode
from hapticvision_ros.sim.server import WorldServer
from hapticvision_ros.sim.world import World
import numpy as np
import pytest
import yaml

COMMAND = (sys.executable, '-c', 'from hapticvision_ros.sim.server import main; exit(main())')
PATIENCE = 10.0
"""Longest wait for something that takes well under a second [s]."""

type StartWorld = Callable[..., tuple[subprocess.Popen[str], int]]


@pytest.fixture
def start_world() -> Iterator[StartWorld]:
    """Return a function that starts a world and returns its process and port."""
    processes: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> tuple[subprocess.Popen[str], int]:
        process = subprocess.Popen(
            [*COMMAND, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {'PYTHONUNBUFFERED': '1'},
        )
        processes.append(process)
        assert process.stdout is not None
        word, port = process.stdout.readline().split()
        assert word == 'ready'
        return process, int(port)

    yield start
    for process in processes:
        process.kill()
        process.communicate()


@pytest.fixture
def free_port() -> int:
    """Return a port on which nothing listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        port: int = probe.getsockname()[1]
        return port


def drive(arm: Arm, velocity: float, until: Callable[[ArmState], bool]) -> ArmState:
    """Command a velocity until the arm's state is as wanted, then stop."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        arm.command(velocity)
        state = arm.read(1.0)[-1]
        if until(state):
            arm.command(0.0)
            return state
    raise AssertionError('the arm did not get there')


def test_load_cell_streams_every_sample_once(start_world: StartWorld) -> None:
    _, port = start_world('--force-rate', '1000')
    before = time.time_ns()
    load_cell = connect_load_cell(port)
    stamps: list[int] = []
    while len(stamps) < 1000:
        stamps += [sample.stamp_ns for sample in load_cell.read(1.0)]
    after = time.time_ns()
    load_cell.close()
    np.testing.assert_array_equal(np.diff(stamps), 1_000_000)
    # Stamps are wall time: the first may have been on its way when the device connected.
    assert before - 50_000_000 < stamps[0] < stamps[-1] <= after


def test_arm_moves_as_commanded_and_stops_when_left_alone(
    start_world: StartWorld, config: WorldConfig
) -> None:
    _, port = start_world()
    arm = connect_arm(port)
    start = arm.read(1.0)[-1].tool_height
    assert start == pytest.approx(config.arm.start_height, abs=1e-5)
    moving = drive(arm, 0.02, lambda state: state.tool_height < start - 0.002)
    arm.command(0.02)
    stopping: list[ArmState] = []
    while not stopping or stopping[-1].stamp_ns < moving.stamp_ns + 400_000_000:
        stopping += arm.read(1.0)
    arm.close()
    heights = [state.tool_height for state in stopping]
    assert heights[-1] < moving.tool_height - 0.5 * 0.02 * config.arm.watchdog
    # At rest the encoder's noise of 1 um is all that is left.
    assert np.ptp(heights[-20:]) < 1e-5


def test_the_stamps_go_with_a_clock_that_is_set(monkeypatch) -> None:
    class Stamps(WorldServer):
        def _stream(self, readings, start_ns):
            stamps.append(start_ns)

    class SetOnce:
        def step(self) -> float:
            return 100.0 if len(stamps) == 3 else 0.0

    stamps: list[int] = []
    config = load_config(None)
    server = Stamps(World(config, config.material('soft_dough'), seed=1), config, 0)
    monkeypatch.setattr('hapticvision_ros.sim.server.ClockWatch', lambda *clocks: SetOnce())
    try:
        server.serve(lambda: len(stamps) == 6)
    finally:
        server.close()
    assert [stamp - stamps[0] for stamp in stamps] == [0] * 3 + [100 * 10**9] * 3


def test_push_is_felt_seen_and_forgotten_with_a_new_sample(
    start_world: StartWorld, config: WorldConfig
) -> None:
    _, port = start_world('--object', 'soft_dough', '--range-rate', '30')
    arm = connect_arm(port)
    load_cell = connect_load_cell(port)
    sensor = connect_range_sensor(port, width=64, height=48, depth_noise=0.0, seed=1)
    top = config.block.height

    def dent() -> float:
        """Return the depth of the dent as the range sensor sees it now, NaN if it cannot."""
        sensor.grab(1.0)
        points = sensor.grab(1.0).xyz.reshape(-1, 3)
        seen = points[np.hypot(points[:, 0], points[:, 1]) < 0.006]
        return top - float(np.median(seen[:, 2])) if len(seen) > 3 else np.nan

    assert dent() == pytest.approx(0.0, abs=1e-6)
    drive(arm, 0.05, lambda state: state.tool_height < top - 0.006)
    assert -load_cell.read(1.0)[-1].force[2] > 5.0
    with pytest.raises(DeviceError, match='tool is in the way'):
        place_new_sample(port)
    assert np.isnan(dent())
    drive(arm, -0.1, lambda state: state.tool_height > top + 0.03)
    assert dent() > 0.001
    place_new_sample(port)
    assert dent() == pytest.approx(0.0, abs=1e-6)
    for device in (arm, load_cell, sensor):
        device.close()


def test_two_devices_of_a_kind_see_the_same_world(start_world: StartWorld) -> None:
    _, port = start_world()
    first, second = connect_load_cell(port), connect_load_cell(port)
    seen: list[dict[int, float]] = [{}, {}]
    while len(seen[0]) < 200:
        for device, samples in zip((first, second), seen, strict=True):
            samples |= {sample.stamp_ns: sample.force[2] for sample in device.read(1.0)}
    shared = seen[0].keys() & seen[1].keys()
    assert len(shared) > 100
    assert all(seen[0][stamp] == seen[1][stamp] for stamp in shared)
    first.close()
    second.close()


def test_a_soft_body_is_seen_to_deform(
    start_world: StartWorld, config: WorldConfig, tmp_path: Path
) -> None:
    content = yaml.safe_load(default_config_path().read_text())
    content['block'] |= {'length': 0.04, 'width': 0.04, 'height': 0.02, 'rim_width': 0.004}
    content['arm'] |= {'tool_radius': 0.01, 'start_height': 0.030}
    content['soft_body'] = {'pitch': 0.01, 'step': 0.001, 'volume_ratio': 1.0}
    path = tmp_path / 'cell.yaml'
    path.write_text(yaml.safe_dump(content))
    _, port = start_world('--config', str(path), '--range-rate', '20')
    arm = connect_arm(port)
    sensor = connect_range_sensor(port, width=160, height=120, depth_noise=0.0, seed=1)

    def look() -> tuple[float, float]:
        """Return the height of the middle of the top, and how far the near side stands out."""
        points = sensor.grab(PATIENCE).xyz.reshape(-1, 3)
        middle = np.hypot(points[:, 0], points[:, 1]) < 0.004
        side = (points[:, 2] > 0.006) & (points[:, 2] < 0.014) & (points[:, 1] < -0.0195)
        return float(np.median(points[middle, 2])), float(-points[side, 1].mean())

    top, side = look()
    assert top == pytest.approx(0.020, abs=1e-6)
    assert side == pytest.approx(0.020, abs=1e-6)
    drive(arm, 0.02, lambda state: state.tool_height < 0.017)
    drive(arm, -0.04, lambda state: state.tool_height > 0.036)
    sensor.grab(PATIENCE)
    top, side = look()
    assert 0.016 < top < 0.0185
    assert side > 0.0203
    arm.close()
    sensor.close()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_world_ends_cleanly_and_its_devices_say_so(
    start_world: StartWorld, number: signal.Signals
) -> None:
    process, port = start_world()
    load_cell = connect_load_cell(port)
    load_cell.read(1.0)
    # As from a terminal and from `ros2 launch`: more of them must not kill it while it ends.
    end = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < end:
        process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, '')
    with pytest.raises(DeviceError, match=r'has gone|has sent no force'):
        for _ in range(3):
            load_cell.read(0.3)
    load_cell.close()


def test_no_world_is_told_in_one_sentence(free_port: int) -> None:
    with pytest.raises(DeviceError, match=f'no simulated world answers on UDP port {free_port}'):
        connect_arm(free_port)


def test_a_world_that_starts_late_is_waited_for(free_port: int) -> None:
    # The device asks first: the process takes longer to start than this line.
    process = subprocess.Popen(
        [*COMMAND, '--port', str(free_port)], stdout=subprocess.DEVNULL, text=True
    )
    try:
        arm = connect_arm(free_port)
        assert arm.read(1.0)
        arm.close()
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (('--object', 'cheese'), "no simulated object 'cheese'"),
        (('--force-rate', '5000'), '--force-rate is 5000 Hz, but must lie in 1 to 1000'),
        (('--config', 'nowhere.yaml'), 'nowhere.yaml: cannot be read'),
        (('--port', '70000'), 'UDP port 70000'),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(
    arguments: tuple[str, ...], sentence: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_taken_port_is_told_in_one_sentence(start_world: StartWorld) -> None:
    _, port = start_world()
    done = subprocess.run(
        [*COMMAND, '--port', str(port)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert f'UDP port {port} on 127.0.0.1 cannot be had' in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_nonsense_on_the_port_does_no_harm(start_world: StartWorld) -> None:
    process, port = start_world()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.settimeout(PATIENCE)
        stranger.connect(('127.0.0.1', port))
        for nonsense in (
            b'',
            b'\xff\x00',
            b'{',
            b'{"request": "push", "velocity": NaN}',
            b'{"request": "push", "velocity": "fast"}',
            b'{"request": "open", "stream": "smell"}',
            b'{"request": ["open"]}',
        ):
            stranger.send(nonsense)
        answers = [decode(stranger.recv(2048)) for _ in range(3)]
        assert all(answer is not None and 'error' in answer for answer in answers)
        stranger.send(encode({'request': 'open', 'stream': 'arm'}))
        while (answer := decode(stranger.recv(2048))) is None:
            pass
        assert answer['answer'] == 'open'
    assert process.poll() is None

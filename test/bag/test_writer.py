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


"""Our bags are what rosbag2 writes, whatever happens to the recorder."""

from pathlib import Path
import resource
import subprocess
import sys

from hapticvision_ros.bag.contract import (
    CELL_TOPICS,
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PROVENANCE,
    PUSH_VELOCITY,
    TOOL_HEIGHT,
    TOPICS,
    WRENCH,
)
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.bag.writer import BagWriter, Compression, write_signals
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import CloudFrame, Signal
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
import yaml

START_NS = 1_700_000_000_123_456_789

# The keys that rosbag2 0.26 (Jazzy) writes in metadata version 9, in its order.
INFORMATION_KEYS = [
    'version',
    'storage_identifier',
    'duration',
    'starting_time',
    'message_count',
    'topics_with_message_count',
    'compression_format',
    'compression_mode',
    'relative_file_paths',
    'files',
    'custom_data',
    'ros_distro',
]
TOPIC_KEYS = [
    'name',
    'type',
    'serialization_format',
    'offered_qos_profiles',
    'type_description_hash',
]


def write_example(path: Path, compression: Compression = 'zstd') -> dict[str, Signal]:
    """Write a trial with all topics; return its signals."""
    t = np.arange(300) * 1e-3
    signals = {
        'force': Signal(t, np.sin(40.0 * t)),
        'tool_height': Signal(t[::2], 0.05 - 0.01 * t[::2]),
        'displacement': Signal(t[::30], 0.01 * t[::30]),
        'push_velocity': Signal(t[:2], np.array([0.0, 0.01])),
    }
    cloud = np.arange(36, dtype=np.float32).reshape(3, 4, 3)
    write_signals(
        path,
        start_ns=START_NS,
        **signals,
        phases=[(0.0, 'approach'), (0.1, 'push')],
        clouds=(CloudFrame(k / 10, cloud + k, 'support_plane') for k in range(3)),
        provenance={'source': 'a machine', 'licence': 'MIT'},
        compression=compression,
    )
    return signals


@pytest.mark.parametrize('name', ['trial', 'trial.mcap'])
@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_what_is_written_is_read_back(tmp_path: Path, name: str, compression: Compression) -> None:
    signals = write_example(tmp_path / name, compression)
    trial = read_trial(tmp_path / name)
    assert trial.warnings == ()
    assert (trial.name, trial.start_ns) == ('trial', START_NS)
    pairs = {
        'force': trial.force,
        'tool_height': trial.tool_height,
        'displacement': trial.displacement_height,
        'push_velocity': trial.push_velocity,
    }
    for key, found in pairs.items():
        # The bag keeps whole nanoseconds.
        np.testing.assert_allclose(found.t, signals[key].t, rtol=0, atol=0.5e-9)
        np.testing.assert_array_equal(found.value, signals[key].value)
    assert trial.phases == ((0.0, 'approach'), (0.1, 'push'))
    assert trial.provenance['licence'] == 'MIT'
    for k, frame in enumerate(trial.clouds):
        expected = np.arange(36, dtype=np.float32).reshape(3, 4, 3) + k
        np.testing.assert_array_equal(frame.xyz, expected)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_rosbags_reads_the_same(tmp_path: Path, compression: Compression) -> None:
    signals = write_example(tmp_path / 'trial', compression)
    found: dict[str, list[tuple[int, object]]] = {}
    with AnyReader([tmp_path / 'trial']) as reader:
        assert reader.message_count == 300 + 150 + 10 + 2 + 2 + 3
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    forces = [message.wrench.force.z for _, message in found[WRENCH.name]]
    np.testing.assert_array_equal(forces, -signals['force'].value)
    heights = [message.data for _, message in found[TOOL_HEIGHT.name]]
    np.testing.assert_array_equal(heights, signals['tool_height'].value)
    assert [message.data for _, message in found[PHASE.name]] == ['approach', 'push']
    assert [message.width for _, message in found[POINTS.name]] == [4, 4, 4]
    assert found[WRENCH.name][7][0] == START_NS + 7_000_000


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_the_file_passes_a_strict_mcap_reader(tmp_path: Path, compression: Compression) -> None:
    path = tmp_path / 'trial.mcap'
    write_example(path, compression)
    with path.open('rb') as file:
        records = [type(r).__name__ for r in StreamReader(file, validate_crcs=True).records]
    assert records[0] == 'Header' and records[-1] == 'Footer'
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        assert summary.statistics.message_count == 467
        assert {s.encoding for s in summary.schemas.values()} == {'ros2msg'}
        assert {c.message_encoding for c in summary.channels.values()} == {'cdr'}
        assert {m.name for m in reader.iter_metadata()} == {PROVENANCE, 'rosbag2'}
        times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == sorted(times)


def test_metadata_is_as_rosbag2_writes_it(tmp_path: Path) -> None:
    write_example(tmp_path / 'trial')
    metadata = yaml.safe_load((tmp_path / 'trial' / 'metadata.yaml').read_text())
    assert list(metadata) == ['rosbag2_bagfile_information']
    information = metadata['rosbag2_bagfile_information']
    assert list(information) == INFORMATION_KEYS
    assert information['version'] == 9
    assert information['storage_identifier'] == 'mcap'
    assert information['message_count'] == 467
    assert information['starting_time'] == {'nanoseconds_since_epoch': START_NS}
    assert information['duration'] == {'nanoseconds': 299_000_000}
    assert information['relative_file_paths'] == ['trial_0.mcap']
    assert (information['files'][0]['path'], information['ros_distro']) == (
        'trial_0.mcap',
        'jazzy',
    )
    topics = information['topics_with_message_count']
    for entry in topics:
        assert list(entry) == ['topic_metadata', 'message_count']
        assert list(entry['topic_metadata']) == TOPIC_KEYS
    counts = {entry['topic_metadata']['name']: entry['message_count'] for entry in topics}
    assert counts == {
        WRENCH.name: 300,
        TOOL_HEIGHT.name: 150,
        DISPLACEMENT_HEIGHT.name: 10,
        PUSH_VELOCITY.name: 2,
        PHASE.name: 2,
        POINTS.name: 3,
    }


def test_the_offered_quality_of_service_is_that_of_the_contract(tmp_path: Path) -> None:
    write_example(tmp_path / 'trial')
    by_name = {topic.name: topic for topic in TOPICS}
    with AnyReader([tmp_path / 'trial']) as reader:
        for connection in reader.connections:
            (qos,) = connection.ext.offered_qos_profiles
            expected = by_name[connection.topic].qos
            assert qos.reliability == QosReliability[expected.reliability.upper()]
            assert qos.durability == QosDurability[expected.durability.upper()]
            assert qos.depth == expected.publish_depth


def test_type_hashes_are_those_of_the_installed_ros(tmp_path: Path) -> None:
    messages = pytest.importorskip('std_msgs.msg')
    geometry = pytest.importorskip('geometry_msgs.msg')
    sensor = pytest.importorskip('sensor_msgs.msg')
    write_example(tmp_path / 'trial')
    with AnyReader([tmp_path / 'trial']) as reader:
        digests = {c.msgtype: c.digest for c in reader.connections}
    assert set(digests) == {
        'std_msgs/msg/Float64',
        'std_msgs/msg/String',
        'geometry_msgs/msg/WrenchStamped',
        'sensor_msgs/msg/PointCloud2',
    }
    for module, name in (
        (messages, 'std_msgs/msg/Float64'),
        (messages, 'std_msgs/msg/String'),
        (geometry, 'geometry_msgs/msg/WrenchStamped'),
        (sensor, 'sensor_msgs/msg/PointCloud2'),
    ):
        share = next(
            folder / 'share'
            for folder in Path(module.__file__).parents
            if (folder / 'share' / name).with_suffix('.json').exists()
        )
        described = yaml.safe_load((share / name).with_suffix('.json').read_text())
        hashes = {entry['type_name']: entry['hash_string'] for entry in described['type_hashes']}
        assert digests[name] == hashes[name]


def test_any_topic_of_the_cell_can_be_recorded_raw(tmp_path: Path, store) -> None:
    path = tmp_path / 'cell'
    with BagWriter(path) as writer:
        for number, topic in enumerate((*TOPICS, *CELL_TOPICS)):
            writer.write_raw(topic, memoryview(b'\x00\x01\x00\x00'), START_NS + number, START_NS)
        assert writer.message_count == len(TOPICS) + len(CELL_TOPICS)
    with AnyReader([path]) as reader:
        found = {connection.topic: connection.msgtype for connection in reader.connections}
    assert found == {topic.name: topic.msgtype for topic in (*TOPICS, *CELL_TOPICS)}


def test_publish_time_and_log_time_are_kept_apart(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'trial.mcap') as writer:
        writer.write_raw(TOOL_HEIGHT, b'\x00\x01\x00\x00' + bytes(8), 2000, 1000)
    with (tmp_path / 'trial.mcap').open('rb') as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    assert (message.log_time, message.publish_time) == (2000, 1000)


def test_the_same_trial_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in 'ab':
        write_example(tmp_path / name / 'trial')
    first, second = (tmp_path / name / 'trial' / 'trial_0.mcap' for name in 'ab')
    assert first.read_bytes() == second.read_bytes()


RECORDER = """
import os, sys, time
from pathlib import Path
from hapticvision_ros.bag import writer
from hapticvision_ros.bag.contract import TOOL_HEIGHT
bag = writer.BagWriter(Path(sys.argv[1]))
start = time.monotonic()
count = safe = 0
while (passed := time.monotonic() - start) < 1.5:
    bag.write_wrench(count * 1_000_000, (0.0, 0.0, -1.0))
    bag.write_float64(TOOL_HEIGHT, count * 1_000_000, 0.05)
    count += 1
    if passed < 0.4:
        safe = count
    time.sleep(0.002)
print(safe, flush=True)
os._exit(9)
"""


def test_a_recorder_that_dies_loses_at_most_a_second(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, '-c', RECORDER, tmp_path / 'live'],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert run.returncode == 9, run.stderr
    written_a_second_before = int(run.stdout)
    trial = read_trial(tmp_path / 'live')
    assert not (tmp_path / 'live' / 'metadata.yaml').exists()
    assert len(trial.force) >= written_a_second_before > 0
    assert any('breaks off' in warning for warning in trial.warnings)


def test_a_live_bag_survives_an_error_of_its_user(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / 'live') as writer:
        writer.write_wrench(START_NS, (0.0, 0.0, -1.0))
        writer.write_float64(TOOL_HEIGHT, START_NS, 0.05)
        raise ZeroDivisionError
    assert len(read_trial(tmp_path / 'live').force) == 1
    assert (tmp_path / 'live' / 'metadata.yaml').exists()


@pytest.mark.parametrize('name', ['trial', 'trial.mcap'])
def test_an_offline_bag_appears_whole_or_not_at_all(tmp_path: Path, name: str) -> None:
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / name, atomic=True) as writer:
        writer.write_wrench(START_NS, (0.0, 0.0, -1.0))
        assert not (tmp_path / name).exists()
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_bag_that_exists_is_not_overwritten(tmp_path: Path) -> None:
    write_example(tmp_path / 'trial')
    before = (tmp_path / 'trial' / 'trial_0.mcap').read_bytes()
    with pytest.raises(InputError, match='exists already'):
        write_example(tmp_path / 'trial')
    assert (tmp_path / 'trial' / 'trial_0.mcap').read_bytes() == before


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='cannot be written'):
        BagWriter(tmp_path / 'file' / 'trial')


@pytest.mark.parametrize('atomic', [True, False])
def test_a_full_disk_is_told(tmp_path: Path, atomic: bool) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    cloud = np.zeros((100_000, 3), np.float32)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, hard))
    try:
        with (
            pytest.raises(InputError, match='cannot be written'),
            BagWriter(tmp_path / 'bag', atomic=atomic) as writer,
        ):
            writer.write_wrench(START_NS, (0.0, 0.0, -1.0))
            writer.write_float64(TOOL_HEIGHT, START_NS, 0.05)
            for k in range(5):
                writer.write_cloud(START_NS + k, 'support_plane', cloud)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    if atomic:
        assert list(tmp_path.iterdir()) == []
    else:
        assert len(read_trial(tmp_path / 'bag').clouds) >= 1

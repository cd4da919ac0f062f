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


"""Bags of every state give as much of the trial as they hold, and a sentence on what is wrong."""

from collections.abc import Callable
from dataclasses import replace
import os
from pathlib import Path
import shutil

from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PUSH_VELOCITY,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.bag.mcap_scan import MAGIC
from hapticvision_ros.bag.reader import _touched, read_trial
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import Signal, Trial
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
import numpy as np
import pytest

BAGS = Path(__file__).resolve().parents[2] / 'bags'
MS = 1_000_000
START_NS = 1_700_000_000_123_456_789

Foreign = Callable[..., Path]


def only_warning(trial: Trial) -> str:
    """Return the single warning of a trial."""
    assert len(trial.warnings) == 1, trial.warnings
    return trial.warnings[0]


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('chunked', [True, False])
def test_a_whole_bag_is_read_without_a_warning(
    maker, foreign: Foreign, compression: CompressionType, chunked: bool
) -> None:
    metadata = {'provenance': {'source': 'a machine'}}
    path = foreign(maker.trial(), compression=compression, chunked=chunked, metadata=metadata)
    trial = read_trial(path)
    assert trial.warnings == ()
    assert (trial.name, trial.start_ns) == ('trial', START_NS)
    # Nanoseconds survive the subtraction: the times are exact to the rounding of a float64.
    np.testing.assert_allclose(trial.force.t, np.arange(100) * 1e-3, rtol=1e-15, atol=0)
    np.testing.assert_array_equal(trial.force.value, np.arange(100.0))
    assert len(trial.tool_height) == 50
    np.testing.assert_allclose(trial.displacement_height.value, 1e-4 * np.arange(0, 100, 10))
    assert trial.displacement_source == 'topic'
    assert trial.push_velocity.value.tolist() == [0.001]
    assert trial.phases == ((0.0, 'approach'), (0.05, 'push'))
    assert [frame.t for frame in trial.clouds] == [0.02, 0.06]
    assert dict(trial.provenance) == {'source': 'a machine'}


def test_one_displacement_for_both_is_told_by_the_provenance(maker, foreign: Foreign) -> None:
    metadata = {'provenance': {'displacement_source': 'tool'}}
    assert read_trial(foreign(maker.trial(), metadata=metadata)).displacement_source == 'tool'


def test_the_header_stamp_counts_and_not_the_publish_time(maker, foreign: Foreign) -> None:
    samples = [maker.wrench(k, 0.0, publish_ns=START_NS + (k + 7) * MS) for k in range(30)]
    samples += [maker.number(TOOL_HEIGHT, k, 0.0, log_ns=START_NS) for k in range(30)]
    trial = read_trial(foreign(samples))
    assert trial.force.t[0] == trial.tool_height.t[0] == 0.0
    assert trial.force.t[-1] == trial.tool_height.t[-1] == 0.029


def test_messages_out_of_order_are_sorted(maker, foreign: Foreign) -> None:
    samples = maker.trial()
    order = np.random.default_rng(1).permutation(len(samples))
    trial = read_trial(foreign([samples[k] for k in order]))
    np.testing.assert_array_equal(trial.force.value, np.arange(100.0))
    late = [w for w in trial.warnings if 'out of order' in w]
    assert any(w.startswith(WRENCH.name) for w in late)
    assert trial.phases == ((0.0, 'approach'), (0.05, 'push'))


def test_of_repeated_stamps_the_first_is_kept(maker, foreign: Foreign) -> None:
    samples = maker.trial()
    for ms in (1, 60):
        place = samples.index(maker.wrench(ms, -float(ms)))
        samples.insert(place + 1, maker.wrench(ms, 99.0))
    trial = read_trial(foreign(samples))
    np.testing.assert_array_equal(trial.force.value, np.arange(100.0))
    assert '2 of 102 messages repeat a time stamp' in only_warning(trial)


def test_of_repeated_stamps_out_of_order_the_first_in_the_file_is_kept(
    maker, foreign: Foreign
) -> None:
    order = np.random.default_rng(3).permutation(60).tolist()
    samples = [maker.wrench(ms, -float(ms)) for ms in order]
    samples += [maker.wrench(ms, 99.0) for ms in reversed(order)]
    samples += [maker.number(TOOL_HEIGHT, ms, 0.0) for ms in range(60)]
    trial = read_trial(foreign(samples))
    np.testing.assert_array_equal(trial.force.value, np.arange(60.0))
    assert any('60 of 120 messages repeat a time stamp' in w for w in trial.warnings)


def test_gaps_are_counted(maker, foreign: Foreign) -> None:
    samples = [maker.wrench(k, 0.0) for k in range(400) if not 100 <= k < 150 and k != 300]
    samples += [maker.number(TOOL_HEIGHT, k, 0.0) for k in range(400)]
    samples += [maker.number(DISPLACEMENT_HEIGHT, k, 0.0) for k in range(0, 400, 50)]
    samples.sort(key=lambda sample: sample.publish_ns)
    warning = only_warning(read_trial(foreign(samples)))
    assert warning.startswith(WRENCH.name)
    assert '1 gap, the longest 0.051 s at 0.099 s' in warning


def test_jitter_is_told(maker, foreign: Foreign) -> None:
    times = np.cumsum(np.random.default_rng(2).uniform(0.01, 4.0, 300))
    samples = [maker.wrench(t, 0.0) for t in times]
    samples += [maker.number(TOOL_HEIGHT, k, 0.0) for k in range(600)]
    samples += [maker.number(DISPLACEMENT_HEIGHT, k, 0.0) for k in range(0, 600, 50)]
    samples.sort(key=lambda sample: sample.publish_ns)
    warning = only_warning(read_trial(foreign(samples)))
    assert warning.startswith(WRENCH.name) and 'uneven' in warning


def test_samples_that_are_no_numbers_are_left_out(maker, foreign: Foreign) -> None:
    samples = maker.trial()
    bad = {3: np.nan, 10: np.inf, 77: -np.inf}
    for ms, value in bad.items():
        place = samples.index(maker.wrench(ms, -float(ms)))
        samples[place] = maker.wrench(ms, value)
    trial = read_trial(foreign(samples))
    expected = [float(k) for k in range(100) if k not in bad]
    assert trial.force.value.tolist() == expected
    assert '3 of 100 samples are NaN or infinite' in only_warning(trial)


@pytest.mark.parametrize('topic', [WRENCH, TOOL_HEIGHT])
def test_a_bag_without_a_needed_topic_is_refused(maker, foreign: Foreign, topic) -> None:
    samples = [sample for sample in maker.trial() if sample.topic != topic.name]
    with pytest.raises(InputError) as refusal:
        read_trial(foreign(samples))
    assert f'{topic.name} has no messages' in str(refusal.value)
    assert PHASE.name in str(refusal.value)
    assert '\n' not in str(refusal.value)


@pytest.mark.parametrize('topic', [WRENCH, TOOL_HEIGHT])
def test_a_needed_topic_of_nan_is_refused(maker, foreign: Foreign, topic) -> None:
    samples = [sample for sample in maker.trial() if sample.topic != topic.name]
    for ms in range(4):
        bad = maker.wrench(ms, np.nan) if topic is WRENCH else maker.number(topic, ms, np.nan)
        samples.append(bad)
    with pytest.raises(InputError, match=f'{topic.name} holds no finite number in 4 messages'):
        read_trial(foreign(samples))


def test_without_points_and_displacement_the_displacement_is_unknown(
    maker, foreign: Foreign
) -> None:
    left_out = (POINTS.name, DISPLACEMENT_HEIGHT.name)
    samples = [sample for sample in maker.trial() if sample.topic not in left_out]
    trial = read_trial(foreign(samples))
    assert trial.displacement_height is None and trial.clouds is None
    assert trial.displacement_source == 'none'
    assert DISPLACEMENT_HEIGHT.name in only_warning(trial)


def test_where_it_was_not_recorded_the_displacement_comes_from_the_points() -> None:
    (bag,) = (BAGS / 'synthetic_clouds').glob('*/')
    trial = read_trial(bag)
    assert trial.displacement_source == 'points'
    # The tool went 5 mm deep: what is left once it has risen is a part of that.
    assert 0.0 < trial.displacement_height.value.max() < 0.005
    trial = read_trial(bag, displacement_from_points=False)
    assert (trial.displacement_source, trial.displacement_height) == ('none', None)


def test_messages_of_the_wrong_type_are_left_out(maker, foreign: Foreign) -> None:
    wrong = replace(maker.text(PHASE, 3, 'no number'), topic=DISPLACEMENT_HEIGHT.name)
    trial = read_trial(foreign([wrong, *maker.trial()]))
    assert len(trial.displacement_height) == 10
    assert 'hold std_msgs/msg/String and not std_msgs/msg/Float64' in only_warning(trial)


def test_a_needed_topic_of_the_wrong_type_is_refused(maker, foreign: Foreign) -> None:
    samples = [sample for sample in maker.trial() if sample.topic != TOOL_HEIGHT.name]
    samples.append(replace(maker.text(PHASE, 3, '0.05'), topic=TOOL_HEIGHT.name))
    with pytest.raises(InputError, match='hold std_msgs/msg/String and not std_msgs/msg/Float64'):
        read_trial(foreign(samples))


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'encoding': 'json'}, "are encoded as 'json' and not as cdr"),
        ({'schema_encoding': 'protobuf'}, "have a schema in 'protobuf' and not in ros2msg"),
        ({'data': b'\x00\x01\x00\x00\x01'}, 'are damaged or not in plain CDR'),
        ({'data': b''}, 'are damaged or not in plain CDR'),
    ],
)
def test_messages_of_the_wrong_encoding_are_left_out(
    maker, foreign: Foreign, change: dict, reason: str
) -> None:
    samples = maker.trial()
    samples.append(replace(maker.wrench(100, 5.0), **change))
    trial = read_trial(foreign(samples))
    assert len(trial.force) == 100
    assert only_warning(trial) == f'{WRENCH.name}: 1 of 101 messages {reason}: left out'


def test_idl_schemas_and_short_type_names_are_accepted(maker, foreign: Foreign) -> None:
    samples = [replace(sample, schema_encoding='ros2idl') for sample in maker.trial()]
    assert read_trial(foreign(samples)).warnings == ()


def test_other_topics_are_ignored(maker, foreign: Foreign) -> None:
    camera = replace(maker.text(PHASE, 1, 'x'), topic='/camera', encoding='json', data=b'{}')
    assert read_trial(foreign([camera, *maker.trial(), camera])).warnings == ()


def test_a_single_sample_is_a_trial_with_a_warning(maker, foreign: Foreign) -> None:
    samples = [maker.wrench(0, -1.0), maker.number(TOOL_HEIGHT, 0, 0.05)]
    trial = read_trial(foreign(samples))
    assert len(trial.force) == len(trial.tool_height) == 1
    assert sum('one sample only' in warning for warning in trial.warnings) == 2


def test_stamps_that_were_never_set_are_replaced(maker, foreign: Foreign) -> None:
    samples = maker.trial()
    for ms in (0, 4, 99):
        place = samples.index(maker.wrench(ms, -float(ms)))
        samples[place] = maker.wrench(ms, -float(ms), stamp_ns=0, publish_ns=START_NS + ms * MS)
    trial = read_trial(foreign(samples))
    assert trial.start_ns == START_NS
    np.testing.assert_allclose(trial.force.t, np.arange(100) * 1e-3, rtol=1e-12, atol=0)
    assert '3 header stamps are unset or absurd' in only_warning(trial)


@pytest.mark.parametrize('epoch_ns', [0, 5 * 10**9, 2 * 10**18])
def test_a_sensor_clock_decades_away_is_moved_onto_the_publish_times(
    maker, foreign: Foreign, epoch_ns: int
) -> None:
    samples = [s for s in maker.trial() if s.topic != WRENCH.name]
    samples += [
        maker.wrench(k, -float(k), stamp_ns=epoch_ns + 1 + k * MS, publish_ns=START_NS + k * MS)
        for k in range(100)
    ]
    samples.sort(key=lambda sample: sample.publish_ns)
    trial = read_trial(foreign(samples))
    np.testing.assert_allclose(trial.force.t, np.arange(100) * 1e-3, atol=1e-9)
    assert 's away from the publish times' in only_warning(trial)


def test_publish_times_that_were_never_set_are_replaced(maker, foreign: Foreign) -> None:
    samples = [
        replace(sample, publish_ns=0) if sample.topic == TOOL_HEIGHT.name else sample
        for sample in maker.trial()
    ]
    trial = read_trial(foreign(samples))
    assert trial.start_ns == START_NS
    np.testing.assert_allclose(trial.tool_height.t, np.arange(0, 100, 2) * 1e-3, rtol=1e-12)
    assert '50 publish times are unset or absurd' in only_warning(trial)


@pytest.mark.parametrize(
    ('first_ns', 'interval_ns'), [(0, 0), (10**18, 10 * MS)], ids=['never set', 'fast replay']
)
def test_header_stamps_stand_where_the_publish_times_make_no_sense(
    maker, foreign: Foreign, first_ns: int, interval_ns: int
) -> None:
    samples = [
        maker.wrench(1000 * k, -float(k), publish_ns=first_ns + k * interval_ns)
        for k in range(100)
    ]
    samples += [maker.number(TOOL_HEIGHT, 1000 * k, 0.0) for k in range(100)]
    trial = read_trial(foreign(samples))
    np.testing.assert_allclose(trial.force.t, np.arange(100.0), rtol=1e-12)
    assert DISPLACEMENT_HEIGHT.name in only_warning(trial)


def test_a_trial_may_start_at_the_epoch(maker, foreign: Foreign) -> None:
    samples = [
        replace(s, publish_ns=s.publish_ns - START_NS, log_ns=s.log_ns - START_NS)
        for s in maker.trial()
        if s.topic not in (WRENCH.name, POINTS.name)
    ]
    samples += [maker.wrench(k, 0.0, stamp_ns=k * MS, publish_ns=k * MS) for k in range(100)]
    samples.sort(key=lambda sample: sample.publish_ns)
    trial = read_trial(foreign(samples))
    assert trial.start_ns == 0 and trial.warnings == ()


def test_times_beyond_any_date_do_not_overflow(maker, foreign: Foreign) -> None:
    samples = maker.trial()
    samples += [
        replace(maker.number(TOOL_HEIGHT, 40, 1.0), publish_ns=2**64 - 1, log_ns=2**64 - 1),
        maker.wrench(50, 1.0, stamp_ns=-(2**31) * 10**9, publish_ns=2**64 - 1),
    ]
    trial = read_trial(foreign(samples))
    assert len(trial.force) >= 100 and trial.warnings


@pytest.mark.parametrize('far_ns', [0, 10**9, 3 * 10**18])
def test_messages_of_another_date_are_left_out(maker, foreign: Foreign, far_ns: int) -> None:
    samples = maker.trial()
    for topic in (TOOL_HEIGHT, PUSH_VELOCITY):
        far = replace(maker.number(topic, 40, 1.0), publish_ns=far_ns, log_ns=far_ns)
        samples.append(far)
    trial = read_trial(foreign(samples))
    assert trial.start_ns == START_NS
    np.testing.assert_allclose(trial.tool_height.t, np.arange(0, 100, 2) * 1e-3, rtol=1e-12)
    assert len(trial.push_velocity) == 1
    assert [w.split(': ')[1] for w in trial.warnings] == [
        '1 of 51 messages are over a day away from the trial',
        '1 of 2 messages are over a day away from the trial',
    ]


def test_a_needed_topic_of_another_date_is_refused(maker, foreign: Foreign) -> None:
    samples = [s for s in maker.trial() if s.topic != TOOL_HEIGHT.name]
    far = maker.number(TOOL_HEIGHT, 0, 1.0)
    samples.append(replace(far, publish_ns=10**9, log_ns=10**9))
    with pytest.raises(InputError, match='1 of its 1 messages are over a day away'):
        read_trial(foreign(samples))


def test_streams_that_do_not_overlap_are_told(maker, foreign: Foreign) -> None:
    samples = [maker.wrench(k, 0.0) for k in range(10)]
    samples += [maker.number(TOOL_HEIGHT, k, 0.0) for k in range(5000, 5010)]
    trial = read_trial(foreign(samples))
    assert any('do not overlap in time' in warning for warning in trial.warnings)


def test_a_force_in_another_frame_is_told(maker, foreign: Foreign) -> None:
    samples = [s for s in maker.trial() if s.topic != WRENCH.name]
    samples += [maker.wrench(k, 0.0, frame_id='tool0') for k in range(100)]
    samples.sort(key=lambda sample: sample.publish_ns)
    assert "the force is in the frame 'tool0'" in only_warning(read_trial(foreign(samples)))


def test_unknown_phases_are_left_out(maker, foreign: Foreign) -> None:
    trial = read_trial(foreign([*maker.trial(), maker.text(PHASE, 99, 'lunch')]))
    assert len(trial.phases) == 2
    assert '1 texts are no phase' in only_warning(trial)


@pytest.mark.parametrize(
    ('content', 'sentence'),
    [
        (b'', 'is empty'),
        (b'time_s,force_N\n', 'is not an MCAP file'),
        (MAGIC[:5], 'is not an MCAP file'),
        (b'SQLite format 3\x00' + bytes(80), 'SQLite'),
        (b'#ROSBAG V2.0\n' + bytes(80), 'ROS 1'),
        (b'\x28\xb5\x2f\xfd' + bytes(80), 'zstd -d'),
        (MAGIC, 'has no messages'),
    ],
)
def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, content: bytes, sentence: str) -> None:
    path = tmp_path / 'trial.mcap'
    path.write_bytes(content)
    with pytest.raises(InputError, match=sentence) as refusal:
        read_trial(path)
    assert str(path) in str(refusal.value) and '\n' not in str(refusal.value)


FORMATS = [
    {'compression': CompressionType.NONE},
    {'compression': CompressionType.ZSTD},
    {'compression': CompressionType.LZ4},
    {'chunked': False},
]


@pytest.mark.parametrize('options', FORMATS, ids=['none', 'zstd', 'lz4', 'unchunked'])
def test_a_bag_cut_anywhere_gives_what_lies_before_the_cut(
    maker, foreign: Foreign, options: dict
) -> None:
    path = foreign(maker.trial(60), chunk_size=2000, **options)
    whole = read_trial(path)
    size = path.stat().st_size
    edges = {*range(40), *range(size - 60, size)}
    most = -1
    for end in sorted({*edges, *range(40, size, size // 150)}, reverse=True):
        with path.open('r+b') as file:
            file.truncate(end)
        try:
            trial = read_trial(path)
        except InputError as error:
            assert '\n' not in str(error)
            continue
        most = max(most, len(trial.force))
        assert any('breaks off' in w or 'is cut within its index' in w for w in trial.warnings)
        for name in ('force', 'tool_height'):
            found, full = getattr(trial, name), getattr(whole, name)
            np.testing.assert_array_equal(found.t, full.t[: len(found)])
            np.testing.assert_array_equal(found.value, full.value[: len(found)])
        assert sum(1 for _ in trial.clouds or ()) <= 2
    assert most == 60


@pytest.mark.parametrize('options', FORMATS, ids=['none', 'zstd', 'lz4', 'unchunked'])
def test_a_cut_in_the_middle_loses_at_most_one_chunk(
    maker, foreign: Foreign, options: dict
) -> None:
    path = foreign(maker.trial(400), chunk_size=2000, **options)
    with path.open('r+b') as file:
        file.truncate(path.stat().st_size * 2 // 5)
    trial = read_trial(path)
    # The index of 50 to 200 bytes a chunk and the summary lie behind the cut.
    assert len(trial.force) > 100
    assert sum(1 for _ in trial.clouds) == 2


@pytest.mark.parametrize('options', FORMATS, ids=['none', 'zstd', 'lz4', 'unchunked'])
def test_a_chunk_that_is_cut_is_read_up_to_the_cut(maker, foreign: Foreign, options: dict) -> None:
    rng = np.random.default_rng(4)
    samples = [maker.number(TOOL_HEIGHT, 0, 0.05)]
    samples += [maker.wrench(k, value) for k, value in enumerate(rng.normal(size=4000))]
    path = foreign(samples, chunk_size=10**7, **options)
    with path.open('r+b') as file:
        # The message index behind the only chunk takes 16 bytes a message.
        file.truncate((path.stat().st_size - 16 * 4001) // 2)
    trial = read_trial(path)
    # A compressed chunk gives whole blocks of up to 128 KiB: about 1200 messages.
    assert 600 < len(trial.force) < 2500
    assert any('breaks off' in warning for warning in trial.warnings)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data(), options=st.sampled_from(FORMATS))
def test_a_bag_with_flipped_bytes_never_breaks_the_reader(
    maker, tmp_path: Path, data: st.DataObject, options: dict
) -> None:
    path = maker.write(tmp_path / 'flipped.mcap', maker.trial(20), chunk_size=1000, **options)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        trial = read_trial(path)
        for frame in trial.clouds or ():
            assert frame.xyz.shape[-1] == 3
    except InputError as error:
        assert '\n' not in str(error)


def test_a_damaged_chunk_costs_its_own_messages_only(maker, foreign: Foreign) -> None:
    path = foreign(maker.trial(200), compression=CompressionType.NONE, chunk_size=4000)
    content = path.read_bytes()
    place = content.index(maker.wrench(150, -150.0).data)
    path.write_bytes(content[:place] + b'\xff' * 20 + content[place:][20:])
    trial = read_trial(path)
    assert 150 < len(trial.force) < 200
    assert any('1 of the chunks of' in w and 'checksum' in w for w in trial.warnings)
    assert any('gap' in warning for warning in trial.warnings)


def bag_directory(maker, tmp_path: Path, parts: int = 1) -> Path:
    """Write a rosbag2 directory without metadata, split into parts."""
    samples = maker.trial()
    cut = len(samples) // parts
    for part in range(parts):
        start, stop = part * cut, None if part == parts - 1 else (part + 1) * cut
        maker.write(tmp_path / 'bag' / f'bag_{part}.mcap', samples[start:stop])
    return tmp_path / 'bag'


def describe(bag: Path, files: list[str], count: int) -> None:
    """Write the part of ``metadata.yaml`` that a reader looks at."""
    listed = '\n'.join(f'    - {name}' for name in files)
    (bag / 'metadata.yaml').write_text(
        f'rosbag2_bagfile_information:\n  version: 5\n  message_count: {count}\n'
        f'  relative_file_paths:\n{listed}\n'
    )


def test_a_directory_needs_no_metadata(maker, tmp_path: Path) -> None:
    trial = read_trial(bag_directory(maker, tmp_path))
    assert trial.name == 'bag' and trial.warnings == () and len(trial.force) == 100


@pytest.mark.parametrize('described', [True, False])
def test_the_parts_of_a_split_bag_are_one_trial(maker, tmp_path: Path, described: bool) -> None:
    bag = bag_directory(maker, tmp_path, parts=3)
    if described:
        describe(bag, ['bag_0.mcap', 'bag_1.mcap', 'bag_2.mcap'], len(maker.trial()))
    trial = read_trial(bag)
    assert trial.warnings == ()
    np.testing.assert_array_equal(trial.force.value, np.arange(100.0))
    assert len(list(trial.clouds)) == 2


def test_several_bags_in_a_directory_are_not_mixed(maker, tmp_path: Path) -> None:
    bag = bag_directory(maker, tmp_path)
    shutil.copy(bag / 'bag_0.mcap', bag / 'other.mcap')
    with pytest.raises(InputError, match='and no metadata'):
        read_trial(bag)


def test_metadata_that_lies_is_told(maker, tmp_path: Path) -> None:
    bag = bag_directory(maker, tmp_path, parts=2)
    total = len(maker.trial())
    describe(bag, ['bag/bag_0.mcap', 'bag_1.mcap'], total + 7)
    promise = f'metadata.yaml promises {total + 7} messages, {total} were found'
    assert only_warning(read_trial(bag)) == promise
    describe(bag, ['bag_0.mcap', 'bag_1.mcap', 'bag_2.mcap'], total)
    assert 'files that are not there: bag_2.mcap' in only_warning(read_trial(bag))
    describe(bag, ['bag_0.mcap'], total // 2)
    assert 'does not list were left out: bag_1.mcap' in only_warning(read_trial(bag))
    describe(bag, ['elsewhere.mcap'], total)
    assert 'files that are not there: elsewhere.mcap' in only_warning(read_trial(bag))
    assert len(read_trial(bag).force) == 100


@pytest.mark.parametrize(
    'text', ['', '[]', 'a: [', 'rosbag2_bagfile_information: 3', '\x00', '- \xe9']
)
def test_metadata_that_is_no_metadata_is_told(maker, tmp_path: Path, text: str) -> None:
    bag = bag_directory(maker, tmp_path)
    (bag / 'metadata.yaml').write_bytes(text.encode('latin-1'))
    trial = read_trial(bag)
    assert 'metadata.yaml cannot be understood' in only_warning(trial)
    assert len(trial.force) == 100


def test_one_unreadable_part_does_not_cost_the_others(maker, tmp_path: Path) -> None:
    bag = bag_directory(maker, tmp_path, parts=2)
    (bag / 'bag_1.mcap').write_bytes(b'')
    trial = read_trial(bag)
    assert len(trial.force) > 40
    assert any('bag_1.mcap is empty' in warning for warning in trial.warnings)


@pytest.mark.parametrize(
    ('names', 'sentence'),
    [
        ([], 'holds no .mcap file'),
        (['bag_0.db3', 'metadata.yaml'], 'SQLite'),
        (['bag_0.mcap.zstd'], 'zstd -d'),
        (['one/one_0.mcap'], 'name one of these'),
    ],
)
def test_a_directory_without_mcap_is_refused(
    tmp_path: Path, names: list[str], sentence: str
) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b'')
    with pytest.raises(InputError, match=sentence):
        read_trial(tmp_path)


def test_a_bag_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='does not exist'):
        read_trial(tmp_path / 'none.mcap')


def test_a_pipe_is_refused_before_anything_waits_for_its_other_end(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe.mcap')
    with pytest.raises(InputError, match=r'pipe\.mcap is a pipe or a device'):
        read_trial(tmp_path / 'pipe.mcap')


def test_a_damaged_name_does_not_break_the_sentence() -> None:
    assert str(InputError('the topic /a\nb is unknown')) == 'the topic /a\\nb is unknown'


def test_a_trial_without_a_touch_tells_no_height_of_one() -> None:
    """What its clouds show is read all the same."""
    few = Signal(np.arange(4.0), np.zeros(4))
    assert _touched(few, few) is None

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


"""Clouds of any layout come out as the points that went in."""

from collections.abc import Callable
from pathlib import Path

from hapticvision_ros.bag import cdr
from hapticvision_ros.bag.clouds import read_layout, view_points
from hapticvision_ros.bag.contract import TOOL_HEIGHT
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.errors import InputError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
import numpy as np
import pytest

F4, F8, U1 = 7, 8, 2
PLAIN = [('x', 0, F4), ('y', 4, F4), ('z', 8, F4)]


@st.composite
def layouts(draw: st.DrawFn) -> dict[str, object]:
    """Return sizes, fields and byte order of a cloud that a sensor may send."""
    height, width = draw(st.integers(1, 4)), draw(st.integers(0, 5))
    names = draw(st.permutations(['x', 'y', 'z', 'intensity', 'ring']))
    offset, fields = draw(st.integers(0, 4)), []
    for name in names:
        datatype = U1 if name == 'ring' else draw(st.sampled_from([F4, F4, F4, F8]))
        fields.append((name, offset, datatype))
        offset += {F4: 4, F8: 8, U1: 1}[datatype] + draw(st.integers(0, 3))
    point_step = offset + draw(st.integers(0, 5))
    return {
        'fields': fields,
        'height': height,
        'width': width,
        'point_step': point_step,
        'row_step': width * point_step + draw(st.sampled_from([0, 0, 3, 16])),
        'big_endian': draw(st.booleans()),
    }


def fill(layout: dict, xyz: np.ndarray) -> bytes:
    """Return the bytes of a cloud of float32 points, shape (height, width, 3)."""
    data = bytearray(b'\xee' * (layout['row_step'] * layout['height']))
    order = '>' if layout['big_endian'] else '<'
    for name, offset, datatype in layout['fields']:
        if name not in 'xyz':
            continue
        for row, column in np.ndindex(layout['height'], layout['width']):
            start = row * layout['row_step'] + column * layout['point_step'] + offset
            number = np.array(xyz[row, column, 'xyz'.index(name)], order + 'f4')
            raw = number.astype(order + 'f8' if datatype == F8 else order + 'f4').tobytes()
            stop = start + len(raw)
            data[start:stop] = raw
    return bytes(data)


@settings(deadline=None, max_examples=150)
@given(layout=layouts(), seed=st.integers(0, 2**32 - 1))
def test_any_layout_gives_the_points_that_went_in(maker, layout: dict, seed: int) -> None:
    shape = (layout['height'], layout['width'], 3)
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=shape).astype(np.float32)
    xyz[rng.random(shape) < 0.2] = np.nan
    message = memoryview(maker.cloud(0, **layout, data=fill(layout, xyz)).data)
    points = view_points(message, read_layout(message))
    assert points.dtype == np.float32
    expected = xyz.reshape(-1, 3) if shape[0] == 1 or shape[1] == 0 else xyz
    np.testing.assert_array_equal(points, expected)


@settings(deadline=None, max_examples=60)
@given(
    data=st.data(),
    cloud=st.just(cdr.encode_cloud(0, 'support_plane', np.ones((2, 3, 3), np.float32))),
)
def test_a_damaged_cloud_is_refused_or_read_but_never_breaks(data, cloud: bytes) -> None:
    damaged = bytearray(cloud)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(cloud) - 1))] = data.draw(st.integers(0, 255))
    message = memoryview(bytes(damaged[: data.draw(st.integers(0, len(cloud)))]))
    try:
        layout = read_layout(message)
    except ValueError:
        return
    assert view_points(message, layout).shape[-1] == 3


def test_the_points_are_a_view_on_the_message() -> None:
    message = cdr.encode_cloud(0, 'support_plane', np.ones((4, 5, 3), np.float32))
    points = view_points(memoryview(message), read_layout(memoryview(message)))
    assert np.shares_memory(points, np.frombuffer(message, np.uint8))
    assert not points.flags.writeable


def test_a_wide_point_is_viewed_with_its_step(maker) -> None:
    layout = {
        'fields': [('intensity', 0, F4), ('z', 4, F4), ('y', 8, F4), ('x', 12, F4)],
        'height': 2,
        'width': 3,
        'point_step': 32,
        'row_step': 100,
        'big_endian': False,
    }
    xyz = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    message = memoryview(maker.cloud(0, **layout, data=fill(layout, xyz)).data)
    points = view_points(message, read_layout(message))
    assert points.strides == (100, 32, -4)
    np.testing.assert_array_equal(points, xyz)


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'fields': [('x', 0, F4), ('y', 4, F4)]}, 'no field z'),
        ({'fields': [('x', 0, F4), ('y', 4, F4), ('z', 8, 5)]}, 'field z is not a floating'),
        ({'fields': [('x', 0, F4), ('y', 4, F4), ('z', 10, F4)]}, 'field z lies outside'),
        ({'width': 11}, 'fewer bytes'),
        ({'height': 2, 'row_step': 200}, 'fewer bytes'),
        ({'height': 2, 'width': 5, 'row_step': 90}, 'fewer bytes'),
    ],
)
def test_a_cloud_that_cannot_be_used_is_left_out_with_its_reason(
    maker, foreign: Callable[..., Path], change: dict, reason: str
) -> None:
    layout = {
        'fields': PLAIN,
        'height': 1,
        'width': 10,
        'point_step': 12,
        'row_step': 120,
        'data': bytes(120),
    }
    bad = maker.cloud(30, **(layout | change))
    samples = sorted([*maker.trial(), bad], key=lambda sample: sample.publish_ns)
    trial = read_trial(foreign(samples), displacement_from_points=False)
    assert len(trial.clouds) == 2
    (warning,) = trial.warnings
    assert '1 of 3 messages cannot be used' in warning and reason in warning


def test_a_missing_row_step_follows_from_the_rest(maker) -> None:
    xyz = np.arange(24, dtype=np.float32)
    message = memoryview(
        maker.cloud(
            0, fields=PLAIN, height=2, width=4, point_step=12, row_step=0, data=xyz.tobytes()
        ).data
    )
    points = view_points(message, read_layout(message))
    np.testing.assert_array_equal(points, xyz.reshape(2, 4, 3))


def test_double_clouds_are_converted_with_a_warning(maker, foreign: Callable[..., Path]) -> None:
    layout = {
        'fields': [('x', 0, F8), ('y', 8, F8), ('z', 16, F8)],
        'height': 1,
        'width': 2,
        'point_step': 24,
        'row_step': 48,
        'big_endian': False,
    }
    xyz = np.array([[[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]]], np.float32)
    sample = maker.cloud(30, **layout, data=fill(layout, xyz))
    trial = read_trial(foreign([*maker.trial(), sample]))
    assert any('1 of 3 clouds are converted to float32' in w for w in trial.warnings)
    frames = list(trial.clouds)
    np.testing.assert_array_equal(frames[1].xyz, xyz[0])


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('chunked', [True, False])
def test_clouds_come_in_order_of_time_from_any_file(
    maker, foreign: Callable[..., Path], compression: CompressionType, chunked: bool
) -> None:
    samples = [maker.wrench(0, 0.0), maker.number(TOOL_HEIGHT, 0, 0.0)]
    samples += [maker.flat_cloud(ms, np.full((9, 3), ms, np.float32)) for ms in (5, 1, 9, 3)]
    path = foreign(samples, compression=compression, chunked=chunked, chunk_size=200)
    trial = read_trial(path)
    for _ in range(2):
        frames = list(trial.clouds)
        assert [frame.t for frame in frames] == pytest.approx([0.001, 0.003, 0.005, 0.009])
        assert [frame.xyz[0, 0] for frame in frames] == [1, 3, 5, 9]
        assert {frame.frame_id for frame in frames} == {'support_plane'}
    assert len(trial.clouds) == 4


def test_a_bag_that_changes_while_it_is_read_is_told(maker, foreign: Callable[..., Path]) -> None:
    path = foreign(maker.trial())
    trial = read_trial(path)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match='has changed since it was opened'):
        list(trial.clouds)
    path.unlink()
    with pytest.raises(InputError, match=str(path)):
        list(trial.clouds)

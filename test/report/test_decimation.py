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


from hapticvision_ros.report.decimation import envelope, line
import numpy as np


def test_a_glitch_of_one_sample_survives_decimation() -> None:
    t = np.arange(130_000) / 1000.0
    value = np.sin(t)
    value[77_777] = 25.0
    value[100_003] = -9.0
    kept_t, kept = envelope(t, value, 500)
    assert kept_t.size <= 1002
    assert (t[77_777], 25.0) in zip(kept_t, kept, strict=True)
    assert (t[100_003], -9.0) in zip(kept_t, kept, strict=True)


def test_decimation_keeps_samples_in_order_with_the_ends() -> None:
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.5, 1.5, 10_007))
    value = rng.normal(size=t.size)
    kept_t, kept = envelope(t, value, 300)
    assert (np.diff(kept_t) > 0.0).all()
    assert kept_t[0] == t[0] and kept_t[-1] == t[-1]
    np.testing.assert_array_equal(kept, value[np.searchsorted(t, kept_t)])


def test_every_stretch_keeps_its_extremes() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(10_000.0)
    value = rng.normal(size=t.size)
    kept_t, kept = envelope(t, value, 100)
    for start in range(0, 10_000, 100):
        inside = (kept_t >= start) & (kept_t < start + 100)
        part = value[range(start, start + 100)]
        assert kept[inside].max() == part.max() and kept[inside].min() == part.min()


def test_a_line_does_not_bridge_a_gap_of_the_record() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.01), np.arange(20.0, 30.0, 0.01)])
    kept_t, kept = line(t, np.ones(t.size), 200)
    broken = np.flatnonzero(np.isnan(kept))
    assert broken.size == 1
    assert kept_t[broken[0] - 1] < 10.0 and kept_t[broken[0] + 1] == 20.0


def test_a_line_is_whole_where_sampling_grows_ever_sparser() -> None:
    # A recorder on a logarithmic schedule has no gap, however long its last steps are.
    t = np.geomspace(0.01, 1000.0, 100)
    assert np.isfinite(line(t, t, 50)[1]).all()


def test_samples_that_are_not_finite_are_no_points() -> None:
    kept_t, kept = line(np.arange(4.0), np.array([np.nan, 1.0, 2.0, np.inf]), 10)
    np.testing.assert_array_equal(kept_t, [1.0, 2.0])
    np.testing.assert_array_equal(kept, [1.0, 2.0])

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

"""The lattice: nodes, links, surface, and bodies from maps and clouds."""

from hapticvision_ros.core.body.lattice import box, from_cloud, from_heights
from hapticvision_ros.core.errors import InputError
import numpy as np
import pytest

SIZE = (0.085, 0.060, 0.040)


def test_a_box_has_the_nodes_and_links_of_its_cells() -> None:
    body = box(SIZE, 0.005)
    assert len(body.points) == 18 * 13 * 9
    # Counted by another program for the same block.
    assert np.count_nonzero(body.weights_of_links) == 22_997
    np.testing.assert_allclose(body.points.min(axis=0), [-0.0425, -0.03, 0.0], atol=1e-12)
    np.testing.assert_allclose(body.points.max(axis=0), [0.0425, 0.03, 0.04], atol=1e-12)


def test_links_within_the_body_weigh_as_an_isotropic_solid_asks() -> None:
    weights = box((0.04, 0.04, 0.04), 0.01).weights_of_links
    assert weights[:3].max() == 1.0
    assert weights[3:9].max() == 0.5
    assert weights[9:].max() == 3.0 / 16.0


def test_the_surface_is_closed_and_looks_outward() -> None:
    body = box((0.08, 0.06, 0.04), 0.01)
    nodes, triangles = body.surface
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forth = {tuple(edge) for edge in edges.tolist()}
    assert len(forth) == len(edges)
    assert {(b, a) for a, b in forth} == forth
    a, b, c = (body.points[nodes][triangles[:, i]] for i in range(3))
    assert np.einsum('ij,ij->', a, np.cross(b, c)) / 6.0 == pytest.approx(0.08 * 0.06 * 0.04)
    assert body.volume(body.points) == pytest.approx(0.08 * 0.06 * 0.04)


def test_points_go_with_their_cell() -> None:
    body = box(SIZE, 0.01)
    points = np.random.default_rng(0).uniform([-0.05, -0.03, 0.0], [0.05, 0.03, 0.05], (50, 3))
    nodes, weights = body.weights(points)
    turn = np.array([[1.0, 0.1, 0.0], [-0.1, 1.1, 0.2], [0.0, 0.3, 0.9]])
    moved = body.points @ turn
    carried = (weights[:, :, None] * moved[nodes]).sum(axis=1)
    np.testing.assert_allclose(carried, points @ turn, atol=1e-12)


def test_a_map_of_heights_gives_its_volume_and_its_own_surface() -> None:
    y, x = np.mgrid[:70, :90] + 0.5
    inside = ((x - 45) / 40) ** 2 + ((y - 35) / 30) ** 2 < 1.0
    heights = np.where(inside, 0.03 + 2e-4 * x, 0.0)
    body = from_heights((-0.045, -0.035), 0.001, heights, 0.005)
    # Half a cell of an outline of 0.22 m may be in or out: at random, a few percent in all.
    assert body.volume(body.points) == pytest.approx(heights.sum() * 1e-6, rel=0.04)
    top = body.points[body.points[:, 2] > 0.025]
    middle = top[np.hypot(top[:, 0], top[:, 1]) < 0.02]
    highest = {}
    for px, py, pz in middle:
        highest[px, py] = max(pz, highest.get((px, py), 0.0))
    for (px, _), pz in highest.items():
        assert pz == pytest.approx(0.03 + 0.2 * (px + 0.045), abs=2e-4)


def test_a_closed_cloud_gives_its_volume() -> None:
    points = np.random.default_rng(0).normal(size=(30_000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    points[:, 2] = np.abs(points[:, 2])
    body = from_cloud(points * [0.04, 0.03, 0.035], 0.005)
    assert body.volume(body.points) == pytest.approx(
        2.0 / 3.0 * np.pi * 0.04 * 0.03 * 0.035, rel=0.03
    )


@pytest.mark.parametrize(
    ('size', 'pitch', 'said'),
    [
        ((0.1, 0.1, 0.001), 0.005, 'thinner than a cell'),
        ((0.1, 0.1, 0.1), 0.0, 'above zero'),
        ((1.0, 1.0, 1.0), 0.001, 'more than'),
    ],
)
def test_a_body_that_makes_no_lattice_is_refused(
    size: tuple[float, ...], pitch: float, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        box(size, pitch)

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

"""Views with roughly known poses come together, and only where the surfaces say how."""

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.scene.registration import merge_views
from hapticvision_ros.core.scene.views import Pose, View
from hapticvision_ros.sim.shapes import block, Camera, lump, wedge
import numpy as np
import pytest

PLACES = np.array([[0.03, 0, 0.02], [-0.03, 0, 0.02], [0, 0.03, 0.04], [0, -0.03, 0.0]])


def disagreement(poses, truths):
    """Return how far apart the views put the same places, root mean square [m]."""
    errors = np.array(
        [
            pose.apply(true.inverse().apply(PLACES)) - PLACES
            for pose, true in zip(poses, truths, strict=True)
        ]
    )
    errors -= errors.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


@pytest.mark.parametrize(
    ('solid', 'bound'),
    [
        # Opposite walls of a block meet at its edges only, which are known to a part of a voxel
        # of 2 mm; a lump's bumps are seen from several sides.
        (block(0.09, 0.06, 0.045).at(0.01, -0.005, 0.4), 6e-4),
        (wedge(0.09, 0.06, 0.03, 0.05).at(0.0, 0.0, 1.0), 6e-4),
        (lump(1), 2.5e-4),
    ],
    ids=['block', 'wedge', 'lump'],
)
def test_views_agree_better_than_their_known_poses(look, pose_of, above, around, solid, bound):
    cameras = (*around, above)
    views = look([solid], cameras, shift=0.003, angle=0.01, seed=2)
    truths = [pose_of(camera) for camera in cameras]
    assert disagreement([view.pose for view in views], truths) > 2e-3
    merge = merge_views(views)
    assert disagreement(merge.poses, truths) < bound
    assert merge.distance_after < 0.3 * merge.distance_before
    assert min(merge.overlaps) > 0.5


def test_exact_poses_stay(look, pose_of, above, around):
    cameras = (*around[:2], above)
    merge = merge_views(look([block(0.08, 0.06, 0.04)], cameras))
    assert disagreement(merge.poses, [pose_of(camera) for camera in cameras]) < 4e-4
    # The view from above knows the block by its edges only, to half a voxel of 2 mm.
    assert max(merge.shifts) < 1e-3


def test_one_view_is_taken_as_it_is(look, above):
    (view,) = look([block(0.08, 0.06, 0.04)], [above])
    merge = merge_views([view])
    assert merge.poses == (view.pose,)
    finite = np.isfinite(view.xyz).all(axis=-1)
    assert merge.clouds[0] == pytest.approx(view.pose.apply(view.xyz[finite].astype(float)))


def test_a_view_of_another_place_is_refused(look, above):
    views = look([block(0.08, 0.06, 0.04)], [above])
    far = Pose(views[0].pose.rotation, views[0].pose.translation + np.array([3.0, 0.0, 0.0]))
    with pytest.raises(InputError, match='has only 0% in common with the others: check the pose'):
        merge_views([*views, View(views[0].xyz, far, 'elsewhere')])


def test_a_wrong_pose_is_refused_by_name(look, above, around):
    views = look([lump(1)], (*around, above))
    # Five times the error that the poses are taken to have.
    shift = np.array([0.0, 0.0, 0.015])
    wrong = Pose(views[2].pose.rotation, views[2].pose.translation + shift)
    views[2] = View(views[2].xyz, wrong, 'from the left')
    with pytest.raises(InputError, match='The view from the left fits the others only if it'):
        merge_views(views)


def test_a_blind_view_is_refused_by_name(look, above):
    views = look([block(0.08, 0.06, 0.04)], [above])
    blind = View(np.full((20, 20, 3), np.nan, dtype=np.float32), Pose.identity(), 'of the lens')
    with pytest.raises(InputError, match='The view of the lens has only 0 returns'):
        merge_views([*views, blind])


def test_it_does_not_matter_where_the_base_frame_is(look, turn, around):
    views = look([lump(2)], around[:2], shift=0.002, angle=0.005, seed=1)
    frame = Pose(turn((0.3, -0.5, 1.0)).rotation, np.array([1.0, 2.0, -0.5]))
    moved = [View(view.xyz, frame.after(view.pose), view.name) for view in views]
    expected, found = merge_views(views), merge_views(moved)
    for pose, other in zip(expected.poses, found.poses, strict=True):
        places = pose.inverse().apply(PLACES)
        # Voxels lie elsewhere in another frame: their choice is noise of some hundredths of a mm.
        assert other.apply(places) == pytest.approx(frame.apply(pose.apply(places)), abs=3e-4)


def test_unorganised_views_count_the_same(look, above):
    (view,) = look([block(0.08, 0.06, 0.04)], [above])
    flat = View(view.xyz.reshape(-1, 3), view.pose, view.name)
    assert np.array_equal(merge_views([flat]).clouds[0], merge_views([view]).clouds[0])


def test_views_that_are_levelled_already_come_together_too(look, above, around):
    views = []
    for view in look([lump(1)], (*around[:2], above), shift=0.003, angle=0.01, seed=2):
        # As drivers publish them that know their sensor's place, with an error.
        level = view.pose.apply(view.xyz.reshape(-1, 3).astype(float)).astype(np.float32)
        views.append(View(level.reshape(view.xyz.shape), Pose.identity(), view.name, True))
    merge = merge_views(views)
    assert merge.distance_after < 0.3 * merge.distance_before


def test_the_ray_caster_shows_the_table_where_it_is(look, pose_of):
    camera = Camera(0.7, 0.6)
    (view,) = look([], [camera], noise=0.0, dropout=0.0)
    seen = view.pose.apply(view.xyz[np.isfinite(view.xyz).all(axis=-1)].astype(float))
    assert seen[:, 2] == pytest.approx(0.0, abs=1e-6)

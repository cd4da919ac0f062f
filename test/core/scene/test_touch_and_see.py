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

"""From views to a plan, on solids whose truth is known."""

from dataclasses import replace

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import touch_and_see, TouchSettings
from hapticvision_ros.core.scene.registration import MergeSettings
from hapticvision_ros.core.scene.stability import PushSettings
from hapticvision_ros.core.scene.views import Picture, Pose, View
from hapticvision_ros.sim.shapes import block, hemisphere, lump, mound, take, truth_of, wedge
import numpy as np
import pytest

CELL = 0.002
SOLIDS = {
    'block': block(0.09, 0.06, 0.045).at(0.01, -0.005, 0.4),
    'wedge': wedge(0.09, 0.06, 0.03, 0.045).at(-0.005, 0.01, 1.0),
    'hemisphere': hemisphere(0.04).at(0.004, 0.01),
    'lump 1': lump(1).at(0.01, 0.0, 1.0),
    'lump 2': lump(2),
}


@pytest.fixture(scope='module', params=SOLIDS)
def solid(request):
    return SOLIDS[request.param]


@pytest.fixture(scope='module')
def truths():
    return {}


def truth(solid, truths):
    if id(solid) not in truths:
        truths[id(solid)] = truth_of(solid, 4e-4)
    return truths[id(solid)]


def checked(plan, true, outline):
    """Hold a plan against the truth; `outline` is how far the outline may be off [m]."""
    centre = np.array(plan.contact.contact_point[:2])
    perimeter = 2.0 * np.sqrt(np.pi * true.top_view_area) * 1.15
    # Round bodies end below the clearance of 4 mm, a little inside their outline.
    area = outline * perimeter / true.top_view_area
    assert centre == pytest.approx(true.top_view_centre, abs=5e-4)
    # On a slope of 0.3 what G_top is off goes into the height, too.
    assert plan.contact.contact_point[2] == pytest.approx(true.contact_height, abs=4e-4)
    assert plan.contact.push_direction == pytest.approx((0.0, 0.0, -1.0), abs=2e-3)
    assert plan.contact.object_area == pytest.approx(true.top_view_area, rel=area)
    assert plan.volume == pytest.approx(true.volume, rel=area)
    assert plan.centre_of_gravity == pytest.approx(true.centre_of_gravity, abs=6e-4)


def test_several_views_make_one_object(solid, truths, look, above, around):
    plan = touch_and_see(look([solid], (*around, above)))
    checked(plan, truth(solid, truths), outline=0.5 * CELL)
    assert plan.outline_seen > 0.9
    assert plan.stability.base_seen
    assert plan.warnings == ()
    # V_O: across L, above the horizon, towards P_c.
    ahead = plan.viewpoint.pose.rotation[:, 2]
    angle = plan.symmetry.angle
    assert ahead @ (np.cos(angle), np.sin(angle), 0.0) == pytest.approx(0.0, abs=5e-3)
    assert np.deg2rad(30.0) <= plan.viewpoint.elevation <= np.deg2rad(45.0)


def test_one_view_from_above_knows_the_top_view(solid, truths, look, above):
    plan = touch_and_see(look([solid], [above]))
    checked(plan, truth(solid, truths), outline=CELL)


def test_rough_poses_cost_less_than_they_are_off(truths, look, above, around):
    solid = SOLIDS['lump 2']
    views = look([solid], (*around, above), shift=0.003, angle=0.01, seed=4)
    true = truth(solid, truths)
    plan = touch_and_see(views)
    # What all views have in common stays: the mean of five errors of 3 mm.
    assert plan.contact.contact_point[:2] == pytest.approx(true.top_view_centre, abs=0.003)
    assert plan.volume == pytest.approx(true.volume, rel=0.05)
    raw = MergeSettings(translation_error=1e-6, rotation_error=1e-6, least_overlap=0.0)
    unrefined = touch_and_see(views, settings=TouchSettings(merge=raw))
    assert abs(unrefined.volume - true.volume) > 2.0 * abs(plan.volume - true.volume)


@pytest.mark.parametrize(
    ('noise', 'dropout', 'bound'),
    # With holes a return stands for 1.9 mm of the surface, about a cell: half of that is open.
    [(0.0, 0.0, 8e-4), (1e-3, 0.02, 8e-4), (5e-4, 0.6, 0.5 * CELL)],
    ids=['none', 'noise', 'holes'],
)
def test_noise_and_dropouts_move_the_contact_point_little(
    truths, look, above, around, noise, dropout, bound
):
    solid = SOLIDS['lump 1']
    plan = touch_and_see(look([solid], (*around[:2], above), noise=noise, dropout=dropout))
    true = truth(solid, truths)
    assert plan.contact.contact_point[:2] == pytest.approx(true.top_view_centre, abs=bound)
    assert plan.volume == pytest.approx(true.volume, rel=0.06)


def test_a_partial_view_says_so(truths, look, around):
    solid = SOLIDS['hemisphere']
    settings = TouchSettings(push=PushSettings(tool_friction=0.6))
    plan = touch_and_see(look([solid], around[:1]), settings=settings)
    assert plan.outline_seen < 0.7
    assert any('support plane was not seen' in text for text in plan.warnings)
    assert any('The base of the object was not seen' in text for text in plan.warnings)
    # And rightly: a far side of 40 mm hidden behind its own height.
    assert plan.volume < 0.9 * truth(solid, truths).volume


def test_turned_and_moved_the_plan_goes_along(look, turn, above):
    solid = SOLIDS['wedge']
    views = look([solid], [above])
    expected = touch_and_see(views)
    frame = Pose(turn((0.4, -0.3, 0.8)).rotation, np.array([0.5, 0.3, 0.7]))
    moved = touch_and_see([View(views[0].xyz, frame.after(views[0].pose), 'moved')])
    goal = frame.apply(np.array([expected.contact.contact_point]))[0]
    # Cells lie elsewhere: a part of one of 2 mm.
    assert moved.contact.contact_point == pytest.approx(goal, abs=5e-4)
    assert moved.contact.push_direction == pytest.approx(
        frame.rotation @ expected.contact.push_direction, abs=2e-3
    )
    assert moved.volume == pytest.approx(expected.volume, rel=0.02)
    assert moved.viewpoint.pose.translation == pytest.approx(
        frame.apply(expected.viewpoint.pose.translation[None])[0], abs=0.02
    )
    gravity = frame.apply(np.array([expected.centre_of_gravity]))[0]
    assert moved.centre_of_gravity == pytest.approx(gravity, abs=5e-4)


def test_nothing_there_is_refused(look, above, around):
    with pytest.raises(InputError, match='Nothing larger than 4 cm'):
        touch_and_see(look([], (*around[:1], above)))


def test_of_two_objects_the_one_that_is_asked_for(look, above):
    near, far = block(0.05, 0.04, 0.03).at(-0.04, 0.0), block(0.05, 0.04, 0.03).at(0.04, 0.0)
    views = look([near, far], [above])
    with pytest.raises(InputError, match='There are 2 objects on the support plane'):
        touch_and_see(views)
    for x in (-0.04, 0.04):
        plan = touch_and_see(views, nearest_to=(x, 0.01, 0.0))
        assert plan.contact.contact_point[:2] == pytest.approx((x, 0.0), abs=5e-4)


def test_the_tool_is_no_object(look, above):
    tool = mound([(0.0, 0.08, 0.12, 0.0126, 0.0126, 0.03)])
    views = look([SOLIDS['block'], tool], [above])
    with pytest.raises(InputError, match='There are 2 objects'):
        touch_and_see(views)
    plan = touch_and_see(views, ceiling=0.09)
    assert plan.contact.contact_point[:2] == pytest.approx((0.01, -0.005), abs=1e-3)


def test_a_cut_off_object_is_refused_unless_another_view_has_it_whole(look, above):
    large = block(0.2, 0.06, 0.04).at(0.09, 0.0)
    views = look([large], [above], table=0.6)
    with pytest.raises(InputError, match='reaches the border'):
        touch_and_see(views)
    (whole,) = look([large], [replace(above, distance=0.9)], table=0.6)
    plan = touch_and_see([*views, whole])
    assert plan.contact.contact_point[:2] == pytest.approx((0.09, 0.0), abs=0.5 * CELL)


def test_a_push_that_slips_or_slides_is_refused(look, above):
    steep = wedge(0.06, 0.06, 0.01, 0.06)
    with pytest.raises(InputError, match='The tool would slip'):
        touch_and_see(look([steep], [above]))
    rough = TouchSettings(push=PushSettings(tool_friction=1.0, base_margin=0.0))
    with pytest.raises(InputError, match='The push would slide the object'):
        touch_and_see(look([steep], [above]), settings=rough)


def test_a_push_beyond_a_narrow_foot_is_refused(look, above, around):
    # A mushroom stands on a foot of 8 mm under the edge of its cap.
    mushroom = mound([(0.0, 0.0, 0.0, 0.009, 0.009, 0.06), (0.02, 0.0, 0.05, 0.035, 0.03, 0.01)])
    with pytest.raises(InputError, match='The push would tip the object'):
        touch_and_see(
            look([mushroom], [*(replace(item, elevation=0.2) for item in around), above])
        )


def picture_of(camera, solid, pose_of):
    return Picture(take(camera, [solid], seed=5).image, camera.matrix, pose_of(camera))


def test_a_picture_gives_back_an_edge_that_the_cloud_lost(truths, look, pose_of, above):
    solid = SOLIDS['block']
    (view,) = look([solid], [above])
    world = view.pose.apply(view.xyz.reshape(-1, 3).astype(float)).reshape(view.xyz.shape)
    own = (world[..., 0] - 0.01) * np.cos(0.4) + (world[..., 1] + 0.005) * np.sin(0.4)
    dark = view.xyz.copy()
    dark[(own > 0.045 - 0.005) & (world[..., 2] > 0.004)] = np.nan
    views = [View(dark, view.pose, view.name)]
    true = truth(solid, truths)

    def off(plan):
        return np.hypot(*(np.array(plan.contact.contact_point[:2]) - true.top_view_centre))

    without = touch_and_see(views)
    # Half of the strip of 5 mm.
    assert off(without) == pytest.approx(0.0025, abs=5e-4)
    picture = picture_of(above, solid, pose_of)
    assert off(touch_and_see(views, [picture])) < 1e-3
    # A whole cloud loses nothing by it.
    assert off(touch_and_see([view], [picture])) < 7e-4


def test_a_picture_of_something_else_is_not_used(look, pose_of, above):
    views = look([SOLIDS['block']], [above])
    other = picture_of(above, SOLIDS['block'].at(-0.05, 0.05), pose_of)
    plan, expected = touch_and_see(views, [other]), touch_and_see(views)
    assert plan.contact.contact_point == expected.contact.contact_point
    assert any(text.startswith('Picture 1 was not used') for text in plan.warnings)

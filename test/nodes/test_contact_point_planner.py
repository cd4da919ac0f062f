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

"""The contact-point planner as a process, on clouds that the test sends."""

from dataclasses import replace
import re
import time

from hapticvision_ros.bag.contract import (
    ADD_VIEW,
    CLEAR_VIEWS,
    CONTACT_POINT,
    OBJECT,
    OBJECT_POSE,
    PLAN,
    POINTS,
    PUSH_DIRECTION,
    SENSOR_POSE,
    SHAPE,
    TOOL_HEIGHT,
    VIEWPOINT,
)
from hapticvision_ros.core.devices import RangeFrame
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.scene.views import Pose
from hapticvision_ros.nodes.contact_point_planner import known_poses
from hapticvision_ros.nodes.conversions import (
    cloud_to_message,
    picture_from_messages,
    point_from_message,
    pose_to_message,
    scalar_to_message,
    values_from_status,
    vector_from_message,
)
from hapticvision_ros.sim.shapes import block, Camera, take
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

TOP = 0.04
DEADLINE = 60.0
"""For three clouds, of which many may be lost on a loaded machine [s]."""


def top_view(*blocks, seed=0):
    """Return a cloud seen from above: the plane z = 0 and blocks (x, y, length, width)."""
    x, y = np.meshgrid(np.linspace(-0.15, 0.15, 300), np.linspace(-0.1, 0.1, 200))
    z = np.zeros_like(x)
    for cx, cy, length, width in blocks:
        z[(np.abs(x - cx) < length / 2) & (np.abs(y - cy) < width / 2)] = TOP
    z += np.random.default_rng(seed).normal(0.0, 3e-4, z.shape)
    cloud = np.stack((x, y, z), axis=-1).astype(np.float32)
    cloud[::17, ::13] = np.nan
    return cloud


@pytest.fixture
def planner(start_node):
    # Clouds of this size lose their way on a loaded machine; three of them must get through.
    return start_node('contact_point_planner', {'cloud_timeout': 20.0})


@pytest.fixture
def show(probe):
    """Send one cloud again and again, as a range sensor would, and the height of the tool."""
    timers = []

    def show(cloud, frame_id=POINTS.frame_id, tool_height=2.0 * TOP):
        publisher, arm = probe.publisher(POINTS), probe.publisher(TOOL_HEIGHT)

        def send():
            stamp = probe.node.get_clock().now().nanoseconds
            if tool_height is not None:
                arm.publish(scalar_to_message(tool_height))
            publisher.publish(cloud_to_message(RangeFrame(stamp, cloud), frame_id))

        timers.append(probe.node.create_timer(0.05, send))

    yield show
    for timer in timers:
        probe.node.destroy_timer(timer)


def test_the_contact_point_lies_on_top_of_the_mass_centre(planner, probe, show, until):
    show(top_view((0.004, -0.003, 0.08, 0.05)))
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert answer.success, answer.message
    # Asked for after the plan was made: the topics are latched.
    points, directions = probe.listen(CONTACT_POINT), probe.listen(PUSH_DIRECTION)
    until(lambda: points and directions, 'the latched plan')
    x, y, z = point_from_message(points[0])
    # Half a cell of the top-view grid is 1 mm; the height is a median of some 70 points.
    assert (x, y) == pytest.approx((0.004, -0.003), abs=1e-3)
    assert z == pytest.approx(TOP, abs=2e-4)
    assert points[0].header.frame_id == 'support_plane'
    assert vector_from_message(directions[0]) == pytest.approx((0.0, 0.0, -1.0), abs=0.002)


def numbers_of(camera):
    """Return where a camera is, as the parameter takes it."""
    pose = Pose(camera.rotation, camera.translation)
    return [*(float(item) for item in pose.translation), *pose.quaternion]


def test_views_of_several_sensors_make_one_plan(start_node, probe, until):
    solid = block(0.07, 0.05, 0.04).at(0.003, -0.002, 0.3)
    left, right = (Camera(azimuth, 0.7, width=160, height=120) for azimuth in (0.5, 0.5 + np.pi))
    above = Camera(0.5, 1.5, width=160, height=120)
    start_node(
        'contact_point_planner',
        {
            'cloud_timeout': 20.0,
            'clouds': 2,
            'sensor_frames': 'left right',
            'sensor_poses': [*numbers_of(left), *numbers_of(right)],
        },
    )
    points, arm = probe.publisher(POINTS), probe.publisher(TOOL_HEIGHT)
    wrist = probe.publisher(SENSOR_POSE)

    def show(frame, camera):
        cloud = take(camera, [solid]).xyz

        def send():
            stamp = probe.node.get_clock().now().nanoseconds
            arm.publish(scalar_to_message(0.12))
            pose = Pose(above.rotation, above.translation)
            wrist.publish(pose_to_message(pose, stamp, SENSOR_POSE.frame_id))
            points.publish(cloud_to_message(RangeFrame(stamp, cloud), frame))

        return probe.node.create_timer(0.05, send)

    views = (('left', left), ('right', right), ('wrist', above))
    for number, (frame, camera) in enumerate(views, 1):
        timer = show(frame, camera)
        answer = probe.call(ADD_VIEW, Trigger.Request(), DEADLINE)
        probe.node.destroy_timer(timer)
        assert answer.success, answer.message
        assert answer.message.endswith(f'the next plan has {number} views.')
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert answer.success, answer.message
    assert 'from 3 views' in answer.message
    heard = [probe.listen(item) for item in (CONTACT_POINT, VIEWPOINT, OBJECT_POSE, OBJECT, SHAPE)]
    until(lambda: all(heard), 'the latched plan')
    contact, viewpoint, pose, found, shape = (item[0] for item in heard)
    # Half a cell of the top-view grid.
    assert point_from_message(contact) == pytest.approx((0.003, -0.002, 0.04), abs=1e-3)
    # Perpendicular to the plane of symmetry, which is along the block's length.
    place = viewpoint.pose.position
    across = (place.x - 0.003) * np.cos(0.3) + (place.y + 0.002) * np.sin(0.3)
    assert across == pytest.approx(0.0, abs=0.02)
    assert 0.2 - 1e-3 < place.z - 0.04 < 0.4 * np.sin(np.pi / 4) + 1e-3
    assert pose.pose.position.z == pytest.approx(0.02, abs=1e-3)
    values = values_from_status(found)
    # Half a cell on a rim of 240 mm, as a share of 35 cm^2.
    assert float(values['volume_m3']) == pytest.approx(0.07 * 0.05 * 0.04, rel=0.07)
    assert shape.width > 1000
    # The views are used up.
    assert probe.call(CLEAR_VIEWS, Trigger.Request()).message == '0 views were forgotten.'


def test_several_fixed_sensors_are_heard_together_in_each_plan(start_node, probe):
    solid = block(0.07, 0.05, 0.04).at(0.003, -0.002, 0.3)
    left, right = (Camera(azimuth, 0.7, width=160, height=120) for azimuth in (0.5, 0.5 + np.pi))
    start_node(
        'contact_point_planner',
        {
            'cloud_timeout': 20.0,
            'clouds': 2,
            'other_points': '/second_sensor/points',
            'sensor_frames': 'left right',
            'sensor_poses': [*numbers_of(left), *numbers_of(right)],
        },
    )
    arm = probe.publisher(TOOL_HEIGHT)
    sensors = [
        (probe.publisher(topic), frame, take(camera, [solid]).xyz)
        for topic, frame, camera in (
            (POINTS, 'left', left),
            (replace(POINTS, name='/second_sensor/points'), 'right', right),
        )
    ]

    def send():
        stamp = probe.node.get_clock().now().nanoseconds
        arm.publish(scalar_to_message(0.12))
        for publisher, frame, cloud in sensors:
            publisher.publish(cloud_to_message(RangeFrame(stamp, cloud), frame))

    timer = probe.node.create_timer(0.05, send)
    # For each push of an experiment anew, without another word.
    answers = [probe.call(PLAN, Trigger.Request(), DEADLINE) for _ in range(2)]
    probe.node.destroy_timer(timer)
    for answer in answers:
        assert answer.success, answer.message
        assert 'from 2 views' in answer.message


@pytest.mark.parametrize(
    ('blocks', 'sentence'),
    [
        ((), 'Nothing larger than'),
        (((-0.05, 0.0, 0.04, 0.04), (0.05, 0.0, 0.04, 0.04)), 'There are 2 objects'),
        (((0.05, 0.0, 0.04, 0.04),), "from the tool's axis"),
        (((-0.14, 0.0, 0.08, 0.04),), "border of the range sensor's image"),
    ],
    ids=['nothing', 'two objects', 'off the axis', 'cut off'],
)
def test_what_cannot_be_pushed_is_refused_with_the_reason(planner, probe, show, blocks, sentence):
    show(top_view(*blocks))
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert sentence in answer.message


def test_without_clouds_the_plan_is_refused_in_time(start_node, probe):
    start_node('contact_point_planner', {'cloud_timeout': 1.0})
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert 'No cloud came within 1 s' in answer.message
    # And the service still answers.
    assert 'No cloud came' in probe.call(PLAN, Trigger.Request()).message


def test_without_the_tools_height_the_tool_is_not_taken_for_the_object(start_node, probe, show):
    start_node('contact_point_planner', {'cloud_timeout': 1.0})
    show(top_view((0.0, 0.0, 0.08, 0.05)), tool_height=None)
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    # On a loaded machine the clouds may not come either.
    assert 'No tool height came within 1 s' in answer.message or 'No cloud' in answer.message


def test_a_height_that_the_arm_told_long_ago_is_none(start_node, probe, show):
    start_node('contact_point_planner', {'cloud_timeout': 2.0, 'clouds': 1})
    arm = probe.publisher(TOOL_HEIGHT)
    show(top_view((0.0, 0.0, 0.08, 0.05)), tool_height=None)
    timer = probe.node.create_timer(0.05, lambda: arm.publish(scalar_to_message(2.0 * TOP)))
    end = time.monotonic() + DEADLINE
    while not (answer := probe.call(PLAN, Trigger.Request(), DEADLINE)).success:
        assert time.monotonic() < end, answer.message
    probe.node.destroy_timer(timer)
    # The clouds go on, and the arm is heard no more.
    while 'No tool height came within 2 s' not in answer.message:
        assert time.monotonic() < end, answer.message
        answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success


def test_clouds_in_a_foreign_frame_are_refused(planner, probe, show):
    show(top_view((0.0, 0.0, 0.08, 0.05)), frame_id='camera')
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert "frame 'camera'" in answer.message


def test_poses_in_the_parameters_are_seven_numbers_a_frame():
    left = (0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0)
    poses = known_poses('left right', (*left, *left))
    assert list(poses) == ['left', 'right']
    assert poses['right'].translation == pytest.approx((0.1, 0.2, 0.3))
    with pytest.raises(InputError, match="holds 7 numbers, but 'sensor_frames' names 2 frames"):
        known_poses('left right', left)


def test_the_planner_tells_what_it_hears_and_what_became_of_a_plan(
    start_node, probe, show, diagnosis
):
    planner = diagnosis('contact_point_planner')
    start_node('contact_point_planner', {'cloud_timeout': 1.0})
    silent = planner.wait('clouds', lambda s, v: s.level == s.WARN, 'the missing clouds told')
    assert 'A cloud on /range_sensor/points has not come yet.' in silent.message
    assert 'The tool height on /arm/tool_height has not come yet.' in silent.message
    idle = planner.wait('plan', lambda s, v: True, 'the state of the plan')
    assert (idle.level, idle.message) == (idle.OK, 'No plan has been asked for.')
    assert not probe.call(PLAN, Trigger.Request(), DEADLINE).success
    refused = planner.wait('plan', lambda s, v: s.level == s.WARN, 'the refusal told')
    assert 'No cloud came within 1 s' in refused.message
    assert values_from_status(refused)['refusals'] == '1'

    # Clouds of this size lose their way on a loaded machine.
    assert all(
        r.successful
        for r in probe.set_parameters('contact_point_planner', {'cloud_timeout': 20.0})
    )
    show(top_view((0.004, -0.003, 0.08, 0.05)))
    heard = planner.wait('clouds', lambda s, v: s.level == s.OK, 'the clouds told')
    values = values_from_status(heard)
    assert heard.message == 'Clouds and tool height come.'
    assert (values['/range_sensor/points_width'], values['/range_sensor/points_height']) == (
        '300',
        '200',
    )
    assert values['/range_sensor/points_frame'] == 'support_plane'
    assert float(values['/range_sensor/points_age_s']) < 20.0
    # Stamped just before they were sent, by the same clock.
    assert 0.0 < float(values['/range_sensor/points_delay_s']) < 20.0
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert answer.success, answer.message
    planned = planner.wait('plan', lambda s, v: v['plans'] == '1', 'the plan told')
    assert (planned.level, planned.message) == (planned.OK, answer.message)


def test_the_planner_tells_of_clouds_that_cannot_be_used(start_node, probe, diagnosis, until):
    planner = diagnosis('contact_point_planner')
    start_node('contact_point_planner')
    publisher = probe.publisher(POINTS)
    cloud = cloud_to_message(RangeFrame(0, top_view()[:4]), POINTS.frame_id)
    cloud.fields = cloud.fields[:2]
    timer = probe.node.create_timer(0.05, lambda: publisher.publish(cloud))
    try:
        bad = planner.wait('clouds', lambda s, v: 'cannot be used' in s.message, 'the field told')
    finally:
        probe.node.destroy_timer(timer)
    assert 'it has no field z' in bad.message
    assert bad.level == bad.WARN


def camera_info(height, width, focal):
    projection = [focal, 0.0, 2.0, 0.0, 0.0, focal, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    return CameraInfo(height=height, width=width, p=projection)


def test_a_picture_is_read_with_its_padding():
    rows = np.arange(3 * 20, dtype=np.uint8).reshape(3, 20)
    image = Image(height=3, width=5, step=20, encoding='rgb8', data=rows.tobytes())
    picture = picture_from_messages(image, camera_info(3, 5, 100.0), Pose.identity())
    assert np.array_equal(picture.pixels, rows[:, :15].reshape(3, 5, 3))
    assert picture.matrix == pytest.approx(np.array([[100, 0, 2], [0, 100, 1], [0, 0, 1.0]]))


@pytest.mark.parametrize(
    ('change', 'info', 'sentence'),
    [
        ({'encoding': 'bayer_rggb8'}, camera_info(3, 5, 100.0), "encoded as 'bayer_rggb8'"),
        ({'height': 4}, camera_info(4, 5, 100.0), 'fewer bytes'),
        ({}, camera_info(3, 6, 100.0), 'does not fit its image'),
        ({}, camera_info(3, 5, 0.0), 'is not calibrated'),
    ],
    ids=['bayer', 'cut off', 'another camera', 'not calibrated'],
)
def test_a_picture_that_cannot_be_used_is_refused(change, info, sentence):
    fields = {'height': 3, 'width': 5, 'step': 5, 'encoding': 'mono8', 'data': bytes(15)} | change
    with pytest.raises(InputError, match=sentence):
        picture_from_messages(Image(**fields), info, Pose.identity())


SOLID = block(0.09, 0.06, 0.045).at(0.01, -0.005, 0.4)
EYE = Camera(0.3, np.deg2rad(88.0), width=240, height=180)
IMAGE, INFO = '/camera/image_rect', '/camera/camera_info'


def with_a_dark_edge():
    """Return a cloud of a block in which a strip of 5 mm along one edge gave no return."""
    shot = take(EYE, [SOLID], seed=0)
    world = shot.xyz.reshape(-1, 3).astype(float) @ EYE.rotation.T + EYE.translation
    x, y, z = np.moveaxis(world.reshape(shot.xyz.shape), -1, 0)
    along = (x - 0.01) * np.cos(0.4) + (y + 0.005) * np.sin(0.4)
    cloud = shot.xyz.copy()
    cloud[(along > 0.045 - 0.005) & (z > 0.004)] = np.nan
    return cloud


def picture_of(shot, frame='eye', **changes):
    """Return Image and CameraInfo of what the camera sees, as its driver sends them."""
    image = Image(height=EYE.height, width=EYE.width, step=3 * EYE.width, encoding='rgb8')
    image.data = shot.image.tobytes()
    image.header.frame_id = frame
    for name, value in changes.items():
        setattr(image, name, value)
    matrix = EYE.matrix
    projection = [*matrix[0], 0.0, *matrix[1], 0.0, *matrix[2], 0.0]
    info = CameraInfo(height=EYE.height, width=EYE.width, p=[float(p) for p in projection])
    return image, info


@pytest.fixture
def see(start_node, probe):
    """Run a planner with a camera; send a cloud, the tool's height and pictures to it."""
    pose = numbers_of(EYE)
    start_node(
        'contact_point_planner',
        {
            'cloud_timeout': 20.0,
            'clouds': 1,
            'axis_tolerance': 0.05,
            'sensor_frames': 'scanner eye',
            'sensor_poses': [*pose, *pose],
            'image_topic': IMAGE,
            'camera_info_topic': INFO,
        },
    )
    points, arm = probe.publisher(POINTS), probe.publisher(TOOL_HEIGHT)
    images = probe.node.create_publisher(Image, IMAGE, 5)
    infos = probe.node.create_publisher(CameraInfo, INFO, 5)
    shown = {}

    def send():
        stamp = probe.node.get_clock().now()
        arm.publish(scalar_to_message(0.12))
        for publisher, message in zip((images, infos), shown.get('picture', ()), strict=False):
            message.header.stamp = stamp.to_msg()
            publisher.publish(message)
        if 'cloud' in shown:
            cloud = RangeFrame(stamp.nanoseconds, shown['cloud'])
            points.publish(cloud_to_message(cloud, 'scanner'))

    timer = probe.node.create_timer(0.05, send)
    yield shown
    probe.node.destroy_timer(timer)


def test_a_picture_gives_back_an_edge_that_the_cloud_lost(see, probe, until, diagnosis):
    planner = diagnosis('contact_point_planner')
    see['cloud'] = with_a_dark_edge()
    # A camera that was asked for and is silent is not passed over.
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert f"No picture came on '{IMAGE}' and '{INFO}'" in answer.message
    lacking = planner.wait('clouds', lambda s, v: s.level == s.WARN, 'the missing picture told')
    assert f'A picture on {IMAGE} has not come yet.' in lacking.message
    assert f'No CameraInfo has come on {INFO} yet.' in lacking.message

    contacts = probe.listen(CONTACT_POINT)
    see['picture'] = picture_of(take(EYE, [SOLID], seed=5))
    planner.wait(
        'clouds', lambda s, v: s.level == s.OK and v['picture_age_s'] != '-', 'the picture told'
    )
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert answer.success, answer.message
    until(lambda: contacts, 'the contact point')
    x, y, _ = point_from_message(contacts[-1])
    # Without the picture it is off by half of the strip of 5 mm.
    assert np.hypot(x - 0.01, y + 0.005) < 1e-3

    # A camera that has stopped: its last picture is of another object.
    del see['picture']
    probe.set_parameters('contact_point_planner', {'cloud_timeout': 1.0})
    planner.wait(
        'clouds', lambda s, v: s.level == s.WARN and 'picture' in s.message, 'the old picture'
    )
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    # On a loaded machine the rest may not come either.
    assert re.search('No (picture|cloud|tool height) came', answer.message), answer.message


def test_a_picture_of_something_else_is_told_and_not_used(see, probe, until):
    see['cloud'] = with_a_dark_edge()
    other = block(0.02, 0.02, 0.045).at(-0.06, 0.05, 0.0)
    see['picture'] = picture_of(take(EYE, [other], seed=5))
    contacts, found = probe.listen(CONTACT_POINT), probe.listen(OBJECT)

    def planned():
        answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
        # Cloud and picture are on their way, each by itself.
        assert answer.success or 'No picture came' in answer.message, answer.message
        return answer.success and answer

    answer = until(planned, 'a plan')
    assert 'Picture 1 was not used' in answer.message
    until(lambda: contacts and found, 'the plan')
    x, y, _ = point_from_message(contacts[-1])
    assert np.hypot(x - 0.01, y + 0.005) == pytest.approx(0.0025, abs=1e-3)


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'encoding': 'bayer_rggb8'}, "encoded as 'bayer_rggb8'"),
        ({'data': bytes(100)}, 'holds fewer bytes'),
        ({'height': 90}, 'does not fit its image'),
        ({'frame': 'nowhere'}, "frame 'nowhere', whose pose"),
    ],
    ids=['bayer', 'cut off', 'another size', 'no pose'],
)
def test_a_picture_that_cannot_be_used_is_told_by_the_service(
    see, probe, until, changes, sentence
):
    see['cloud'] = with_a_dark_edge()
    see['picture'] = picture_of(take(EYE, [SOLID], seed=5), **changes)

    def refused():
        answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
        assert not answer.success
        return 'No picture came' not in answer.message and answer

    assert sentence in until(refused, 'a refusal').message

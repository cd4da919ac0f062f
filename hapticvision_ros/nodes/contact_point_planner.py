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
Contact-point planner: looks at the object from one or several sides, and plans the push.

A view is some clouds from one place. It is taken when a plan is asked for, or kept beforehand by
the service ``add_view``: so a sensor on the wrist looks from place to place, and several fixed
sensors are heard together. Clouds are kept as bytes, the latest only, and are read while a view
is taken.
"""

from collections.abc import Sequence
from importlib.util import find_spec
import time
from typing import Any, Final

from hapticvision_ros.bag.clouds import read_layout
from hapticvision_ros.bag.contract import (
    ADD_VIEW,
    CLEAR_VIEWS,
    CONTACT_POINT,
    OBJECT,
    OBJECT_POSE,
    PHASE,
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
from hapticvision_ros.core.planning import touch_and_see, TouchPlan, TouchSettings
from hapticvision_ros.core.scene.frames import FrameTree
from hapticvision_ros.core.scene.registration import MergeSettings
from hapticvision_ros.core.scene.settings import PlanningSettings
from hapticvision_ros.core.scene.stability import PushSettings
from hapticvision_ros.core.scene.viewpoint import ViewSettings
from hapticvision_ros.core.scene.views import mean_cloud, Picture, Pose, View
from hapticvision_ros.nodes.conversions import (
    cloud_to_message,
    ns_from_stamp,
    NS_PER_S,
    picture_from_messages,
    point_to_message,
    pose_from_parts,
    pose_to_message,
    status_to_message,
    vector_to_message,
    xyz_from_message,
)
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Heard, Level, worst
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec, refuse_changes_while_pushing
from hapticvision_ros.nodes.qos import (
    create_publisher,
    create_service,
    create_subscription,
    interface_class,
    subscription_profile,
)
from hapticvision_ros.nodes.runtime import CellNode, run
import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, Image

NAME: Final = 'contact_point_planner'
POSE_NUMBERS: Final = 7
TF_DEPTH: Final = 1000

PARAMETERS: Final = (
    ParameterSpec('clouds', 'integer', '-', 'A view is the mean of this many clouds.', 1, 100),
    ParameterSpec(
        'cloud_timeout',
        'double',
        's',
        'A plan is refused when a cloud, the tool height or the picture of a camera has not come '
        'within this time.',
        0.1,
        60.0,
    ),
    ParameterSpec('tool_axis_x', 'double', 'm', "x of the tool's axis.", -2.0, 2.0),
    ParameterSpec('tool_axis_y', 'double', 'm', "y of the tool's axis.", -2.0, 2.0),
    ParameterSpec(
        'axis_tolerance',
        'double',
        'm',
        "Largest distance of the contact point from the tool's axis: the tool moves along its "
        'axis only.',
        0.0,
        2.0,
    ),
    ParameterSpec(
        'largest_tilt',
        'double',
        'rad',
        'Largest angle between the support plane and the plane that the clouds show.',
        0.0,
        0.5,
    ),
    ParameterSpec(
        'plane_tolerance',
        'double',
        'm',
        'Half thickness of the support plane: a few times the noise of the range sensor.',
        0.0001,
        0.02,
    ),
    ParameterSpec(
        'least_plane_share',
        'double',
        '-',
        'Smallest share of the points that must lie in the support plane.',
        0.01,
        1.0,
    ),
    ParameterSpec(
        'object_clearance',
        'double',
        'm',
        'Points higher than this above the support plane belong to an object.',
        0.0001,
        0.1,
    ),
    ParameterSpec(
        'cell_size', 'double', 'm', 'Side of a cell of the top-view grid.', 0.0002, 0.02
    ),
    ParameterSpec(
        'closing_cells',
        'integer',
        '-',
        'Gaps of up to this many cells in the top view are closed.',
        1,
        50,
    ),
    ParameterSpec(
        'least_area',
        'double',
        'm^2',
        'Smallest top-view area of an object; smaller patches are taken for noise.',
        0.0,
        1.0,
    ),
    ParameterSpec(
        'patch_radius',
        'double',
        'm',
        'The height at the contact point is the median within this distance.',
        0.001,
        0.05,
    ),
    ParameterSpec(
        'least_patch_points', 'integer', '-', 'Fewest points within that distance.', 1, 100000
    ),
    ParameterSpec('seed', 'integer', '-', 'Seed of the random choice of points.', 0, 2**31 - 1),
    ParameterSpec(
        'other_points',
        'string',
        '-',
        'Further topics with clouds, of other range sensors, separated by blanks.',
        read_only=True,
    ),
    ParameterSpec(
        'sensor_frames',
        'string',
        '-',
        'Frames of range sensors and cameras whose poses are given here, separated by blanks; '
        'those of others come from tf or /range_sensor/pose.',
        read_only=True,
    ),
    ParameterSpec(
        'sensor_poses',
        'double_array',
        '-',
        'Their poses in the frame support_plane: x, y, z [m] and a quaternion x, y, z, w each.',
        -10.0,
        10.0,
        read_only=True,
    ),
    ParameterSpec(
        'pose_age',
        'double',
        's',
        "A moving sensor's pose may be this far from its cloud in time.",
        0.0,
        10.0,
    ),
    ParameterSpec(
        'translation_error',
        'double',
        'm',
        "Standard deviation of a known pose: so far the views' surfaces may move it.",
        0.0,
        0.05,
    ),
    ParameterSpec(
        'rotation_error',
        'double',
        'rad',
        "Standard deviation of a known pose's rotation.",
        0.0,
        0.2,
    ),
    ParameterSpec(
        'image_topic',
        'string',
        '-',
        'Rectified image that the outline of the object is held against; empty for none.',
        read_only=True,
    ),
    ParameterSpec(
        'camera_info_topic',
        'string',
        '-',
        "CameraInfo of that image, whose frame is the camera's.",
        read_only=True,
    ),
    ParameterSpec(
        'several_objects',
        'string',
        '-',
        "What to do with several objects: refuse, or take the one nearest to the tool's axis.",
        choices=('refuse', 'nearest'),
    ),
    ParameterSpec(
        'push_force', 'double', 'N', 'Largest force that the push may reach.', 0.1, 1000.0
    ),
    ParameterSpec(
        'object_mass',
        'double',
        'kg',
        'Mass of the object, whose weight holds it; zero if it is not known.',
        0.0,
        100.0,
    ),
    ParameterSpec(
        'support_friction',
        'double',
        '-',
        'Coefficient of friction between object and support.',
        0.0,
        5.0,
    ),
    ParameterSpec(
        'tool_friction',
        'double',
        '-',
        'Coefficient of friction between object and tool.',
        0.0,
        5.0,
    ),
    ParameterSpec(
        'base_margin',
        'double',
        'm',
        'The load must meet the support plane this far inside the base of the object.',
        0.0,
        0.1,
    ),
    ParameterSpec(
        'view_distance', 'double', 'm', 'Distance of the viewpoint from P_c.', 0.05, 5.0
    ),
    ParameterSpec(
        'least_elevation',
        'double',
        'rad',
        'Least elevation of the viewpoint; a horizontal view sees no dent.',
        0.0,
        1.5,
    ),
    ParameterSpec(
        'largest_elevation', 'double', 'rad', 'Largest elevation of the viewpoint.', 0.0, 1.5
    ),
    ParameterSpec('dent_depth', 'double', 'm', 'Deepest dent to be seen.', 0.0001, 0.1),
    ParameterSpec('tool_radius', 'double', 'm', 'Radius of the tool.', 0.001, 0.1),
)


class _Clouds:
    """
    What was last heard of a range sensor.

    Parameters
    ----------
    topic : str
        Of its clouds.

    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.heard = Heard(f'A cloud on {topic}', topic)
        self._latest: tuple[bytes, int] | None = None

    def note(self, serialised: bytes, now_ns: int) -> None:
        """Note a cloud that came at a time [ns since the epoch]."""
        self.heard.note()
        self._latest = serialised, now_ns

    def finding(self, longest: float) -> Finding:
        """Return how the clouds come; missed where none came for `longest` [s]."""
        silence = self.heard.finding(longest)
        if self._latest is None:
            return silence
        serialised, now_ns = self._latest
        try:
            layout = read_layout(memoryview(serialised))
        except ValueError as error:
            said = f'A cloud on {self.topic} cannot be used: {error}.'
            return worst([silence, Finding(Level.WARN, said)], '')
        values = {
            f'{self.topic}_width': layout.width,
            f'{self.topic}_height': layout.height,
            f'{self.topic}_frame': layout.frame_id,
            f'{self.topic}_delay_s': (now_ns - layout.stamp_ns) / NS_PER_S,
        }
        return worst([silence, Finding(Level.OK, '', values)], '')


class ContactPointPlanner(CellNode):
    """Answer the plan service, and publish what was planned."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        self._cloud_class = interface_class(POINTS.msgtype)
        self._tool_heights = Intake.of(self, TOOL_HEIGHT)
        self._tool_height: float | None = None
        self._waiting: dict[str, Any] = {}
        self._busy = False
        self._views: list[View] = []
        self._pictures: list[Picture] = []
        self._ceilings: list[float] = []
        self._known_poses = known_poses(values.text('sensor_frames'), values.reals('sensor_poses'))
        self._frames = FrameTree()
        self._sensor_poses = FrameTree()
        self._plans = self._refusals = 0
        self._answered: tuple[Level, str, float] | None = None
        self._image: Any = None
        self._info: Any = None
        self._contact_point = create_publisher(self, CONTACT_POINT)
        self._push_direction = create_publisher(self, PUSH_DIRECTION)
        self._viewpoint = create_publisher(self, VIEWPOINT)
        self._object_pose = create_publisher(self, OBJECT_POSE)
        self._object = create_publisher(self, OBJECT)
        self._shape = create_publisher(self, SHAPE)
        self._topics = (POINTS.name, *values.text('other_points').split())
        self._clouds = {topic: _Clouds(topic) for topic in self._topics}
        self._tool_heard = Heard(f'The tool height on {TOOL_HEIGHT.name}', 'tool_height')
        self._image_heard = Heard(f'A picture on {values.text("image_topic")}', 'picture')
        create_subscription(
            self, POINTS, lambda cloud: self._on_cloud(POINTS.name, cloud), raw=True
        )
        for topic in self._topics[1:]:
            self._listen(topic)
        create_subscription(self, SENSOR_POSE, self._on_sensor_pose)
        self._listen_to_tf()
        self._listen_to_camera()
        refuse_changes_while_pushing(self, PHASE)
        group = ReentrantCallbackGroup()
        create_service(self, PLAN, self._plan, callback_group=group)
        create_service(self, ADD_VIEW, self._add_view, callback_group=group)
        create_service(self, CLEAR_VIEWS, self._clear_views)
        diagnostics = self._diagnostics = Diagnostics(self)
        diagnostics.add('clouds', self._find_clouds)
        diagnostics.add('plan', self._find_plan)

    def _listen(self, topic: str) -> None:
        """Listen to the clouds of a further sensor."""
        self.create_subscription(
            self._cloud_class,
            topic,
            lambda cloud: self._on_cloud(topic, cloud),
            subscription_profile(POINTS.qos),
            raw=True,
        )

    def _listen_to_tf(self) -> None:
        """Listen to tf, where its messages are installed: they are not among the ROS wheels."""
        if find_spec('tf2_msgs') is None:
            self.get_logger().info('tf2_msgs is not installed: sensor poses do not come from tf.')
            return
        kind = interface_class('tf2_msgs/msg/TFMessage')
        # What tf2's own listener asks for: of /tf reliable, /tf_static latched.
        profile = QoSProfile(depth=TF_DEPTH, reliability=QoSReliabilityPolicy.RELIABLE)
        latched = QoSProfile(
            depth=TF_DEPTH,
            reliability=QoSReliabilityPolicy.RELIABLE,
            durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
        )
        self.create_subscription(kind, '/tf', lambda m: self._on_tf(m, False), profile)
        self.create_subscription(kind, '/tf_static', lambda m: self._on_tf(m, True), latched)

    def _listen_to_camera(self) -> None:
        image, info = (self.parameters.text(name) for name in ('image_topic', 'camera_info_topic'))
        if bool(image) != bool(info):
            raise InputError(
                f"{NAME}: 'image_topic' and 'camera_info_topic' come together: set both or none."
            )
        if image:
            profile = subscription_profile(POINTS.qos)
            self.create_subscription(Image, image, self._on_image, profile)
            self.create_subscription(CameraInfo, info, self._on_info, profile)

    def _on_image(self, message: Any) -> None:
        self._image = message
        self._image_heard.note()

    def _on_info(self, message: Any) -> None:
        self._info = message

    def _on_tf(self, message: Any, static: bool) -> None:
        for item in message.transforms:
            try:
                pose = pose_from_parts(item.transform.translation, item.transform.rotation)
            except InputError as error:
                self.get_logger().warning(f'A transform on tf is left out: {error}')
                continue
            stamp_ns = None if static else ns_from_stamp(item.header.stamp)
            self._frames.put(item.header.frame_id, item.child_frame_id, pose, stamp_ns)

    def _on_sensor_pose(self, message: Any) -> None:
        try:
            pose = pose_from_parts(message.pose.position, message.pose.orientation)
        except InputError as error:
            self.get_logger().warning(f'A pose of the range sensor is left out: {error}')
            return
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._sensor_poses.put(message.header.frame_id, SENSOR_POSE.name, pose, stamp_ns)

    def _on_cloud(self, topic: str, serialised: bytes) -> None:
        self._clouds[topic].note(serialised, self.get_clock().now().nanoseconds)
        waiting = self._waiting.pop(topic, None)
        if waiting is not None:
            waiting.set_result(serialised)

    def _latest_tool_height(self) -> float | None:
        """Return where the tool is [m]; None where that has not been told for too long."""
        for message, _, received_ns in self._tool_heights.take():
            self._tool_height = float(message.data)
            # Nobody may have looked since it came.
            self._tool_heard.note(ago=(time.time_ns() - received_ns) / NS_PER_S)
        return self._tool_height if self._is_fresh(self._tool_heard) else None

    def _is_fresh(self, heard: Heard) -> bool:
        age = heard.age
        return age is not None and age <= self.parameters.real('cloud_timeout')

    async def _plan(self, request: Any, response: Any) -> Any:
        """Answer once the clouds have come; other callbacks run in between."""
        return await self._answer(self._plan_and_publish, response)

    async def _add_view(self, request: Any, response: Any) -> Any:
        """Keep the next clouds for the next plan."""
        return await self._answer(self._keep_view, response)

    def _clear_views(self, request: Any, response: Any) -> Any:
        if self._busy:
            response.success, response.message = False, 'A view or a plan is being made.'
            return response
        count = len(self._views)
        self._forget()
        response.success, response.message = True, f'{count} views were forgotten.'
        return response

    async def _answer(self, action: Any, response: Any) -> Any:
        response.success = False
        if self._busy:
            response.message = 'A plan is being made already.'
            return response
        self._busy = True
        try:
            response.message = await action()
            self._plans += action == self._plan_and_publish
            self._tell(Level.OK, response.message)
        except InputError as error:
            response.message = str(error)
            self._refusals += 1
            self._tell(Level.WARN, response.message)
            self._object.publish(status_to_message(NAME, str(error), {}, warning=True))
            return response
        finally:
            self._busy = False
        response.success = True
        return response

    def _tell(self, level: Level, message: str) -> None:
        """Keep an answer for the diagnostics."""
        self._answered = level, message, time.monotonic()
        self._diagnostics.hasten()

    def _find_clouds(self) -> Finding:
        """Return what a plan would have to wait for."""
        longest = self.parameters.real('cloud_timeout')
        self._latest_tool_height()
        findings = [clouds.finding(longest) for clouds in self._clouds.values()]
        findings.append(self._tool_heard.finding(longest))
        if self.parameters.text('image_topic'):
            findings.append(self._image_heard.finding(longest))
            if self._info is None:
                topic = self.parameters.text('camera_info_topic')
                findings.append(Finding(Level.WARN, f'No CameraInfo has come on {topic} yet.'))
        return worst(findings, 'Clouds and tool height come.')

    def _find_plan(self) -> Finding:
        """Return what became of the last plan or view that was asked for."""
        values: dict[str, object] = {
            'plans': self._plans,
            'refusals': self._refusals,
            'views_kept': len(self._views),
        }
        if self._busy:
            return Finding(Level.OK, 'A view or a plan is being made.', values)
        if self._answered is None:
            return Finding(Level.OK, 'No plan has been asked for.', values)
        level, message, answered = self._answered
        values['age_s'] = time.monotonic() - answered
        return Finding(level, message, values)

    def _forget(self) -> None:
        self._views, self._pictures, self._ceilings = [], [], []

    async def _keep_view(self) -> str:
        views, _ = await self._look()
        self._views += views
        names = ', '.join(view.name for view in views)
        return f'Kept {names}; the next plan has {len(self._views)} views.'

    async def _plan_and_publish(self) -> str:
        kept = bool(self._views)
        stamp_ns = self.get_clock().now().nanoseconds
        if not kept:
            self._views, stamp_ns = await self._look()
        try:
            plan = touch_and_see(
                self._views,
                self._pictures,
                ceiling=min(self._ceilings),
                nearest_to=self._nearest_to(),
                settings=self._settings(),
            )
            self._check(plan)
        except InputError:
            if not kept:
                self._forget()
            raise
        count = len(self._views)
        # After the push the object is another.
        self._forget()
        return self._publish(plan, stamp_ns, count)

    async def _look(self) -> tuple[list[View], int]:
        """Return one view of each sensor, and the stamp of its last cloud."""
        views, stamp_ns = [], 0
        deadline = time.monotonic() + self.parameters.real('cloud_timeout')
        for topic in self._topics:
            view, stamp_ns = await self._take_view(topic, deadline)
            views.append(view)
        ceiling = self._latest_tool_height()
        if ceiling is None:
            raise self._no_tool_height()
        self._take_picture(stamp_ns)
        self._ceilings.append(ceiling)
        return views, stamp_ns

    async def _take_view(self, topic: str, deadline: float) -> tuple[View, int]:
        clouds: list[Any] = []
        poses: list[Pose] = []
        frame, stamp_ns = '', 0
        while len(clouds) < self.parameters.integer('clouds'):
            message = deserialize_message(await self._next_cloud(topic), self._cloud_class)
            frame, stamp_ns = message.header.frame_id, ns_from_stamp(message.header.stamp)
            if self._latest_tool_height() is None:
                # The arm may just start; without its height the tool would be part of the object.
                if time.monotonic() > deadline:
                    raise self._no_tool_height()
                continue
            poses.append(self._pose_of(frame, stamp_ns))
            clouds.append(xyz_from_message(message))
        name = f'of frame {frame}' if frame != POINTS.frame_id else f'on {topic}'
        if self._views:
            name += f' ({len(self._views) + 1})'
        self._refuse_motion(name, poses)
        levelled = frame == POINTS.frame_id
        return View(mean_cloud(clouds), poses[-1], name, levelled), stamp_ns

    def _no_tool_height(self) -> InputError:
        return InputError(
            f'No tool height came within {self.parameters.real("cloud_timeout"):g} s: see whether '
            'the arm push controller runs.'
        )

    def _refuse_motion(self, name: str, poses: Sequence[Pose]) -> None:
        """Refuse clouds of one view that were taken from several places."""
        moved = max(
            float(np.linalg.norm(pose.translation - poses[0].translation)) for pose in poses
        )
        if moved > self.parameters.real('plane_tolerance'):
            raise InputError(
                f'The sensor of the view {name} moved by {moved * 1e3:.1f} mm while the view was '
                'taken: stop it first.'
            )

    def _pose_of(self, frame: str, stamp_ns: int) -> Pose:
        """Return where a frame is in the support plane's at some time."""
        if frame == POINTS.frame_id:
            return Pose.identity()
        if frame in self._known_poses:
            return self._known_poses[frame]
        age_ns = round(self.parameters.real('pose_age') * NS_PER_S)
        for tree, name in ((self._sensor_poses, SENSOR_POSE.name), (self._frames, frame)):
            pose = tree.pose(name, POINTS.frame_id, stamp_ns, age_ns)
            if pose is not None:
                return pose
        raise InputError(
            f"The clouds are in frame '{frame}', whose pose in '{POINTS.frame_id}' is not known: "
            'calibrate the range sensor, and give its pose by tf, on '
            f'{SENSOR_POSE.name}, or in sensor_frames and sensor_poses.'
        )

    def _take_picture(self, stamp_ns: int) -> None:
        """Keep the camera's picture, if there is a camera."""
        if not self.parameters.text('image_topic'):
            return
        image, info = self._image, self._info
        if image is None or info is None or not self._is_fresh(self._image_heard):
            raise InputError(
                f"No picture came on '{self.parameters.text('image_topic')}' and "
                f"'{self.parameters.text('camera_info_topic')}' within "
                f'{self.parameters.real("cloud_timeout"):g} s: see whether the camera runs.'
            )
        pose = self._pose_of(image.header.frame_id, ns_from_stamp(image.header.stamp))
        self._pictures.append(picture_from_messages(image, info, pose))

    async def _next_cloud(self, topic: str) -> bytes:
        """Return the next cloud, serialised; refuse when none comes in time."""
        cloud = Future()
        self._waiting[topic] = cloud
        timeout = self.parameters.real('cloud_timeout')

        def give_up() -> None:
            if not cloud.done():
                self._waiting.pop(topic, None)
                cloud.set_result(None)

        timer = self.create_timer(timeout, give_up)
        try:
            serialised = await cloud
        finally:
            self.destroy_timer(timer)
        if serialised is None:
            raise InputError(
                f'No cloud came within {timeout:g} s on {topic}: see whether the range sensor '
                'runs.'
            )
        return bytes(serialised)

    def _nearest_to(self) -> tuple[float, float, float] | None:
        if self.parameters.text('several_objects') == 'refuse':
            return None
        return (self.parameters.real('tool_axis_x'), self.parameters.real('tool_axis_y'), 0.0)

    def _check(self, plan: TouchPlan) -> None:
        """Refuse a contact point that the tool, which moves along its axis only, cannot meet."""
        values = self.parameters
        x, y, _ = plan.contact.contact_point
        distance = float(np.hypot(x - values.real('tool_axis_x'), y - values.real('tool_axis_y')))
        tolerance = values.real('axis_tolerance')
        if distance > tolerance:
            raise InputError(
                f'The contact point x = {x * 1e3:.1f} mm, y = {y * 1e3:.1f} mm is '
                f"{distance * 1e3:.1f} mm from the tool's axis, {tolerance * 1e3:.1f} mm are "
                'allowed: move the object under the tool.'
            )
        tilt = plan.contact.plane.tilt
        if tilt > values.real('largest_tilt'):
            raise InputError(
                f'The support plane appears tilted by {np.rad2deg(tilt):.2f} deg: calibrate the '
                'range sensor.'
            )

    def _publish(self, plan: TouchPlan, stamp_ns: int, count: int) -> str:
        """Publish the plan and return it as a sentence."""
        frame = CONTACT_POINT.frame_id
        x, y, z = plan.contact.contact_point
        self._contact_point.publish(point_to_message((x, y, z), stamp_ns, frame))
        self._push_direction.publish(
            vector_to_message(plan.contact.push_direction, stamp_ns, frame)
        )
        self._viewpoint.publish(pose_to_message(plan.viewpoint.pose, stamp_ns, frame))
        self._object_pose.publish(pose_to_message(plan.object_pose, stamp_ns, frame))
        rotation, shift = plan.contact.plane.to_plane_frame()
        surface = (plan.surface.points - shift) @ rotation
        self._shape.publish(
            cloud_to_message(RangeFrame(stamp_ns, surface[None].astype(np.float32)), frame)
        )
        sentence = (
            f'Contact point x = {x * 1e3:.1f} mm, y = {y * 1e3:.1f} mm, z = {z * 1e3:.1f} mm '
            f'from {count} {"view" if count == 1 else "views"}.'
        )
        message = ' '.join((sentence, *plan.warnings))
        self._object.publish(
            status_to_message(NAME, message, _values(plan), warning=bool(plan.warnings))
        )
        return message

    def _settings(self) -> TouchSettings:
        values = self.parameters
        return TouchSettings(
            planning=PlanningSettings(
                plane_tolerance=values.real('plane_tolerance'),
                least_plane_share=values.real('least_plane_share'),
                object_clearance=values.real('object_clearance'),
                cell_size=values.real('cell_size'),
                closing_cells=values.integer('closing_cells'),
                least_area=values.real('least_area'),
                patch_radius=values.real('patch_radius'),
                least_patch_points=values.integer('least_patch_points'),
                seed=values.integer('seed'),
            ),
            merge=MergeSettings(
                translation_error=max(values.real('translation_error'), 1e-6),
                rotation_error=max(values.real('rotation_error'), 1e-6),
                seed=values.integer('seed'),
            ),
            push=PushSettings(
                force=values.real('push_force'),
                mass=values.real('object_mass'),
                support_friction=values.real('support_friction'),
                tool_friction=values.real('tool_friction'),
                base_margin=values.real('base_margin'),
            ),
            view=ViewSettings(
                distance=values.real('view_distance'),
                least_elevation=values.real('least_elevation'),
                largest_elevation=max(
                    values.real('largest_elevation'), values.real('least_elevation')
                ),
                dent_depth=values.real('dent_depth'),
                tool_radius=values.real('tool_radius'),
                patch_radius=values.real('patch_radius'),
            ),
        )


def known_poses(frames: str, numbers: Sequence[float]) -> dict[str, Pose]:
    """
    Return the poses that the parameters give.

    Raises
    ------
    InputError
        If there are not seven numbers for each frame, or they are no pose.

    """
    names = frames.split()
    if len(numbers) != POSE_NUMBERS * len(names):
        raise InputError(
            f"{NAME}: 'sensor_poses' holds {len(numbers)} numbers, but 'sensor_frames' names "
            f'{len(names)} frames: give x, y, z and a quaternion x, y, z, w for each.'
        )
    poses = {}
    for index, name in enumerate(names):
        first = POSE_NUMBERS * index
        place, turn = numbers[first:][:3], numbers[first:][3:POSE_NUMBERS]
        poses[name] = Pose.from_quaternion(tuple(place), tuple(turn))
    return poses


def _values(plan: TouchPlan) -> dict[str, str]:
    """Return what was found as texts, with the units in the names."""
    stability, symmetry, merge = plan.stability, plan.symmetry, plan.merge
    length, width, height = plan.size
    numbers = {
        'volume_m3': plan.volume,
        'length_m': length,
        'width_m': width,
        'height_m': height,
        'top_view_area_m2': plan.contact.object_area,
        'contact_height_m': plan.contact.object_height,
        'support_plane_tilt_rad': plan.contact.plane.tilt,
        'symmetry_angle_rad': symmetry.angle,
        'symmetry_outline_overlap': symmetry.outline_overlap,
        'symmetry_body_overlap': symmetry.body_overlap,
        'symmetry_other_overlap': symmetry.other_overlap,
        'base_distance_m': stability.base_distance,
        'load_slope': stability.slope,
        'surface_angle_rad': stability.surface_angle,
        'view_elevation_rad': plan.viewpoint.elevation,
        'view_seen_share': plan.viewpoint.seen_share,
        'top_view_seen_share': plan.body.seen_share,
        'outline_seen_share': plan.outline_seen,
        'merge_distance_before_m': merge.distance_before,
        'merge_distance_after_m': merge.distance_after,
        'merge_largest_shift_m': max(merge.shifts),
    }
    return {name: f'{number:.6g}' for name, number in numbers.items()}


def main() -> int:
    """Run the contact-point planner."""
    return run(ContactPointPlanner)

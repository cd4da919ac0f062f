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
Contact-point planner: chooses the contact point and the push direction from the next clouds.

Clouds are kept as bytes, the latest only, and are read while a plan is asked for.
"""

import time
from typing import Any, Final

from hapticvision_ros.bag.contract import CONTACT_POINT, PLAN, POINTS, PUSH_DIRECTION, TOOL_HEIGHT
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import ContactPlan, plan_contact
from hapticvision_ros.core.scene.settings import PlanningSettings
from hapticvision_ros.nodes.conversions import (
    ns_from_stamp,
    point_to_message,
    vector_to_message,
    xyz_from_message,
)
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.qos import (
    create_publisher,
    create_service,
    create_subscription,
    interface_class,
)
from hapticvision_ros.nodes.runtime import CellNode, run
import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.serialization import deserialize_message
from rclpy.task import Future

NAME: Final = 'contact_point_planner'

PARAMETERS: Final = (
    ParameterSpec(
        'clouds', 'integer', '-', 'The plan is the median over this many clouds.', 1, 100
    ),
    ParameterSpec(
        'cloud_timeout',
        'double',
        's',
        'A plan is refused when a cloud or the tool height has not come within this time.',
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
)


class ContactPointPlanner(CellNode):
    """Answer the plan service, and publish what was planned."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        self._cloud_class = interface_class(POINTS.msgtype)
        self._tool_heights = Intake.of(self, TOOL_HEIGHT)
        self._tool_height: float | None = None
        self._waiting: Any = None
        self._contact_point = create_publisher(self, CONTACT_POINT)
        self._push_direction = create_publisher(self, PUSH_DIRECTION)
        create_subscription(self, POINTS, self._on_cloud, raw=True)
        create_service(self, PLAN, self._plan, callback_group=ReentrantCallbackGroup())

    def _latest_tool_height(self) -> float | None:
        for message, _, _ in self._tool_heights.take():
            self._tool_height = float(message.data)
        return self._tool_height

    def _on_cloud(self, serialised: bytes) -> None:
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            waiting.set_result(serialised)

    async def _plan(self, request: Any, response: Any) -> Any:
        """Answer once the clouds have come; other callbacks run in between."""
        response.success = False
        if self._waiting is not None:
            response.message = 'A plan is being made already.'
            return response
        try:
            response.message = await self._plan_and_publish()
        except InputError as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    async def _plan_and_publish(self) -> str:
        plans: list[ContactPlan] = []
        stamp_ns = 0
        timeout = self.parameters.real('cloud_timeout')
        deadline = time.monotonic() + timeout
        while len(plans) < self.parameters.integer('clouds'):
            message = deserialize_message(await self._next_cloud(), self._cloud_class)
            if message.header.frame_id != POINTS.frame_id:
                raise InputError(
                    f"The clouds are in frame '{message.header.frame_id}' instead of "
                    f"'{POINTS.frame_id}': calibrate the range sensor."
                )
            ceiling = self._latest_tool_height()
            if ceiling is None:
                # The arm may just start; without its height the tool would be part of the object.
                if time.monotonic() > deadline:
                    raise InputError(
                        f'No tool height came within {timeout:g} s: see whether the arm push '
                        'controller runs.'
                    )
                continue
            stamp_ns = ns_from_stamp(message.header.stamp)
            plans.append(
                plan_contact(xyz_from_message(message), ceiling=ceiling, settings=self._settings())
            )
        x, y, z = np.median([plan.contact_point for plan in plans], axis=0)
        direction = np.mean([plan.push_direction for plan in plans], axis=0)
        direction /= np.linalg.norm(direction)
        self._check(float(x), float(y), direction)
        self._contact_point.publish(point_to_message((x, y, z), stamp_ns, CONTACT_POINT.frame_id))
        self._push_direction.publish(
            vector_to_message(
                (direction[0], direction[1], direction[2]), stamp_ns, PUSH_DIRECTION.frame_id
            )
        )
        return (
            f'Contact point x = {x * 1e3:.1f} mm, y = {y * 1e3:.1f} mm, z = {z * 1e3:.1f} mm '
            f'from {len(plans)} clouds.'
        )

    async def _next_cloud(self) -> bytes:
        """Return the next cloud, serialised; refuse when none comes in time."""
        cloud = Future()
        self._waiting = cloud
        timeout = self.parameters.real('cloud_timeout')

        def give_up() -> None:
            if not cloud.done():
                self._waiting = None
                cloud.set_result(None)

        timer = self.create_timer(timeout, give_up)
        try:
            serialised = await cloud
        finally:
            self.destroy_timer(timer)
        if serialised is None:
            raise InputError(
                f'No cloud came within {timeout:g} s: see whether the range sensor runs.'
            )
        return bytes(serialised)

    def _check(self, x: float, y: float, direction: Any) -> None:
        """Refuse a contact point that the tool, which moves along its axis only, cannot meet."""
        values = self.parameters
        distance = float(np.hypot(x - values.real('tool_axis_x'), y - values.real('tool_axis_y')))
        tolerance = values.real('axis_tolerance')
        if distance > tolerance:
            raise InputError(
                f'The contact point x = {x * 1e3:.1f} mm, y = {y * 1e3:.1f} mm is '
                f"{distance * 1e3:.1f} mm from the tool's axis, {tolerance * 1e3:.1f} mm are "
                'allowed: move the object under the tool.'
            )
        tilt = float(np.arctan2(np.hypot(direction[0], direction[1]), -direction[2]))
        if tilt > values.real('largest_tilt'):
            raise InputError(
                f'The support plane appears tilted by {np.rad2deg(tilt):.2f} deg: calibrate the '
                'range sensor.'
            )

    def _settings(self) -> PlanningSettings:
        values = self.parameters
        return PlanningSettings(
            plane_tolerance=values.real('plane_tolerance'),
            least_plane_share=values.real('least_plane_share'),
            object_clearance=values.real('object_clearance'),
            cell_size=values.real('cell_size'),
            closing_cells=values.integer('closing_cells'),
            least_area=values.real('least_area'),
            patch_radius=values.real('patch_radius'),
            least_patch_points=values.integer('least_patch_points'),
            seed=values.integer('seed'),
        )


def main() -> int:
    """Run the contact-point planner."""
    return run(ContactPointPlanner)

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
Range sensor driver: owns the range sensor, publishes its clouds and the displacement height H.

H is followed at the planned contact point, from the sensor's own frames: nothing of a cloud needs
to be sent for it.
"""

from collections import deque
import time
from typing import Any, Final

from hapticvision_ros.bag.contract import (
    CONTACT_POINT,
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    TOOL_HEIGHT,
)
from hapticvision_ros.core.devices import RangeFrame, RangeSensor
from hapticvision_ros.core.displacement import DisplacementSettings, DisplacementTracker
from hapticvision_ros.devices.monitor import StreamMonitor
from hapticvision_ros.devices.range_frames import share_of_returns
from hapticvision_ros.nodes.conversions import (
    cloud_to_message,
    NS_PER_S,
    point_from_message,
    scalar_to_message,
)
from hapticvision_ros.nodes.device_keeper import DeviceKeeper, REOPEN_PARAMETERS
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Level
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec, refuse_changes_while_pushing
from hapticvision_ros.nodes.qos import create_publisher, create_subscription
from hapticvision_ros.nodes.range_backends import connect, RANGE_PARAMETERS
from hapticvision_ros.nodes.runtime import CellNode, run

NAME: Final = 'range_sensor_driver'

PARAMETERS: Final = (
    *RANGE_PARAMETERS,
    ParameterSpec(
        'frame_timeout',
        'double',
        's',
        'Without a frame for this time the range sensor counts as lost.',
        0.1,
        60.0,
    ),
    *REOPEN_PARAMETERS,
    ParameterSpec(
        'least_returns',
        'double',
        '-',
        'Share of the points of a frame that have to be returns; fewer are reported.',
        0.0,
        1.0,
    ),
    ParameterSpec(
        'tool_height_age',
        'double',
        's',
        'Largest distance in time between a frame and the tool height that masks the tool in it.',
        0.001,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'patch_radius',
        'double',
        'm',
        'The surface height is the median within this distance of the contact axis.',
        0.001,
        0.05,
        read_only=True,
    ),
    ParameterSpec(
        'region_radius',
        'double',
        'm',
        'Only pixels that saw the original surface within this distance of the contact axis are '
        'looked at: the patch radius and the deepest dent over the tangent of the elevation.',
        0.002,
        0.5,
        read_only=True,
    ),
    ParameterSpec(
        'tool_margin',
        'double',
        'm',
        'Points nearer to the height of the tool tip than this, or higher, are the tool.',
        0.0,
        0.02,
        read_only=True,
    ),
    ParameterSpec(
        'tool_clearance',
        'double',
        'm',
        'The surface counts as free once the tool tip is this far above it.',
        0.0,
        0.05,
        read_only=True,
    ),
    ParameterSpec(
        'least_points', 'integer', '-', 'Fewest points in the patch.', 1, 100000, read_only=True
    ),
    ParameterSpec(
        'least_share',
        'double',
        '-',
        'Fewest points in the patch, as a share of those before the push.',
        0.0,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'least_frames',
        'integer',
        '-',
        'Frames before the push that the original height needs.',
        1,
        1000,
        read_only=True,
    ),
    ParameterSpec(
        'most_frames',
        'integer',
        '-',
        'Frames before the push over which the original height is averaged at most.',
        1,
        1000,
        read_only=True,
    ),
)

_TOOL_HEIGHTS_KEPT: Final = 2000
_CLOCK_JUMP: Final = 1.0


class RangeSensorDriver(CellNode):
    """Publish clouds, and H once the contact point is known."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        self._settings = DisplacementSettings(
            patch_radius=values.real('patch_radius'),
            region_radius=values.real('region_radius'),
            tool_margin=values.real('tool_margin'),
            tool_clearance=values.real('tool_clearance'),
            least_points=values.integer('least_points'),
            least_share=values.real('least_share'),
            least_frames=values.integer('least_frames'),
            most_frames=values.integer('most_frames'),
        )
        self._tool_age_ns = round(values.real('tool_height_age') * NS_PER_S)
        self._tool_heights: deque[tuple[int, float]] = deque(maxlen=_TOOL_HEIGHTS_KEPT)
        self._axis: tuple[float, float] | None = None
        self._tracker: DisplacementTracker | None = None
        self._points = create_publisher(self, POINTS)
        self._displacement = create_publisher(self, DISPLACEMENT_HEIGHT)
        self._monitor = StreamMonitor(_CLOCK_JUMP)
        self._returns: float | None = None
        self._age = self._work = 0.0
        self._seen = 0
        self._keeper: DeviceKeeper[RangeSensor] = DeviceKeeper(
            lambda: connect(self, values),
            self.stopping,
            self.get_logger(),
            interval=values.real('reopen_interval'),
            patience=values.real('reopen_time'),
        )
        self._tool_heights_sent = Intake.of(self, TOOL_HEIGHT)
        create_subscription(self, CONTACT_POINT, self._on_contact_point)
        create_subscription(self, PHASE, self._on_phase)
        refuse_changes_while_pushing(self, PHASE)
        diagnostics = self._diagnostics = Diagnostics(self, values.text('backend'))
        diagnostics.add('device', self._keeper.finding)
        diagnostics.add('frames', self._find_frames)
        self.spawn(self._grab, 'range sensor reader')

    def close(self) -> None:
        """Stop the reader, then let go of the range sensor."""
        super().close()
        self._keeper.close()

    def _on_contact_point(self, message: Any) -> None:
        if message.header.frame_id != CONTACT_POINT.frame_id:
            self.get_logger().warning(
                f"The contact point is in frame '{message.header.frame_id}' instead of "
                f"'{CONTACT_POINT.frame_id}': it is not used."
            )
            return
        x, y, _ = point_from_message(message)
        self._axis = (x, y)
        # A new tracker rather than a reset: the reader thread may be using the old one.
        self._tracker = DisplacementTracker(self._axis, self._settings)

    def _on_phase(self, message: Any) -> None:
        tracker = self._tracker
        if message.data == 'approach' and tracker is not None and tracker.pushed:
            assert self._axis is not None
            self._tracker = DisplacementTracker(self._axis, self._settings)

    def _grab(self) -> None:
        self._keeper.run(self._grab_once, self._monitor.restart, self._diagnostics.hasten)

    def _grab_once(self, sensor: RangeSensor) -> None:
        frame = sensor.grab(self.parameters.real('frame_timeout'))
        begun = time.monotonic()
        self._age = (self.get_clock().now().nanoseconds - frame.stamp_ns) / NS_PER_S
        self._monitor.take(frame.stamp_ns, self.parameters.real('frame_timeout'))
        # First, since a Float64 carries no stamp but the time of its sending.
        self._follow(frame)
        self._points.publish(cloud_to_message(frame, POINTS.frame_id))
        self._returns = share_of_returns(frame.xyz)
        self._work = time.monotonic() - begun

    def _find_frames(self) -> Finding:
        """Return what is wrong with the frames at present."""
        rate, returns = self._monitor.rate(time.monotonic()), self._returns
        values: dict[str, object] = {
            'rate_hz': rate,
            'age_s': self._age,
            'work_s': self._work,
            'share_of_returns': returns,
            'clock_jumps': self._monitor.health.clock_jumps,
            'heights': self._seen,
        }
        least = self.parameters.real('least_returns')
        if returns is None:
            return Finding(Level.WARN, 'No frame has come yet.', values)
        if returns < least:
            said = f'Only {100.0 * returns:.3g} % of the points are returns.'
            return Finding(Level.WARN, said, values)
        return Finding(Level.OK, 'Frames come as expected.', values)

    def _follow(self, frame: RangeFrame) -> None:
        tracker = self._tracker
        if tracker is None:
            return
        height = tracker.update(frame.xyz, self._tool_height_at(frame.stamp_ns))
        if height is not None:
            self._seen += 1
            self._displacement.publish(scalar_to_message(height))

    def _tool_height_at(self, stamp_ns: int) -> float | None:
        """Return the tool height that was sent nearest to a stamp."""
        for message, sent_ns, _ in self._tool_heights_sent.take():
            self._tool_heights.append((sent_ns, float(message.data)))
        nearest = min(self._tool_heights, key=lambda item: abs(item[0] - stamp_ns), default=None)
        if nearest is None or abs(nearest[0] - stamp_ns) > self._tool_age_ns:
            return None
        return nearest[1]


def main() -> int:
    """Run the range sensor driver."""
    return run(RangeSensorDriver)

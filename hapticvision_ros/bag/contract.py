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
The bag contract, version 1, as one table.

Nodes, reader, writer and the pages under ``msg_docs/`` all read this table; nothing else in the
package spells a contract topic, its type, its unit or its quality of service.
"""

from dataclasses import dataclass
from typing import Final, Literal

CONTRACT_VERSION: Final = 1


@dataclass(frozen=True, slots=True)
class Qos:
    """
    Quality of service of a topic (REP-2003: drivers publish with system defaults).

    Parameters
    ----------
    reliability : {'reliable', 'best_effort'}
        What the publisher offers; subscribers ask for best effort so that any publisher fits.
    durability : {'volatile', 'transient_local'}
        Whether a late subscriber gets the last message.
    publish_depth, subscribe_depth : int
        Queue lengths; the subscriber's is long enough for half a second of the highest rate.

    """

    reliability: Literal['reliable', 'best_effort'] = 'reliable'
    durability: Literal['volatile', 'transient_local'] = 'volatile'
    publish_depth: int = 10
    subscribe_depth: int = 10


@dataclass(frozen=True, slots=True)
class Topic:
    """
    One topic of the contract.

    Parameters
    ----------
    name : str
        Full name, without a namespace.
    msgtype : str
        ROS type, ``package/msg/Name``.
    unit : str
        SI unit of the payload; ``-`` where it has none.
    frame_id : str
        Coordinate frame of the payload; ``-`` where it has none.
    rate_hz : tuple of float or None
        Typical lowest and highest rate [Hz]; None for a topic sent on change.
    required : bool
        Whether a trial without it is refused.
    stamped : bool
        Whether the message has a header, whose stamp is then its time; else the MCAP publish time.
    qos : Qos
        Quality of service.
    meaning : str
        One sentence for the documentation.

    """

    name: str
    msgtype: str
    unit: str
    frame_id: str
    rate_hz: tuple[float, float] | None
    required: bool
    stamped: bool
    qos: Qos
    meaning: str


WRENCH: Final = Topic(
    name='/load_cell/wrench',
    msgtype='geometry_msgs/msg/WrenchStamped',
    unit='N',
    frame_id='load_cell',
    rate_hz=(100.0, 1000.0),
    required=True,
    stamped=True,
    qos=Qos(publish_depth=1000, subscribe_depth=1000),
    meaning='Force of the object on the tool, in frame load_cell, whose +z points along the push. '
    'Contact force F = -force.z: positive in compression, negative when the object sticks to '
    'the tool.',
)
TOOL_HEIGHT: Final = Topic(
    name='/arm/tool_height',
    msgtype='std_msgs/msg/Float64',
    unit='m',
    frame_id='support_plane',
    rate_hz=(50.0, 500.0),
    required=True,
    stamped=False,
    qos=Qos(publish_depth=500, subscribe_depth=500),
    meaning="Height of the tool tip above the support plane, from the arm's own encoders.",
)
POINTS: Final = Topic(
    name='/range_sensor/points',
    msgtype='sensor_msgs/msg/PointCloud2',
    unit='m',
    frame_id='support_plane',
    rate_hz=(5.0, 30.0),
    required=False,
    stamped=True,
    qos=Qos(publish_depth=5, subscribe_depth=15),
    meaning="The range sensor's cloud, organised or not; float32 x, y, z, any other fields, any "
    'point_step, NaN or Inf for no return (REP-117).',
)
DISPLACEMENT_HEIGHT: Final = Topic(
    name='/object/displacement_height',
    msgtype='std_msgs/msg/Float64',
    unit='m',
    frame_id='support_plane',
    rate_hz=(5.0, 30.0),
    required=False,
    stamped=False,
    qos=Qos(publish_depth=30, subscribe_depth=30),
    meaning="The paper's displacement height H: original height minus height now, at the contact "
    'point; positive when pressed in.',
)
PUSH_VELOCITY: Final = Topic(
    name='/arm/push_velocity',
    msgtype='std_msgs/msg/Float64',
    unit='m/s',
    frame_id='-',
    rate_hz=None,
    required=False,
    stamped=False,
    qos=Qos(durability='transient_local', publish_depth=1, subscribe_depth=10),
    meaning='Commanded speed along the push, positive toward the object.',
)
PHASE: Final = Topic(
    name='/experiment/phase',
    msgtype='std_msgs/msg/String',
    unit='-',
    frame_id='-',
    rate_hz=None,
    required=False,
    stamped=False,
    qos=Qos(durability='transient_local', publish_depth=1, subscribe_depth=10),
    meaning='What the arm is told to do: approach, push, hold, release, recover, done or aborted. '
    'The fitter never trusts it over the signals.',
)

TOPICS: Final = (WRENCH, TOOL_HEIGHT, POINTS, DISPLACEMENT_HEIGHT, PUSH_VELOCITY, PHASE)
"""The topics of the bag contract."""


def _cell_topic(name: str, msgtype: str, unit: str, frame_id: str, meaning: str) -> Topic:
    """Return a topic that the nodes exchange beside the contract's: latched, sent on change."""
    return Topic(
        name=name,
        msgtype=msgtype,
        unit=unit,
        frame_id=frame_id,
        rate_hz=None,
        required=False,
        stamped=frame_id != '-',
        qos=Qos(durability='transient_local', publish_depth=1, subscribe_depth=10),
        meaning=meaning,
    )


CONTACT_POINT: Final = _cell_topic(
    '/planner/contact_point',
    'geometry_msgs/msg/PointStamped',
    'm',
    'support_plane',
    "The paper's P_c: where the vertical through the top view's mass centre meets the surface.",
)
PUSH_DIRECTION: Final = _cell_topic(
    '/planner/push_direction',
    'geometry_msgs/msg/Vector3Stamped',
    '-',
    'support_plane',
    'Unit vector along which the tool pushes.',
)
VIEWPOINT: Final = _cell_topic(
    '/planner/viewpoint',
    'geometry_msgs/msg/PoseStamped',
    'm',
    'support_plane',
    "The paper's V_O: from where a range sensor sees the dent, as the pose of its optical frame, "
    'z towards the contact point and y down.',
)
OBJECT_POSE: Final = _cell_topic(
    '/planner/object_pose',
    'geometry_msgs/msg/PoseStamped',
    'm',
    'support_plane',
    "The object's pose at its centre of gravity: x along its line of symmetry L, z up.",
)
OBJECT: Final = _cell_topic(
    '/planner/object',
    'diagnostic_msgs/msg/DiagnosticStatus',
    '-',
    '-',
    'What the planner found out about the object and the push, or why it refused.',
)
SHAPE: Final = _cell_topic(
    '/planner/shape',
    'sensor_msgs/msg/PointCloud2',
    'm',
    'support_plane',
    "The object's surface, merged from all views.",
)
SENSOR_POSE: Final = Topic(
    name='/range_sensor/pose',
    msgtype='geometry_msgs/msg/PoseStamped',
    unit='m',
    frame_id='support_plane',
    rate_hz=(1.0, 500.0),
    required=False,
    stamped=True,
    qos=Qos(publish_depth=10, subscribe_depth=100),
    meaning='Where a range sensor on the wrist is: the pose of the frame that its clouds are in, '
    'for an arm that sends no tf.',
)
DETECTED_PHASE: Final = _cell_topic(
    '/segmenter/phase',
    'std_msgs/msg/String',
    '-',
    '-',
    'The phase found from the signals alone: approach, push, hold, release or recover.',
)
CONTACT_TIME: Final = _cell_topic(
    '/segmenter/contact_time', 'std_msgs/msg/Float64', 's', '-', 'T_c since the epoch.'
)
HOLD_TIME: Final = _cell_topic(
    '/segmenter/hold_time', 'std_msgs/msg/Float64', 's', '-', 'T_s since the epoch.'
)
RELEASE_TIME: Final = _cell_topic(
    '/segmenter/release_time', 'std_msgs/msg/Float64', 's', '-', 'T_e since the epoch.'
)
K1: Final = _cell_topic(
    '/rheology/k1', 'std_msgs/msg/Float64', 'N/m', '-', 'Elastic coefficient K1 of the last trial.'
)
C1: Final = _cell_topic(
    '/rheology/c1', 'std_msgs/msg/Float64', 'N.s/m', '-', 'Viscosity C1 of the last trial.'
)
C2: Final = _cell_topic(
    '/rheology/c2', 'std_msgs/msg/Float64', 'N.s/m', '-', 'Viscosity C2 of the last trial.'
)
RHEOLOGY_RESULT: Final = _cell_topic(
    '/rheology/result',
    'diagnostic_msgs/msg/DiagnosticStatus',
    '-',
    '-',
    'All estimates of the last trial with standard errors, or the reasons why there are none: '
    "those of the paper's method, and, with `whole.` before their names, those of the "
    'three-element model fitted to the whole waveform.',
)
EXPERIMENT_STATUS: Final = _cell_topic(
    '/experiment/status',
    'action_msgs/msg/GoalStatusArray',
    '-',
    '-',
    "State of the experiment's goals, as an action server tells it.",
)
EXPERIMENT_FEEDBACK: Final = _cell_topic(
    '/experiment/feedback',
    'diagnostic_msgs/msg/DiagnosticStatus',
    '-',
    '-',
    'Progress of the running experiment: trial, number of trials, phase, time left; of an '
    'autonomous one also what was found and why the trial was chosen.',
)
EXPERIMENT_RESULT: Final = _cell_topic(
    '/experiment/result',
    'diagnostic_msgs/msg/DiagnosticStatus',
    '-',
    '-',
    'How the last experiment ended, and where its bags are; of an autonomous one also why it '
    'went no further, and the last diagnosis.',
)
HEARTBEAT: Final = Topic(
    name='/experiment/heartbeat',
    msgtype='std_msgs/msg/Float64',
    unit='s',
    frame_id='-',
    rate_hz=(5.0, 20.0),
    required=False,
    stamped=False,
    qos=Qos(publish_depth=1, subscribe_depth=1),
    meaning='Who watches over the pushes is alive: seconds since it began. A push goes on only '
    'while it is heard, and ends where it is another than before.',
)
EMERGENCY_STOP: Final = _cell_topic(
    '/emergency_stop',
    'std_msgs/msg/Bool',
    '-',
    '-',
    'True stops and retracts the tool and forbids motion; false releases the stop, after which '
    'motion has to be allowed again. Heard from a publisher of any quality of service.',
)
PUSH_REPORT: Final = _cell_topic(
    '/arm/push_report',
    'diagnostic_msgs/msg/DiagnosticStatus',
    '-',
    '-',
    'How the last push ended: why it was aborted, peak force, overshoot beyond the limit, depth, '
    'hold and relaxation time.',
)

CELL_TOPICS: Final = (
    CONTACT_POINT,
    PUSH_DIRECTION,
    VIEWPOINT,
    OBJECT_POSE,
    OBJECT,
    SHAPE,
    SENSOR_POSE,
    DETECTED_PHASE,
    CONTACT_TIME,
    HOLD_TIME,
    RELEASE_TIME,
    K1,
    C1,
    C2,
    RHEOLOGY_RESULT,
    EXPERIMENT_STATUS,
    EXPERIMENT_FEEDBACK,
    EXPERIMENT_RESULT,
    HEARTBEAT,
    EMERGENCY_STOP,
    PUSH_REPORT,
)
"""What the nodes of a cell exchange beside the bag contract."""


@dataclass(frozen=True, slots=True)
class Service:
    """
    One service of the cell.

    Parameters
    ----------
    name : str
        Full name, without a namespace.
    srvtype : str
        ROS type, ``package/srv/Name``.
    meaning : str
        One sentence for the documentation.

    """

    name: str
    srvtype: str
    meaning: str


TARE: Final = Service(
    '/load_cell_driver/tare', 'std_srvs/srv/Trigger', 'Take the present load as zero.'
)
PLAN: Final = Service(
    '/contact_point_planner/plan',
    'std_srvs/srv/Trigger',
    'Choose contact point, push direction and viewpoint from the views that were kept, or else '
    'from the next clouds.',
)
ADD_VIEW: Final = Service(
    '/contact_point_planner/add_view',
    'std_srvs/srv/Trigger',
    'Keep the next clouds, with the pose of their sensor, for the next plan.',
)
CLEAR_VIEWS: Final = Service(
    '/contact_point_planner/clear_views',
    'std_srvs/srv/Trigger',
    'Forget the views that were kept.',
)
ENABLE: Final = Service(
    '/arm_push_controller/enable',
    'std_srvs/srv/SetBool',
    'Allow or forbid motion; forbidding stops a running push and retracts.',
)
PUSH: Final = Service(
    '/arm_push_controller/start',
    'std_srvs/srv/Trigger',
    "Run one push with the controller's present parameters; refused unless enabled.",
)
STOP: Final = Service(
    '/arm_push_controller/stop', 'std_srvs/srv/Trigger', 'Stop the push and retract.'
)
RETRACT: Final = Service(
    '/arm_push_controller/retract',
    'std_srvs/srv/Trigger',
    'Raise a tool that was left low; refused unless enabled, and agreed to once the tool is up.',
)
FIT: Final = Service(
    '/rheology_fitter/fit',
    'std_srvs/srv/Trigger',
    'Fit what has been received since the last trial began, without waiting for its end.',
)
RESET: Final = Service(
    '/rheology_fitter/reset', 'std_srvs/srv/Trigger', 'Forget what has been received.'
)
ENABLE_EXPERIMENT: Final = Service(
    '/experiment/enable',
    'std_srvs/srv/SetBool',
    'Allow the next start to move the arm, or forbid it; forbidding cancels a running goal.',
)
START_EXPERIMENT: Final = Service(
    '/experiment/start',
    'std_srvs/srv/Trigger',
    "Send a goal: the grid in the orchestrator's present parameters, with `autonomous` also the "
    "pushes that the analysis asks for; refused unless enabled; answers with the goal's id.",
)
CANCEL_EXPERIMENT: Final = Service(
    '/experiment/cancel', 'action_msgs/srv/CancelGoal', 'Cancel the running goal.'
)

SERVICES: Final = (
    TARE,
    PLAN,
    ADD_VIEW,
    CLEAR_VIEWS,
    ENABLE,
    PUSH,
    STOP,
    RETRACT,
    FIT,
    RESET,
    ENABLE_EXPERIMENT,
    START_EXPERIMENT,
    CANCEL_EXPERIMENT,
)

PHASES: Final = ('approach', 'push', 'hold', 'release', 'recover', 'done', 'aborted')

PROVENANCE: Final = 'provenance'
"""
Name of the MCAP metadata record that tells where the data come from: a map of texts.

``displacement_source: tool`` in it says that one recorded displacement serves as both the tool's
and the object's.
"""

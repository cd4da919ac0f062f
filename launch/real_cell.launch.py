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
Start the seven nodes with real devices, and a watchdog over joints that take velocities.

``ros2 launch hapticvision_ros real_cell.launch.py load_cell:=net_ft range_sensor:=depth
arm:=twist params:=my_cell.yaml``; doc/installation.md goes through it.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    OpaqueFunction,
    SetEnvironmentVariable,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'hapticvision_ros'
NODES = (
    'range_sensor_driver',
    'load_cell_driver',
    'arm_push_controller',
    'contact_point_planner',
    'phase_segmenter',
    'rheology_fitter',
    'experiment_orchestrator',
)
WATCHDOG = 'velocity_watchdog'
BACKENDS = (
    ('load_cell', 'load_cell_driver', ('net_ft', 'serial', 'simulated'), 'load cell'),
    ('range_sensor', 'range_sensor_driver', ('points', 'depth', 'simulated'), 'range sensor'),
    ('arm', 'arm_push_controller', ('twist', 'velocity', 'simulated'), 'arm'),
)
ARGUMENTS = (
    ('params', '', 'ROS parameter files for every node, between commas; the last one wins.'),
    ('namespace', '', 'Namespace of all nodes and topics.'),
    ('autostart', 'true', 'Whether the push controller connects to the arm by itself.'),
    ('restarts', '5', 'How often a node that has ended is started again.'),
    ('port', '47111', 'UDP port on loopback of a simulated world that runs already.'),
    ('local', 'true', 'Whether all traffic stays on this machine.'),
    ('enclave', '', 'SROS2 enclave above those of the nodes, such as /hapticvision.'),
)
RESTART_DELAY = 1.0


def own_parameters(context):
    """Return what the arguments set, by node."""
    chosen = {
        node: LaunchConfiguration(argument).perform(context) for argument, node, _, _ in BACKENDS
    }
    values = {node: {'backend': backend} for node, backend in chosen.items()}
    port = int(LaunchConfiguration('port').perform(context))
    for node, backend in chosen.items():
        if backend == 'simulated':
            values[node]['simulated_world_port'] = port
    autostart = LaunchConfiguration('autostart').perform(context).lower() in ('true', '1')
    values['arm_push_controller']['autostart'] = autostart
    # No world puts a new sample under the tool: the pause between trials is for that.
    values['experiment_orchestrator'] = {'simulated_world_port': 0}
    return values


def nodes(context):
    """Return the nodes, with what the arguments say."""
    own = own_parameters(context)
    files = [
        name.strip()
        for name in LaunchConfiguration('params').perform(context).split(',')
        if name.strip()
    ]
    enclave = LaunchConfiguration('enclave').perform(context).rstrip('/')
    joints = own['arm_push_controller']['backend'] == 'velocity'
    return [
        Node(
            package=PACKAGE,
            executable=name,
            # Named, so that what the arguments say goes before what the files say.
            name=name,
            namespace=LaunchConfiguration('namespace'),
            parameters=[*files, *([own[name]] if name in own else [])],
            ros_arguments=['--enclave', f'{enclave}/{name}'] if enclave else [],
            output='screen',
            # The others make the cell safe meanwhile: a node that comes back goes on from there.
            respawn=True,
            respawn_delay=RESTART_DELAY,
            respawn_max_retries=int(LaunchConfiguration('restarts').perform(context)),
        )
        for name in (*NODES, *([WATCHDOG] if joints else []))
    ]


def generate_launch_description():
    """Return what is started."""
    profile = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'fastdds_profile.xml'])
    local = GroupAction(
        [
            SetEnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST'),
            SetEnvironmentVariable('FASTRTPS_DEFAULT_PROFILES_FILE', profile),
        ],
        condition=IfCondition(LaunchConfiguration('local')),
        scoped=False,
    )
    # A node that finds nothing said of it discovers on this machine only.
    subnet = SetEnvironmentVariable(
        'ROS_AUTOMATIC_DISCOVERY_RANGE',
        EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='SUBNET'),
        condition=UnlessCondition(LaunchConfiguration('local')),
    )
    return LaunchDescription(
        [
            # Without defaults: which devices there are is for a person to say.
            *(
                DeclareLaunchArgument(
                    argument, choices=list(choices), description=f'What the {device} is.'
                )
                for argument, _, choices, device in BACKENDS
            ),
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS
            ),
            local,
            subnet,
            OpaqueFunction(function=nodes),
        ]
    )

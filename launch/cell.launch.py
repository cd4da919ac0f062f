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
Start the seven nodes of the cell, and the simulated world unless ``sim:=false``.

``ros2 launch hapticvision_ros cell.launch.py object:=dough namespace:=cell1``
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

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
NEEDS_WORLD = (
    'range_sensor_driver',
    'load_cell_driver',
    'arm_push_controller',
    'experiment_orchestrator',
)
ARGUMENTS = (
    ('sim', 'true', 'Whether to start the simulated world.'),
    ('object', 'soft_dough', 'The simulated object, by its name in config/sim_world.yaml.'),
    ('port', '47111', 'UDP port of the simulated world on loopback.'),
    ('namespace', '', 'Namespace of all nodes and topics.'),
    ('params', '', 'A ROS parameter file that is given to every node.'),
    ('local', 'true', 'Whether all traffic stays on this machine.'),
)


def nodes(context):
    """Return the nodes, with what the arguments say."""
    params = LaunchConfiguration('params').perform(context)
    port = int(LaunchConfiguration('port').perform(context))
    actions = []
    for name in NODES:
        parameters = [params] if params else []
        if name in NEEDS_WORLD:
            parameters.append({'simulated_world_port': port})
        actions.append(
            Node(
                package=PACKAGE,
                executable=name,
                namespace=LaunchConfiguration('namespace'),
                parameters=parameters,
                output='screen',
                # A cell that lacks a node is no cell.
                on_exit=Shutdown(reason=f'{name} has ended'),
            )
        )
    return actions


def generate_launch_description():
    """Return what is started."""
    world = ExecuteProcess(
        cmd=[
            ExecutableInPackage('simulated_world', PACKAGE),
            '--object',
            LaunchConfiguration('object'),
            '--port',
            LaunchConfiguration('port'),
        ],
        condition=IfCondition(LaunchConfiguration('sim')),
        output='screen',
        on_exit=Shutdown(reason='the simulated world has ended'),
    )
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
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS
            ),
            local,
            subnet,
            world,
            OpaqueFunction(function=nodes),
        ]
    )

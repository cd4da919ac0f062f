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
Play a bag through the phase segmenter and the rheology fitter, and show the fitter's result.

``ros2 launch hapticvision_ros replay.launch.py bag:=/path/to/bag rate:=2.0``
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage

PACKAGE = 'hapticvision_ros'
ARGUMENTS = (
    ('rate', '1.0', 'How many times faster than recorded.'),
    ('displacement_from_points', 'false', 'Whether the bag has clouds but no displacement.'),
    ('displacement_source', 'object', "Whether the displacement is the object's or the tool's."),
)


def generate_launch_description():
    """Return what is started."""
    simulated = {'use_sim_time': True, 'exact_replay': True}
    fitter = {
        **simulated,
        'displacement_from_points': LaunchConfiguration('displacement_from_points'),
        'displacement_source': LaunchConfiguration('displacement_source'),
    }
    player = ExecuteProcess(
        cmd=[
            ExecutableInPackage('bag_player', PACKAGE),
            LaunchConfiguration('bag'),
            '--rate',
            LaunchConfiguration('rate'),
            '--fit',
        ],
        output='screen',
        on_exit=Shutdown(reason='the bag has been played'),
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument('bag', description='A bare .mcap or a rosbag2 directory.'),
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS
            ),
            Node(
                package=PACKAGE,
                executable='phase_segmenter',
                parameters=[simulated],
                output='screen',
            ),
            Node(
                package=PACKAGE,
                executable='rheology_fitter',
                parameters=[fitter],
                output='screen',
            ),
            player,
        ]
    )

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

"""``hapticvision replay``: play a bag through the real nodes, and see what they make of it."""

import argparse
import math
from pathlib import Path

from hapticvision_ros.cli.processes import node, program, ros_environment, Supervisor
from hapticvision_ros.core.errors import UsageError

HIGHEST_DOMAIN = 232
PLAYER = 'bag_player'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        'bag', type=Path, metavar='BAG', help='a bare .mcap or a rosbag2 directory'
    )
    parser.add_argument(
        '--rate',
        type=float,
        default=1.0,
        metavar='R',
        help='play R times faster than recorded (default: 1)',
    )
    parser.add_argument(
        '--play-only',
        action='store_true',
        help='only publish, for nodes of your own; without it the phase segmenter and the '
        'rheology fitter are started and the result is printed',
    )
    parser.add_argument('--domain', type=int, metavar='ID', help='ROS domain')


def run(args: argparse.Namespace) -> int:
    """Play the bag and return the exit code."""
    if not (math.isfinite(args.rate) and args.rate > 0.0):
        raise UsageError(f'--rate is {args.rate:g}: give a number above zero.')
    check_domain(args.domain)
    from hapticvision_ros.bag.contract import DISPLACEMENT_HEIGHT, POINTS
    from hapticvision_ros.bag.playback import Playback

    playback = Playback(args.bag)
    options = [str(args.bag), '--rate', repr(args.rate)]
    with Supervisor(ros_environment(args.domain)) as supervisor:
        if not args.play_only:
            simulated = ['--ros-args', '-p', 'use_sim_time:=true', '-p', 'exact_replay:=true']
            from_points = DISPLACEMENT_HEIGHT not in playback.topics and POINTS in playback.topics
            source = playback.provenance.get('displacement_source', '')
            fitter = [
                *simulated,
                '-p',
                f'displacement_from_points:={str(from_points).lower()}',
                '-p',
                f'displacement_source:={"tool" if source == "tool" else "object"}',
            ]
            supervisor.start(
                {
                    'phase_segmenter': node('phase_segmenter', *simulated),
                    'rheology_fitter': node('rheology_fitter', *fitter),
                }
            )
            options.append('--fit')
        supervisor.start(
            {PLAYER: program(f'hapticvision_ros.nodes.{PLAYER}', *options)}, labelled=False
        )
        return supervisor.wait(PLAYER)


def check_domain(domain: int | None) -> None:
    """Refuse a ROS domain that does not exist."""
    if domain is not None and not 0 <= domain <= HIGHEST_DOMAIN:
        raise UsageError(f'--domain is {domain}: a ROS domain lies in 0 to {HIGHEST_DOMAIN}.')

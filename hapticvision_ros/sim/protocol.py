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
What the simulated world and its devices say to each other, in datagrams on loopback.

A device asks in JSON; the world answers requests in JSON and streams readings as packed structs,
whose first byte is zero and so never looks like JSON.
"""

from collections.abc import Mapping
import json
import struct
from typing import Final

LOOPBACK: Final = '127.0.0.1'
LEASE: Final = 3.0
"""A stream ends when its device has not renewed it for this time [s]."""

FORCE: Final = 'force'
ARM: Final = 'arm'
SHAPE: Final = 'shape'
STREAMS: Final = (FORCE, ARM, SHAPE)

FORCE_PACKET: Final = struct.Struct('<xQ6d')
"""Stamp [ns], force [N] and torque [N.m]."""
ARM_PACKET: Final = struct.Struct('<xQd')
"""Stamp [ns] and tool height [m]."""
SHAPE_PACKET: Final = struct.Struct('<xQdd')
"""
Stamp [ns], tool height [m] and depth of the dent [m]; of a soft body the positions of its nodes
follow, as numbers of `POINT` [m].
"""
POINT: Final = '<f4'
"""A coordinate of a node."""

MAX_DATAGRAM: Final = 65507
"""What UDP carries on loopback [bytes]."""

type Message = Mapping[str, object]


def encode(message: Message) -> bytes:
    """Return a message as a datagram."""
    return json.dumps(message).encode()


def decode(datagram: bytes) -> Message | None:
    """Return the message in a datagram, or None if there is none."""
    if not datagram.startswith(b'{'):
        return None
    try:
        message = json.loads(datagram)
    except ValueError:
        return None
    return message if isinstance(message, dict) else None

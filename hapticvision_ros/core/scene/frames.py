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

"""Coordinate frames that hang together (REP-105): where one is in another, at some time."""

from collections import deque
from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.scene.views import Pose

_KEPT: Final = 2000
"""Poses of a moving frame that are kept: some seconds at the rates of arms."""
_MOST_LINKS: Final = 100


@dataclass(frozen=True, slots=True)
class _Link:
    parent: str
    stamp_ns: int | None
    pose: Pose


class FrameTree:
    """What is known of the frames of a cell."""

    def __init__(self) -> None:
        self._links: dict[str, deque[_Link]] = {}

    def put(self, parent: str, child: str, pose: Pose, stamp_ns: int | None) -> None:
        """
        Take one transform.

        Parameters
        ----------
        parent, child : str
            Frames.
        pose : Pose
            Of the child in the parent.
        stamp_ns : int or None
            When [ns since the epoch]; None if it holds always.

        """
        links = self._links.setdefault(child.removeprefix('/'), deque(maxlen=_KEPT))
        link = _Link(parent.removeprefix('/'), stamp_ns, pose)
        if stamp_ns is None or (links and links[-1].stamp_ns is None):
            links.clear()
        links.append(link)

    def pose(self, frame: str, base: str, stamp_ns: int, age_ns: int) -> Pose | None:
        """
        Return where a frame is in another.

        Parameters
        ----------
        frame, base : str
            Frames.
        stamp_ns : int
            When [ns since the epoch].
        age_ns : int
            A moving frame's pose may be this far from then [ns].

        Returns
        -------
        Pose or None
            None if the frames do not hang together, or not at that time.

        """
        to_frame = self._to_root(frame.removeprefix('/'), stamp_ns, age_ns)
        to_base = self._to_root(base.removeprefix('/'), stamp_ns, age_ns)
        common = next((name for name in to_frame if name in to_base), None)
        if common is None:
            return None
        return to_base[common].inverse().after(to_frame[common])

    def _to_root(self, frame: str, stamp_ns: int, age_ns: int) -> dict[str, Pose]:
        """Return the frame's poses in each of its ancestors, the nearest first."""
        poses = {frame: Pose.identity()}
        pose, name = poses[frame], frame
        for _ in range(_MOST_LINKS):
            link = self._at(name, stamp_ns, age_ns)
            if link is None or link.parent in poses:
                break
            pose, name = link.pose.after(pose), link.parent
            poses[name] = pose
        return poses

    def _at(self, child: str, stamp_ns: int, age_ns: int) -> _Link | None:
        links = self._links.get(child)
        if not links:
            return None
        if links[-1].stamp_ns is None:
            return links[-1]
        nearest = min(links, key=lambda link: abs((link.stamp_ns or 0) - stamp_ns))
        return nearest if abs((nearest.stamp_ns or 0) - stamp_ns) <= age_ns else None

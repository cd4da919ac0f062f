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

"""Clouds and depth images of a range sensor, brought into the frame `support_plane`."""

from dataclasses import dataclass
from math import isfinite
import sys
from typing import Final

import cv2
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
from hapticvision_ros.devices.mounting import Pose
import numpy as np
from numpy.typing import NDArray

type DepthArray = NDArray[np.uint16] | NDArray[np.float32]

_COEFFICIENTS: Final = (4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV knows."""

_ZERO: Final = 1e-6
"""A point so near to the origin of its cloud [m] is how some drivers tell that there is none."""
_FORMATS: Final = {'16UC1': 'u2', 'mono16': 'u2', '32FC1': 'f4'}


@dataclass(frozen=True, slots=True)
class Camera:
    """
    A depth camera's intrinsics, as ``sensor_msgs/msg/CameraInfo`` has them.

    Parameters
    ----------
    width, height : int
        Size of the image [pixels].
    matrix : tuple of float
        fx, fy, cx, cy [pixels].
    model : str
        Distortion model.
    distortion : tuple of float
        Its coefficients; empty or all zero for a rectified image.

    """

    width: int
    height: int
    matrix: tuple[float, float, float, float]
    model: str = 'plumb_bob'
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        fx, fy, _, _ = self.matrix
        finite = all(map(isfinite, (*self.matrix, *self.distortion)))
        if not (finite and self.width > 0 and self.height > 0 and fx > 0.0 and fy > 0.0):
            raise InputError(
                'The camera is not calibrated (its CameraInfo has no size, no focal '
                'length, or what is no number): '
                'calibrate it, or name another camera_info topic.'
            )
        if any(self.distortion) and self.model not in ('plumb_bob', 'rational_polynomial'):
            raise InputError(
                f"The camera's distortion model is {self.model!r}, but plumb_bob and "
                'rational_polynomial are known: use the rectified depth image.'
            )
        if self.distortion and len(self.distortion) not in _COEFFICIENTS:
            raise InputError(
                f"The camera's distortion has {len(self.distortion)} coefficients, where "
                'plumb_bob has 5 and rational_polynomial 8: calibrate it again.'
            )


def rays_of(camera: Camera) -> PointArray:
    """
    Return the direction in which each pixel looks.

    Parameters
    ----------
    camera : Camera
        The intrinsics.

    Returns
    -------
    ndarray of float32, shape (height, width, 3)
        Points at depth 1 m in the camera's optical frame (z forward, x right, y down; REP-103).

    """
    fx, fy, cx, cy = camera.matrix
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    if any(camera.distortion):
        pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        plane = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion))
        x, y = np.moveaxis(plane.reshape(camera.height, camera.width, 2), -1, 0)
    else:
        x, y = (u - cx) / fx, (v - cy) / fy
    return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)


def depth_view(
    data: bytes | bytearray | memoryview,
    *,
    encoding: str,
    width: int,
    height: int,
    step: int,
    is_bigendian: bool,
) -> DepthArray:
    """
    Return the pixels of a ``sensor_msgs/msg/Image`` with depths, without a copy.

    Parameters
    ----------
    data : bytes
        The image's data.
    encoding : str
        ``16UC1`` or ``mono16`` (millimetres) or ``32FC1`` (metres), as REP-118 has it.
    width, height, step : int
        Pixels in a row, rows, and bytes from row to row.
    is_bigendian : bool
        Byte order of the pixels.

    Raises
    ------
    InputError
        If the encoding is another, or there are fewer bytes than the sizes ask for.

    """
    code = _FORMATS.get(encoding)
    if code is None:
        raise InputError(
            f'The depth image is encoded as {encoding!r}, but 16UC1 (mm) or 32FC1 (m) is needed: '
            'name the raw depth image, not a compressed or coloured one.'
        )
    dtype = np.dtype(('>' if is_bigendian else '<') + code)
    row = width * dtype.itemsize
    step = step or row
    if not (width and height) or step < row or len(data) < (height - 1) * step + row:
        raise InputError(
            f'A depth image of {width} x {height} pixels holds {len(data)} bytes with a step of '
            f'{step}: the message was cut off.'
        )
    pixels: DepthArray = np.ndarray((height, width), dtype, data, 0, (step, dtype.itemsize))
    if is_bigendian != (sys.byteorder == 'big'):
        pixels = pixels.astype(dtype.newbyteorder('='))
    return pixels


class Deprojector:
    """
    Turns depth images of one camera into points in the frame `support_plane`.

    The rays are turned once; a frame is then one product and one sum for each coordinate.

    Parameters
    ----------
    camera : Camera
        The intrinsics.
    pose : Pose
        The camera's optical frame in `support_plane`.
    nearest, farthest : float
        Depths outside this range are no return [m].

    """

    def __init__(self, camera: Camera, pose: Pose, nearest: float, farthest: float) -> None:
        turned = rays_of(camera) @ pose.rotation.T.astype(np.float32)
        # One coordinate after the other is twice as fast as all three of each pixel.
        self._rays = np.ascontiguousarray(np.moveaxis(turned, -1, 0), dtype=np.float32)
        self._origin = pose.translation.astype(np.float32)
        # Zero is no return (REP-118), however near a return may be.
        self._nearest = max(nearest, float(np.finfo(np.float32).tiny))
        self._farthest = farthest

    def points(self, depth: DepthArray) -> PointArray:
        """
        Return the points of a depth image.

        Parameters
        ----------
        depth : ndarray of uint16 or float32, shape (height, width)
            Depths along the optical axis in mm or m; 0, NaN and Inf are no return.

        Returns
        -------
        ndarray of float32, shape (height, width, 3)
            Points [m] in `support_plane`; NaN is no return.

        Raises
        ------
        InputError
            If the image has another size than the camera.

        """
        if depth.shape != self._rays.shape[1:]:
            raise InputError(
                f'A depth image has {depth.shape[1]} x {depth.shape[0]} pixels, its CameraInfo '
                f'{self._rays.shape[2]} x {self._rays.shape[1]}: they belong to different streams.'
            )
        scale = np.float32(0.001 if depth.dtype.kind == 'u' else 1.0)
        metres = depth * scale
        metres[~((metres >= self._nearest) & (metres <= self._farthest))] = np.nan
        points = np.empty((*depth.shape, 3), np.float32)
        for axis in range(3):
            coordinate = points[..., axis]
            np.multiply(metres, self._rays[axis], out=coordinate)
            coordinate += self._origin[axis]
        return points


class CloudMover:
    """
    Brings clouds from the sensor's frame into `support_plane`.

    Parameters
    ----------
    pose : Pose
        The sensor's frame in `support_plane`.
    nearest, farthest : float
        Points at a distance from the sensor outside this range are no return [m]. A cloud that is
        in `support_plane` already (the pose is that of the plane itself) does not tell where its
        sensor is, and the object lies about its origin: then no point is too near.

    """

    def __init__(self, pose: Pose, nearest: float, farthest: float) -> None:
        self._affine = np.column_stack([pose.rotation, pose.translation]).astype(np.float32)
        if np.array_equal(self._affine, np.eye(3, 4)):
            nearest = 0.0
        # Some drivers write zeros where nothing came back.
        self._nearest2, self._farthest2 = max(nearest, _ZERO) ** 2, farthest**2

    def points(self, xyz: PointArray) -> PointArray:
        """
        Return a cloud in `support_plane`.

        Parameters
        ----------
        xyz : ndarray of float32, shape (height, width, 3)
            Points [m] in the sensor's frame; what is not finite is no return.

        Returns
        -------
        ndarray of float32, shape (height, width, 3)
            Points [m] in `support_plane`; NaN is no return.

        """
        cloud = np.ascontiguousarray(xyz)
        # One coordinate after the other is several times as fast as all three of each point.
        with np.errstate(over='ignore', invalid='ignore'):
            distance2 = cloud[..., 0] ** 2 + cloud[..., 1] ** 2 + cloud[..., 2] ** 2
        # A comparison is false for NaN, and infinite points are too far.
        missing = ~((distance2 >= self._nearest2) & (distance2 <= self._farthest2))
        moved: PointArray = cv2.transform(cloud, self._affine)
        for axis in range(3):
            np.copyto(moved[..., axis], np.nan, where=missing)
        return moved


def share_of_returns(xyz: PointArray) -> float:
    """Return which share of a cloud's points is a return."""
    z: FloatArray | PointArray = xyz[..., 2]
    return float(np.isfinite(z).mean()) if z.size else 0.0

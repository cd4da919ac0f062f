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
An animation as a GIF file, written out here: no package that the rest asks for can do it.

References
----------
Graphics Interchange Format, version 89a, CompuServe, 1990; T. A. Welch, Computer 17, 1984, 8-19,
doi:10.1109/MC.1984.1659158 (the compression).

"""

from collections.abc import Iterable
from itertools import batched
import struct
from typing import Final

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.surface.mesh import ColourArray
import numpy as np
from numpy.typing import NDArray

_MOST_CODES: Final = 4096
_BLOCK: Final = 255


def gif(
    pictures: Iterable[NDArray[np.uint8]], colours: ColourArray, seconds: float = 0.08
) -> bytes:
    """
    Return an animation that runs for ever.

    Parameters
    ----------
    pictures : iterable of ndarray of uint8, shape (height, width)
        At least one; rows of `colours`.
    colours : ndarray of uint8, shape (256, 3)
        Red, green and blue.
    seconds : float
        How long each picture stays, in hundredths of a second at least [s].

    Returns
    -------
    bytes
        The file's content. Of each picture but the first only the rectangle is stored in which
        it differs from the one before.

    """
    delay = max(round(100.0 * seconds), 2)
    parts: list[bytes] = []
    last: NDArray[np.uint8] | None = None
    for picture in pictures:
        top, left, bottom, right = 0, 0, *picture.shape
        if last is None:
            parts += [
                b'GIF89a',
                struct.pack('<HHBBB', right, bottom, 0xF7, 0, 0),
                colours.tobytes(),
                b'\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00',
            ]
        else:
            rows = np.flatnonzero((picture != last).any(axis=1))
            columns = np.flatnonzero((picture != last).any(axis=0))
            if rows.size:
                top, bottom = int(rows[0]), int(rows[-1]) + 1
                left, right = int(columns[0]), int(columns[-1]) + 1
            else:
                bottom, right = 1, 1
        last = picture
        parts.append(struct.pack('<BBBBHBB', 0x21, 0xF9, 4, 0x04, delay, 0, 0))
        parts.append(struct.pack('<BHHHHB', 0x2C, left, top, right - left, bottom - top, 0))
        parts.append(_compressed(np.ascontiguousarray(picture[top:bottom, left:right])))
    if last is None:
        raise ValueError('an animation has at least one picture')
    return b''.join([*parts, b'\x3b'])


def _compressed(picture: NDArray[np.uint8]) -> bytes:
    """Return the data of a picture: the size of a code, blocks, an empty one."""
    out = np.zeros(2 * picture.size + 64, np.uint8)
    data = out[: _compress(picture.ravel().astype(np.int64), out)].tobytes()
    blocks = [bytes(one) for one in batched(data, _BLOCK)]
    return b'\x08' + b''.join(bytes([len(one)]) + one for one in blocks) + b'\x00'


@kernel()
def _compress(pixels, out):  # type: ignore[no-untyped-def]
    """Write the codes of pixels, eight bits and more each; return how many bytes they take."""
    clear, end = 256, 257
    follow = np.zeros((_MOST_CODES, 256), np.int16)
    width, free = 9, 258
    held, bits, count = clear, 9, 0
    prefix = int(pixels[0])
    for k in range(1, pixels.size):
        while bits >= 8:
            out[count] = held & 255
            count += 1
            held >>= 8
            bits -= 8
        pixel = pixels[k]
        longer = follow[prefix, pixel]
        if longer:
            prefix = int(longer)
            continue
        held |= prefix << bits
        bits += width
        if free < _MOST_CODES:
            follow[prefix, pixel] = free
            # The reader is one code behind.
            if free == 1 << width:
                width += 1
            free += 1
        else:
            while bits >= 8:
                out[count] = held & 255
                count += 1
                held >>= 8
                bits -= 8
            held |= clear << bits
            bits += width
            follow[:] = 0
            width, free = 9, 258
        prefix = int(pixel)
    for code in (prefix, end):
        held |= code << bits
        bits += width
    while bits > 0:
        out[count] = held & 255
        count += 1
        held >>= 8
        bits -= 8
    return count

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


"""The messages of one topic on their way from a bag to a trial: decoded, timed, put in order."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Final

from hapticvision_ros.bag import cdr
from hapticvision_ros.bag.cdr import BoolArray, IntArray, NS_PER_S
from hapticvision_ros.bag.clouds import BagClouds, CloudLayout, CloudReference, read_layout
from hapticvision_ros.bag.contract import PHASES, Topic
from hapticvision_ros.bag.mcap_scan import Batch, Channel, Place
from hapticvision_ros.core.records import FloatArray, Signal
import numpy as np
from numpy.typing import NDArray

CLOCK_TOLERANCE_NS: Final = 10 * NS_PER_S
"""
How far the two clocks of one message may be apart.

No latency is that long, and nobody sets clocks so badly on purpose. Beyond it a stamp is a mistake
(never set, or of a clock that counts from the sensor's start), and the streams would not line up.
"""
LONGEST_TRIAL_NS: Final = 24 * 3600 * NS_PER_S
"""A message further than this from the middle of the trial has a wrong date."""
GAP_FACTOR: Final = 10.0
"""An interval this many times the 95 % quantile of a signal's intervals is a gap."""
FEWEST_FOR_INTERVALS: Final = 20
"""With fewer samples the quantiles of the intervals say nothing."""

_SCHEMA_ENCODINGS: Final = ('ros2msg', 'ros2idl', 'unknown', '')
"""The last two: rosbag2 did not find the definition; here the type's name is enough."""

type _Payload = NDArray[Any]
"""float64 for numbers, objects for texts and clouds."""


def reconcile(stamps: IntArray, reference: IntArray) -> tuple[IntArray, int, int]:
    """
    Hold one clock of a stream's messages against another.

    Parameters
    ----------
    stamps, reference : ndarray of int64, shape (n,)
        The times by the clock to be used, and by the one to hold it against [ns since the epoch].

    Returns
    -------
    stamps : ndarray of int64, shape (n,)
        The stamps; where they were never set or are far off, the reference plus the usual
        difference of the clocks.
    offset : int
        The usual difference [ns]: the median; 0 if there is none, because the reference was never
        set or runs at another rate.
    replaced : int
        How many stamps were replaced.

    """
    replaced = (stamps == 0) & (reference > CLOCK_TOLERANCE_NS)
    no_reference = (reference == 0) & (stamps > CLOCK_TOLERANCE_NS)
    both = ~replaced & ~no_reference
    difference = stamps - reference
    known = difference[both]
    offset = 0
    if known.size:
        # Counted from the first one, the differences keep their nanoseconds in a float64.
        usual = int(known[0]) + int(np.median(known - known[0]))
        far = both & (np.abs(difference - usual) > CLOCK_TOLERANCE_NS)
        # Where most are far off, the clocks do not run alike and neither can judge the other.
        if 2 * np.count_nonzero(far) < known.size:
            offset = usual
            replaced |= far
    return np.where(replaced, reference + offset, stamps), offset, int(np.count_nonzero(replaced))


@dataclass(frozen=True, slots=True)
class Timed:
    """What a topic's usable messages hold, in order of time, with strictly increasing times."""

    t: FloatArray
    payload: _Payload


class Stream(ABC):
    """
    Collects the messages of one topic; subclasses decode them.

    Parameters
    ----------
    topic : Topic
        The topic and the type that it must have.

    Attributes
    ----------
    warnings : list of str
        What had to be left out or repaired, one sentence each.

    """

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.warnings: list[str] = []
        self._seen = 0
        self._refused: dict[str, int] = {}
        self._log: list[IntArray] = []
        self._publish: list[IntArray] = []
        self._header: list[IntArray] = []
        self._payload: list[_Payload] = []
        self._stamps = np.empty(0, np.int64)
        self._rows: _Payload = np.empty(0)

    @abstractmethod
    def decode(self, batch: Batch) -> tuple[IntArray | None, _Payload, BoolArray]:
        """Return header stamps, what the messages hold, and which of them can be read."""

    def add(self, batch: Batch) -> None:
        """Take in the messages of a batch."""
        self._seen += batch.starts.size
        reason = self._misfit(batch.channel)
        if reason is not None:
            self.refuse(reason, batch.starts.size)
            return
        header, payload, readable = self.decode(batch)
        self._log.append(batch.log_ns[readable])
        self._publish.append(batch.publish_ns[readable])
        self._payload.append(payload[readable])
        if header is not None:
            self._header.append(header[readable])

    def refuse(self, reason: str, count: int) -> None:
        """Remember why some messages are left out."""
        if count:
            self._refused[reason] = self._refused.get(reason, 0) + count

    def why_empty(self) -> str:
        """Return why there is nothing to use on this topic."""
        if self._seen == 0:
            return f'{self.topic.name} has no messages'
        if self._refused:
            reasons = ' and '.join(
                f'{count} of its {self._seen} messages {reason}'
                for reason, count in self._refused.items()
            )
            return f'{self.topic.name} cannot be used: {reasons}'
        return f'{self.topic.name} holds no finite number in {self._seen} messages'

    def settle_times(self) -> int | None:
        """
        Give every message its time, by the contract's rule.

        The header stamp counts where there is one, else the publish time; a stamp that was never
        set or is far from the message's other times is replaced.

        Returns
        -------
        middle : int or None
            The median stamp [ns since the epoch]; None if there is no message.

        """
        if not sum(part.size for part in self._log):
            return None
        log = np.concatenate(self._log)
        stamps, _, replaced = reconcile(np.concatenate(self._publish), log)
        if replaced:
            self.warn(f'{replaced} publish times are unset or absurd: the log time was used')
        if self._header:
            publish = stamps
            stamps, offset, replaced = reconcile(np.concatenate(self._header), publish)
            if replaced:
                self.warn(
                    f'{replaced} header stamps are unset or absurd: the publish time was used'
                )
            if abs(offset) > CLOCK_TOLERANCE_NS:
                stamps = stamps - offset
                self.warn(
                    f'the header stamps are {offset / NS_PER_S:.0f} s away from the publish '
                    'times: moved onto them, so that the streams line up to within the latency'
                )
        self._stamps, self._rows = stamps, np.concatenate(self._payload)
        return int(np.partition(stamps, stamps.size // 2)[stamps.size // 2])

    def keep_near(self, middle_ns: int) -> int | None:
        """
        Leave out the messages whose times cannot belong to the trial.

        Parameters
        ----------
        middle_ns : int
            A time within the trial [ns since the epoch].

        Returns
        -------
        first : int or None
            The first stamp that stays [ns since the epoch]; None if there is none.

        """
        near = np.abs(self._stamps - middle_ns) <= LONGEST_TRIAL_NS
        self.refuse('are over a day away from the trial', int(np.count_nonzero(~near)))
        self._stamps, self._rows = self._stamps[near], self._rows[near]
        for reason, count in self._refused.items():
            self.warn(f'{count} of {self._seen} messages {reason}: left out')
        return int(self._stamps.min()) if self._stamps.size else None

    def in_order(self, start_ns: int) -> Timed:
        """
        Return the usable messages in order of time, each time once.

        Parameters
        ----------
        start_ns : int
            Where the times count from [ns since the epoch].

        """
        if self._stamps.size == 0:
            return Timed(np.empty(0), np.empty(0))
        stamps, payload = self._stamps, self._rows
        if payload.dtype == np.float64:
            finite = np.isfinite(payload)
            if not finite.all():
                lost = int(np.count_nonzero(~finite))
                self.warn(f'{lost} of {finite.size} samples are NaN or infinite: left out')
                stamps, payload = stamps[finite], payload[finite]
        late = int(np.count_nonzero(stamps[1:] < np.maximum.accumulate(stamps)[:-1]))
        if late:
            self.warn(f'{late} of {stamps.size} messages are out of order: sorted by time')
            order = np.argsort(stamps, kind='stable')
            stamps, payload = stamps[order], payload[order]
        t = (stamps - start_ns) / NS_PER_S
        keep = np.ones(t.size, np.bool_)
        keep[1:] = np.diff(t) > 0.0
        if not keep.all():
            again = int(np.count_nonzero(~keep))
            self.warn(f'{again} of {t.size} messages repeat a time stamp: the first was kept')
        return Timed(t[keep], payload[keep])

    def warn(self, sentence: str) -> None:
        """Add a warning about this topic."""
        self.warnings.append(f'{self.topic.name}: {sentence}')

    def _misfit(self, channel: Channel) -> str | None:
        """Return why a channel's messages cannot be used, or None."""
        package, _, name = self.topic.msgtype.split('/')
        if channel.msgtype not in (self.topic.msgtype, f'{package}/{name}'):
            return f'hold {channel.msgtype or "no known type"} and not {self.topic.msgtype}'
        if channel.message_encoding != 'cdr':
            return f'are encoded as {channel.message_encoding!r} and not as cdr'
        if channel.schema_encoding not in _SCHEMA_ENCODINGS:
            return f'have a schema in {channel.schema_encoding!r} and not in ros2msg'
        return None

    def _refuse_unreadable(self, readable: BoolArray) -> None:
        self.refuse('are damaged or not in plain CDR', int(np.count_nonzero(~readable)))


class NumberStream(Stream):
    """Numbers over time: ``std_msgs/msg/Float64``."""

    def decode(self, batch: Batch) -> tuple[IntArray | None, _Payload, BoolArray]:
        """Return the numbers."""
        value, readable = cdr.decode_float64(batch.data, batch.starts, batch.sizes)
        self._refuse_unreadable(readable)
        return None, value, readable

    def signal(self, start_ns: int) -> Signal | None:
        """Return the numbers as a signal, or None if there is none; warn of gaps and jitter."""
        timed = self.in_order(start_ns)
        if timed.t.size == 0:
            return None
        if timed.t.size == 1 and self.topic.rate_hz is not None:
            self.warn('it has one sample only')
        # Other topics may pause: the dent is hidden while the tool is down.
        if self.topic.required and timed.t.size >= FEWEST_FOR_INTERVALS:
            self._judge_intervals(timed.t)
        return Signal(timed.t, timed.payload.astype(np.float64, copy=False))

    def _judge_intervals(self, t: FloatArray) -> None:
        intervals = np.diff(t)
        low, middle, high = np.quantile(intervals, (0.05, 0.5, 0.95))
        gaps = np.flatnonzero(intervals > GAP_FACTOR * high)
        if gaps.size:
            longest = int(np.argmax(intervals))
            self.warn(
                f'{gaps.size} {"gap" if gaps.size == 1 else "gaps"}, the longest '
                f'{intervals[longest]:.3g} s at {t[longest]:.3f} s (an interval is {middle:.3g} s)'
            )
        if high - low > middle:
            self.warn(
                f'the samples are uneven: 90 % of the intervals lie between {low:.3g} s and '
                f'{high:.3g} s'
            )


class WrenchStream(NumberStream):
    """The contact force over time: ``geometry_msgs/msg/WrenchStamped``."""

    def __init__(self, topic: Topic) -> None:
        super().__init__(topic)
        self._frame_known = False

    def decode(self, batch: Batch) -> tuple[IntArray | None, _Payload, BoolArray]:
        """Return the header stamps and the contact forces F = -force.z."""
        stamps, force, readable = cdr.decode_wrench(batch.data, batch.starts, batch.sizes)
        self._refuse_unreadable(readable)
        if not self._frame_known and readable.any():
            self._frame_known = True
            first = int(np.argmax(readable))
            start = int(batch.starts[first])
            decoder = cdr.Decoder(batch.data[start:][: int(batch.sizes[first])].data)
            decoder.stamp()
            frame_id = decoder.string()
            if frame_id != self.topic.frame_id:
                self.warn(
                    f'the force is in the frame {frame_id!r}: its z axis was taken to point along '
                    f'the push, as that of {self.topic.frame_id!r} does'
                )
        return stamps, -force[:, 2], readable


class TextStream(Stream):
    """Texts over time: ``std_msgs/msg/String``."""

    def decode(self, batch: Batch) -> tuple[IntArray | None, _Payload, BoolArray]:
        """Return the texts."""
        texts = np.full(batch.starts.size, '', np.object_)
        readable = np.zeros(batch.starts.size, np.bool_)
        for row, (start, size) in enumerate(zip(batch.starts, batch.sizes, strict=True)):
            try:
                texts[row] = cdr.decode_string(batch.data[start:][:size].data)
                readable[row] = True
            except ValueError:
                continue
        self._refuse_unreadable(readable)
        return None, texts, readable

    def phases(self, start_ns: int) -> tuple[tuple[float, str], ...]:
        """Return the phases of the contract and their times [s]."""
        timed = self.in_order(start_ns)
        found = tuple(zip(timed.t.tolist(), timed.payload.tolist(), strict=True))
        known = tuple((t, phase) for t, phase in found if phase in PHASES)
        if len(known) < len(found):
            self.warn(f'{len(found) - len(known)} texts are no phase: left out')
        return known


@dataclass(frozen=True, slots=True)
class _Cloud:
    layout: CloudLayout
    place: Place
    start: int
    size: int


class CloudStream(Stream):
    """The range sensor's frames: ``sensor_msgs/msg/PointCloud2``, left in the file."""

    def decode(self, batch: Batch) -> tuple[IntArray | None, _Payload, BoolArray]:
        """Return the header stamps and where the clouds are."""
        clouds = np.full(batch.starts.size, None, np.object_)
        stamps = np.zeros(batch.starts.size, np.int64)
        readable = np.zeros(batch.starts.size, np.bool_)
        for row, (start, size) in enumerate(
            zip(batch.starts.tolist(), batch.sizes.tolist(), strict=True)
        ):
            try:
                layout = read_layout(batch.data[start:][:size].data)
            except ValueError as error:
                self.refuse(f'cannot be used ({error})', 1)
                continue
            clouds[row] = _Cloud(layout, batch.place, start, size)
            stamps[row] = layout.stamp_ns
            readable[row] = True
        return stamps, clouds, readable

    def clouds(self, start_ns: int) -> BagClouds | None:
        """Return the frames in order of time, or None if there is none."""
        timed = self.in_order(start_ns)
        if timed.t.size == 0:
            return None
        converted = sum(not cloud.layout.native for cloud in timed.payload)
        if converted:
            self.warn(f'{converted} of {timed.t.size} clouds are converted to float32 when read')
        return BagClouds(
            [
                CloudReference(t, cloud.layout, cloud.place, cloud.start, cloud.size)
                for t, cloud in zip(timed.t.tolist(), timed.payload, strict=True)
            ]
        )

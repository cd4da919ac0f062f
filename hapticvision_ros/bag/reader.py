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
Reads a trial from a bag of the contract, in whatever state it is, without ROS.

Whatever can be read is read; what had to be left out or repaired is told in the trial's warnings,
one sentence each. Only a bag from which no trial can be made is refused.
"""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from hapticvision_ros.bag.bag_files import BagFiles, find_files
from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PROVENANCE,
    PUSH_VELOCITY,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.bag.mcap_scan import McapScanner
from hapticvision_ros.bag.streams import CloudStream, NumberStream, TextStream, WrenchStream
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import DisplacementSource, Signal, Trial


class TrialStreams:
    """The topics of the contract on their way to a trial, from a bag or from a running cell."""

    def __init__(self) -> None:
        self.force = WrenchStream(WRENCH)
        self.tool_height = NumberStream(TOOL_HEIGHT)
        self.displacement = NumberStream(DISPLACEMENT_HEIGHT)
        self.push_velocity = NumberStream(PUSH_VELOCITY)
        self.phase = TextStream(PHASE)
        self.points = CloudStream(POINTS)
        self.all = (
            self.force,
            self.tool_height,
            self.displacement,
            self.push_velocity,
            self.phase,
            self.points,
        )
        self.by_name = {stream.topic.name: stream for stream in self.all}

    def trial(
        self,
        name: str,
        where: str,
        *,
        warnings: Iterable[str] = (),
        provenance: Mapping[str, str] = MappingProxyType({}),
        topics: Collection[str] = (),
        displacement_from_points: bool = True,
    ) -> Trial:
        """
        Return what the streams hold as one trial; to be called once.

        Parameters
        ----------
        name : str
            What a person calls the trial.
        where : str
            What the messages come from, for the sentence when they are no trial.
        warnings : iterable of str
            What is wrong with the source.
        provenance : mapping of str to str
            Where the data come from.
        topics : collection of str
            All that the source holds, for the sentence when they are no trial.
        displacement_from_points : bool
            Whether to compute the displacement height from the clouds where it was not recorded.

        Raises
        ------
        InputError
            If there is no usable force or no usable tool height.

        """
        told = list(warnings)
        middles = [middle for stream in self.all if (middle := stream.settle_times()) is not None]
        # The first one is that of the force, if there is any.
        middle_ns = middles[0] if middles else 0
        starts = [first for each in self.all if (first := each.keep_near(middle_ns)) is not None]
        start_ns = min(starts, default=0)
        force = self.force.signal(start_ns)
        tool_height = self.tool_height.signal(start_ns)
        if force is None or tool_height is None:
            lacking = [
                stream.why_empty()
                for stream, signal in ((self.force, force), (self.tool_height, tool_height))
                if signal is None
            ]
            present = ', '.join(sorted(topics)) or 'none'
            raise InputError(
                f'{where} holds no trial: {"; ".join([*lacking, *told])}; '
                f'topics in the bag: {present}'
            )
        if force.t[-1] < tool_height.t[0] or tool_height.t[-1] < force.t[0]:
            told.append('force and tool height do not overlap in time: check the clocks')

        displacement = self.displacement.signal(start_ns)
        push_velocity = self.push_velocity.signal(start_ns)
        phases = self.phase.phases(start_ns)
        clouds = self.points.clouds(start_ns)
        for stream in self.all:
            told += stream.warnings
        source: DisplacementSource = 'none'
        if displacement is not None:
            source = 'tool' if provenance.get('displacement_source') == 'tool' else 'topic'
        elif clouds is not None and displacement_from_points:
            # What plans a contact takes longer to import than to read a bag that needs none of it.
            from hapticvision_ros.core.displacement import displacement_from_clouds

            displacement, assumed = displacement_from_clouds(
                clouds,
                tool_height,
                touched=lambda: _touched(force, tool_height),
            )
            told += assumed
            source = 'none' if displacement is None else 'points'
        else:
            told.append(
                f'{DISPLACEMENT_HEIGHT.name} was not recorded: the displacement of the object is '
                'unknown'
            )
        return Trial(
            name=name,
            start_ns=start_ns,
            force=force,
            tool_height=tool_height,
            displacement_height=displacement,
            displacement_source=source,
            push_velocity=push_velocity,
            phases=phases,
            clouds=clouds,
            warnings=tuple(told),
            provenance=MappingProxyType(dict(provenance)),
        )


def _touched(force: Signal, tool_height: Signal) -> float | None:
    """Return the height of the tool tip at which it touched the object [m]; None if unknown."""
    from hapticvision_ros.core.segmentation import segment

    try:
        return segment(force, tool_height).contact_height
    except InputError:
        return None


def read_trial(path: Path, *, displacement_from_points: bool = True) -> Trial:
    """
    Read a bag of the contract as one trial.

    Parameters
    ----------
    path : Path
        A bare ``.mcap`` file or a rosbag2 directory.
    displacement_from_points : bool
        Whether to compute the displacement height from the clouds where it was not recorded;
        this reads every cloud.

    Returns
    -------
    trial : Trial
        What was measured, with a warning for all that had to be left out or repaired. The clouds
        stay in the file until they are asked for.

    Raises
    ------
    InputError
        If there is no such bag, or it holds no usable force or no usable tool height.

    """
    bag = find_files(path)
    streams = TrialStreams()
    warnings = list(bag.warnings)
    provenance, topics = _scan(path, bag, streams, warnings)
    return streams.trial(
        bag.name,
        str(path),
        warnings=warnings,
        provenance=provenance,
        topics=topics,
        displacement_from_points=displacement_from_points,
    )


def _scan(
    path: Path, bag: BagFiles, streams: TrialStreams, warnings: list[str]
) -> tuple[dict[str, str], set[str]]:
    """Feed the streams from the bag's files; return the provenance and the topics' names."""
    provenance: dict[str, str] = {}
    topics: set[str] = set()
    count = 0
    for file in bag.files:
        scanner = McapScanner(file, streams.by_name.keys())
        try:
            for batch in scanner.batches():
                streams.by_name[batch.channel.topic].add(batch)
        except InputError as error:
            if len(bag.files) == 1:
                raise
            warnings.append(str(error))
        warnings += scanner.faults
        provenance |= scanner.metadata.get(PROVENANCE, {})
        topics |= scanner.counts.keys()
        count += sum(scanner.counts.values())
    if bag.message_count not in (None, count):
        warnings.append(f'metadata.yaml promises {bag.message_count} messages, {count} were found')
    return provenance, topics

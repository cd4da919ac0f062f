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

"""What a simulated world with faults does to its streams, and what it keeps of the truth."""

import math
import threading

from hapticvision_ros.core.faults import table
from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.faults import Distortion, FaultLink, FaultyServer, HOUR_NS, LATE, SLOW
from hapticvision_ros.sim.protocol import ARM, ARM_PACKET, FORCE, FORCE_PACKET
from hapticvision_ros.sim.world import World
import pytest

STAMP = 1_700_000_000_000_000_000


def force(k, value=-3.0):
    """Return the k-th datagram of a load cell at 1 kHz."""
    return FORCE_PACKET.pack(STAMP + k * 1_000_000, 0.1, 0.2, value + 1e-4 * k, 0.0, 0.0, 0.0)


def distorted(how, count=200, send=force, stream=FORCE):
    distortion = Distortion(stream, how, 1)
    return [list(distortion.pass_on(send(k), 0.001 * k)) for k in range(count)]


def flat(sent):
    return [item for each in sent for item in each]


def values(sent):
    return [FORCE_PACKET.unpack(item)[3] for item in flat(sent)]


def test_every_kind_of_the_table_is_known():
    for fault in table():
        if fault.action == 'distort' and fault.how not in ('lossy', 'garbage', 'deaf', 'spike'):
            stream = {'force': (FORCE, force), 'arm': (ARM, height)}.get(fault.target)
            if stream is not None:
                sent = distorted(fault.how, 200, stream[1], stream[0])
                assert flat(sent) != [stream[1](k) for k in range(200)], fault.name


def height(k):
    return ARM_PACKET.pack(STAMP + k * 1_000_000, 0.05 - 1e-5 * k)


def test_silence_and_slowness():
    assert not flat(distorted('silent'))
    assert len(flat(distorted('slow'))) == 200 // SLOW


def test_half_is_lost_or_all_comes_twice_or_in_the_wrong_order():
    assert 70 < len(flat(distorted('lossy'))) < 130
    assert flat(distorted('twice', 2)) == [force(0), force(0), force(1), force(1)]
    assert flat(distorted('swapped', 4)) == [force(1), force(0), force(3), force(2)]


def test_what_is_late_comes_in_order():
    distortion = Distortion(FORCE, 'late', 1)
    assert not list(distortion.pass_on(force(0), 0.0))
    assert not list(distortion.pass_on(force(1), LATE / 2))
    assert list(distortion.pass_on(force(2), LATE)) == [force(0)]


def test_numbers_that_are_none_and_sensors_that_are_stuck():
    assert all(math.isnan(value) for value in values(distorted('nan')))
    assert set(values(distorted('frozen'))) == {-3.0}
    assert set(values(distorted('saturated'))) == {-2.0}
    first, *others = values(distorted('spike'))
    assert first == -1e4 and max(map(abs, others)) < 4.0


def test_clocks_that_jump():
    for how, jump in (('an hour ahead', HOUR_NS), ('an hour back', -HOUR_NS)):
        stamps = [FORCE_PACKET.unpack(item)[0] for item in flat(distorted(how, 3))]
        assert stamps == [STAMP + k * 1_000_000 + jump for k in range(3)]


@pytest.fixture
def server():
    config = load_config(None)
    world = World(config, config.material('spring1'), seed=1)
    made = FaultyServer(world, config, 0)
    stopped = threading.Event()
    thread = threading.Thread(target=made.serve, args=(stopped.is_set,))
    thread.start()
    yield made
    stopped.set()
    thread.join()
    made.close()


def test_the_truth_is_told_on_request(server):
    link = FaultLink(server.port)
    link.ask('watch')
    told = link.ask('report')
    assert told['peak_force'] == 0.0 and told['stopped'] is None and not told['touching']
    link.ask('mark')
    told = link.ask('report')
    assert told['stopped'] == 0.0 and told['clear'] == 0.0
    link.ask('distort', stream='force', how='silent')
    link.ask('heal')
    link.close()

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


"""The pages under ``msg_docs/`` say what the code does."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from hapticvision_ros.bag.contract import CELL_TOPICS, SERVICES, TOPICS
import pytest
from rosbags.typesys import get_typestore, Stores

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope='module')
def generator() -> ModuleType:
    """Return the script that writes the pages."""
    spec = spec_from_file_location('msg_docs', ROOT / 'tools' / 'msg_docs.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_pages_are_current(generator: ModuleType) -> None:
    written = {page.name: page.read_text() for page in (ROOT / 'msg_docs').glob('*.md')}
    assert written == generator.pages(), 'run: python tools/msg_docs.py'


def test_every_topic_and_service_has_its_page(generator: ModuleType) -> None:
    pages = generator.pages()
    for topic in (*TOPICS, *CELL_TOPICS):
        page = pages[generator.page_name(topic.name)]
        for fact in (topic.name, topic.msgtype, topic.unit, topic.frame_id, topic.meaning):
            assert fact in page
    for service in SERVICES:
        assert service.name in pages['services.md'] and service.srvtype in pages['services.md']


def test_the_quality_of_service_is_that_of_the_nodes(generator: ModuleType) -> None:
    qos = pytest.importorskip('hapticvision_ros.nodes.qos')
    for topic in (*TOPICS, *CELL_TOPICS):
        page = generator.topic_page(topic)
        for verb, profile in (
            ('published', qos.publisher_profile(topic.qos)),
            ('subscribed', qos.subscription_profile(topic.qos)),
        ):
            reliability = profile.reliability.name.lower().replace('_', ' ')
            durability = profile.durability.name.lower().replace('_', ' ')
            said = f'| {verb} with | {reliability}, {durability}, keep last {profile.depth} |'
            assert said in page


def test_the_fields_on_the_pages_exist_in_their_types(generator: ModuleType) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for topic in (*TOPICS, *CELL_TOPICS):
        for path, _ in generator.FIELDS[topic.msgtype]:
            msgtype = topic.msgtype
            for part in path.split('.'):
                fields = dict(store.fielddefs[msgtype][1])
                assert part in fields, f'{topic.msgtype} has no {path}'
                msgtype = fields[part][1]


@pytest.mark.parametrize('service', SERVICES, ids=lambda service: service.name)
def test_the_fields_of_services_exist_in_their_types(generator: ModuleType, service) -> None:
    package, _, name = service.srvtype.split('/')
    module = pytest.importorskip(f'{package}.srv')
    parts = {
        'request': getattr(module, name).Request,
        'response': getattr(module, name).Response,
    }
    for path, _ in generator.FIELDS[service.srvtype]:
        part, field = path.split('.')
        assert field in parts[part].get_fields_and_field_types()

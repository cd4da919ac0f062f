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
Writes the pages under ``msg_docs/`` from the table of topics that the nodes and bags use.

Run it without arguments after a change of the table; a test refuses pages that differ.
"""

from pathlib import Path
from typing import Final

from hapticvision_ros.bag.contract import (
    CELL_TOPICS,
    CONTRACT_VERSION,
    Service,
    SERVICES,
    Topic,
    TOPICS,
)

FOLDER: Final = Path(__file__).resolve().parents[1] / 'msg_docs'

_STAMP: Final = (
    ('header.stamp', 'time of the measurement'),
    ('header.frame_id', 'the frame named above'),
)
_PAIRS: Final = (
    ('level', 'OK, or WARN or ERROR where something needs attention'),
    ('name', 'what this is about'),
    ('message', 'one sentence for a person'),
    ('hardware_id', 'empty'),
    ('values', 'names with their units and texts, one pair each'),
)
FIELDS: Final = {
    'geometry_msgs/msg/WrenchStamped': (
        *_STAMP,
        ('wrench.force', 'force; the contact force is -force.z'),
        ('wrench.torque', 'torque [N.m], zero if the load cell has one axis; not used by the fit'),
    ),
    'std_msgs/msg/Float64': (('data', 'the number, in the unit named above'),),
    'std_msgs/msg/String': (('data', 'the text'),),
    'std_msgs/msg/Bool': (('data', 'true or false'),),
    'sensor_msgs/msg/PointCloud2': (
        *_STAMP,
        ('height', 'rows; 1 if the cloud is not organised'),
        ('width', 'points in a row'),
        ('fields', 'x, y and z as float32 (float64 is converted); others are ignored'),
        ('is_bigendian', 'byte order of the points; both are read'),
        ('point_step', 'bytes from point to point, of any size'),
        ('row_step', 'bytes from row to row, padding allowed'),
        ('data', 'the points; one with NaN or Inf is no return (REP-117)'),
        ('is_dense', 'true if no point is missing; not trusted'),
    ),
    'geometry_msgs/msg/PointStamped': (*_STAMP, ('point', 'the point')),
    'geometry_msgs/msg/PoseStamped': (
        *_STAMP,
        ('pose.position', 'where it is'),
        ('pose.orientation', 'how it is turned, a quaternion x, y, z, w'),
    ),
    'geometry_msgs/msg/Vector3Stamped': (*_STAMP, ('vector', 'the unit vector')),
    'diagnostic_msgs/msg/DiagnosticStatus': _PAIRS,
    'action_msgs/msg/GoalStatusArray': (
        ('status_list', "each goal's id, time of acceptance and state, the newest last"),
    ),
    'std_srvs/srv/Trigger': (
        ('response.success', 'whether it was done'),
        ('response.message', 'one sentence: what was done, or why not'),
    ),
    'std_srvs/srv/SetBool': (
        ('request.data', 'true to allow, false to forbid'),
        ('response.success', 'whether it was done'),
        ('response.message', 'one sentence: what was done, or why not'),
    ),
    'action_msgs/srv/CancelGoal': (
        ('request.goal_info', 'id of the goal; all zero for every goal'),
        ('response.return_code', 'as an action server answers'),
        ('response.goals_canceling', 'the goals that are being cancelled'),
    ),
}
"""Which fields of a type are used, and for what."""


def page_name(name: str) -> str:
    """Return the file name of a topic's page."""
    return f'{name.strip("/").replace("/", "_")}.md'


def _rate(topic: Topic) -> str:
    if topic.rate_hz is None:
        return 'on change'
    low, high = topic.rate_hz
    return f'{low:g} to {high:g} Hz'


def _code(text: str) -> str:
    return text if text == '-' else f'`{text}`'


def _needed(topic: Topic) -> str:
    if topic in CELL_TOPICS:
        return 'no: it is no part of the bag contract'
    if topic.required:
        return 'yes'
    return 'no'


def _fields(type_name: str) -> list[str]:
    rows = [f'| `{field}` | {use} |' for field, use in FIELDS[type_name]]
    return ['| field | use |', '| --- | --- |', *rows]


def topic_page(topic: Topic) -> str:
    """Return the page of a topic."""
    qos = topic.qos
    durability = qos.durability.replace('_', ' ')
    latched = qos.durability == 'transient_local'
    asked = 'reliable' if latched else 'best effort'
    offered = qos.reliability.replace('_', ' ')
    time = 'header stamp' if topic.stamped else "the sender's time of publishing"
    lines = [
        f'# {topic.name}',
        '',
        topic.meaning,
        '',
        '| | |',
        '| --- | --- |',
        f'| type | `{topic.msgtype}` |',
        f'| unit | {topic.unit} |',
        f'| frame | {_code(topic.frame_id)} |',
        f'| rate | {_rate(topic)} |',
        f'| time of a message | {time} |',
        f'| needed in a bag | {_needed(topic)} |',
        f'| published with | {offered}, {durability}, keep last {qos.publish_depth} |',
        f'| subscribed with | {asked}, {durability}, keep last {qos.subscribe_depth} |',
        '',
        '## Fields',
        '',
        *_fields(topic.msgtype),
    ]
    return '\n'.join(lines) + '\n'


def services_page() -> str:
    """Return the page of all services."""
    lines = ['# Services', '', 'All are of standard types.']
    for service in SERVICES:
        lines += [
            '',
            f'## {service.name}',
            '',
            service.meaning,
            '',
            f'Type `{service.srvtype}`.',
            '',
            *_fields(service.srvtype),
        ]
    return '\n'.join(lines) + '\n'


def _index_rows(topics: tuple[Topic, ...]) -> list[str]:
    rows = [
        f'| [{topic.name}]({page_name(topic.name)}) | `{topic.msgtype}` | {topic.unit} | '
        f'{_rate(topic)} |'
        for topic in topics
    ]
    return ['| topic | type | unit | rate |', '| --- | --- | --- | --- |', *rows]


def _service_row(service: Service) -> str:
    return f'| {service.name} | `{service.srvtype}` |'


def index_page() -> str:
    """Return the page that lists the others."""
    lines = [
        '# Topics and services',
        '',
        'Names are relative to the namespace of the cell. Units are SI (REP-103).',
        '',
        f'## The bag contract, version {CONTRACT_VERSION}',
        '',
        'A bag holds one trial. It needs the wrench, the tool height, and at least one of the',
        'points and the displacement height.',
        '',
        *_index_rows(TOPICS),
        '',
        '## Between the nodes only',
        '',
        *_index_rows(CELL_TOPICS),
        '',
        '## [Services](services.md)',
        '',
        '| service | type |',
        '| --- | --- |',
        *(_service_row(service) for service in SERVICES),
    ]
    return '\n'.join(lines) + '\n'


def pages() -> dict[str, str]:
    """Return all pages by file name."""
    return {
        'README.md': index_page(),
        'services.md': services_page(),
        **{page_name(topic.name): topic_page(topic) for topic in (*TOPICS, *CELL_TOPICS)},
    }


def main() -> None:
    """Write all pages and remove those of topics that are gone."""
    FOLDER.mkdir(exist_ok=True)
    current = pages()
    for name, text in current.items():
        (FOLDER / name).write_text(text, encoding='utf-8')
    for page in FOLDER.glob('*.md'):
        if page.name not in current:
            page.unlink()


if __name__ == '__main__':
    main()

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
The layouts of RViz, PlotJuggler and Foxglove show topics that there are.

None of the three programs is here: whether they draw what they should only they can tell, as
PlotJuggler 3.17.1 and Lichtblick 1.28.1 did. What they do with a layout was read in their sources.
"""

import json
from pathlib import Path
import re
from typing import Any
import xml.etree.ElementTree as ElementTree

from hapticvision_ros.bag.contract import CELL_TOPICS, Topic, TOPICS
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_typestore, Stores
import yaml

FOLDER = Path(__file__).resolve().parents[1] / 'config' / 'layouts'
CONTRACT = {topic.name: topic for topic in (*TOPICS, *CELL_TOPICS)}
STORE = get_typestore(Stores.ROS2_JAZZY)
RVIZ_TYPES = {
    'rviz_default_plugins/PointCloud2': 'sensor_msgs/msg/PointCloud2',
    'rviz_default_plugins/PointStamped': 'geometry_msgs/msg/PointStamped',
    'rviz_default_plugins/Pose': 'geometry_msgs/msg/PoseStamped',
}
DIAGNOSTICS = '/diagnostics'


def _is_number_or_text(topic: Topic, path: list[str]) -> bool:
    """Return whether the path leads to a single value in the topic's messages."""
    node = (Nodetype.NAME, topic.msgtype)
    for part in path:
        kind, msgtype = node
        fields = dict(STORE.fielddefs[msgtype][1]) if kind is Nodetype.NAME else {}
        if part not in fields:
            return False
        node = fields[part]
    return node[0] is Nodetype.BASE


def _topic_of(text: str, separator: str) -> tuple[Topic, list[str]]:
    """Return the topic that begins a path of PlotJuggler or Foxglove, and the rest."""
    (name,) = (item for item in CONTRACT if text.startswith(item + separator))
    fields = text.removeprefix(name + separator).split(separator)
    return CONTRACT[name], fields


def _texts(item: Any) -> list[str]:
    if isinstance(item, dict):
        return [text for key, value in item.items() for text in (*_texts(key), *_texts(value))]
    if isinstance(item, list):
        return [text for value in item for text in _texts(value)]
    return [item] if isinstance(item, str) else []


@pytest.fixture(scope='module')
def rviz() -> dict[str, Any]:
    return yaml.safe_load((FOLDER / 'cell.rviz').read_text())['Visualization Manager']


@pytest.fixture(scope='module')
def foxglove() -> dict[str, Any]:
    return json.loads((FOLDER / 'foxglove.json').read_text())


def test_each_layout_is_tested_here() -> None:
    assert {path.name for path in FOLDER.iterdir()} == {
        'cell.rviz',
        'plotjuggler.xml',
        'foxglove.json',
    }


def test_rviz_shows_topics_as_what_they_are_in_their_frame(rviz: dict[str, Any]) -> None:
    shown = [display for display in rviz['Displays'] if 'Topic' in display]
    assert shown
    for display in shown:
        topic = CONTRACT[display['Topic']['Value']]
        assert RVIZ_TYPES[display['Class']] == topic.msgtype
        assert rviz['Global Options']['Fixed Frame'] == topic.frame_id


def test_rviz_asks_for_latched_topics_as_such_and_for_sensor_data_as_such(rviz) -> None:
    for display in rviz['Displays']:
        if 'Topic' in display:
            latched = CONTRACT[display['Topic']['Value']].qos.durability == 'transient_local'
            asked = display['Topic']['Reliability Policy'], display['Topic']['Durability Policy']
            assert asked == (
                ('Reliable', 'Transient Local') if latched else ('Best Effort', 'Volatile')
            )


def test_plotjuggler_plots_numbers_of_the_contract() -> None:
    root = ElementTree.parse(FOLDER / 'plotjuggler.xml').getroot()
    curves = [curve.attrib['name'] for curve in root.iter('curve')]
    assert curves
    for curve in curves:
        assert _is_number_or_text(*_topic_of(curve, '/')), curve
    for splitter in root.iter('DockSplitter'):
        assert (
            int(splitter.attrib['count'])
            == len(splitter)
            == len(splitter.attrib['sizes'].split(';'))
        )


def test_plotjuggler_draws_nothing_between_samples_that_was_not_so() -> None:
    """Its "Steps" go back to the sample before; no line goes across what the tool hides."""
    root = ElementTree.parse(FOLDER / 'plotjuggler.xml').getroot()
    styles = {
        curve.attrib['name']: plot.attrib['style']
        for plot in root.iter('plot')
        for curve in plot.iter('curve')
    }
    assert 'Steps' not in styles.values()
    assert styles['/arm/push_velocity/data'] == 'StepsInv'
    assert styles['/object/displacement_height/data'] == 'Dots'


def test_plotjuggler_subscribes_to_what_it_plots() -> None:
    """Curves of what has sent nothing yet are kept only with a streamer and its topics."""
    root = ElementTree.parse(FOLDER / 'plotjuggler.xml').getroot()
    plotted = {_topic_of(curve.attrib['name'], '/')[0].name for curve in root.iter('curve')}
    (plugin,) = root.iter('plugin')
    assert root.find('previouslyLoaded_Streamer').attrib['name'] == plugin.attrib['ID']
    assert set(plugin.find('selected_topics').attrib['value'].split(';')) == plotted
    # PlotJuggler's own, from 5 to 999, where 999 has no end.
    assert 5 <= int(root.find('streaming_buffer_size').attrib['value']) <= 999


def test_rviz_is_told_which_docks_to_show() -> None:
    """Where it is not told, it goes by what is in its memory."""
    geometry = yaml.safe_load((FOLDER / 'cell.rviz').read_text())['Window Geometry']
    assert geometry['Hide Left Dock'] is geometry['Hide Right Dock'] is False


def test_foxglove_titles_have_the_keys_that_it_looks_for(foxglove: dict[str, Any]) -> None:
    """Foxglove has its own key, and so has Lichtblick; neither reads `title`."""
    for panel in foxglove['configById'].values():
        assert 'title' not in panel
        assert panel.get('foxglovePanelTitle') == panel.get('lichtblickPanelTitle')
    plots = [key for key in foxglove['configById'] if key.startswith('Plot!')]
    assert all('foxglovePanelTitle' in foxglove['configById'][key] for key in plots)


def test_foxglove_names_values_of_the_contract(foxglove: dict[str, Any]) -> None:
    panels = foxglove['configById']
    paths = [path['value'] for panel in panels.values() for path in panel.get('paths', ())]
    assert paths
    for path in paths:
        assert _is_number_or_text(*_topic_of(path, '.')), path
    topics = [text for text in _texts(panels) if re.fullmatch(r'/[a-z_/0-9]+', text)]
    assert {*topics} <= {*CONTRACT, DIAGNOSTICS}
    for panel in panels.values():
        if 'topicName' in panel:
            assert panel['datatype'] == CONTRACT[panel['topicName']].msgtype


def test_foxglove_colours_clouds_of_which_points_are_missing(foxglove) -> None:
    """Of a cloud that lacks a return the program finds no range of colours: all would be black."""
    for panel in foxglove['configById'].values():
        for topic, settings in panel.get('topics', {}).items():
            if settings.get('colorMode') == 'colormap':
                assert settings['minValue'] < settings['maxValue'], topic
            elif settings.get('colorMode') == 'flat':
                assert settings['colorField'], topic


def test_foxglove_shows_each_panel_once(foxglove: dict[str, Any]) -> None:
    def leaves(item: Any) -> list[str]:
        if isinstance(item, str):
            return [item]
        return [*leaves(item['first']), *leaves(item['second'])]

    assert sorted(leaves(foxglove['layout'])) == sorted(foxglove['configById'])

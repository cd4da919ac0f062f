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

"""Publishers, subscriptions and services made from the contract's table."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from hapticvision_ros.bag.contract import Qos, Service, Topic
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy


def interface_class(type_name: str) -> Any:
    """Return the Python class of an interface such as ``std_msgs/msg/Float64``."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


def relative_name(name: str) -> str:
    """Return a contract name without its leading slash, so that a node's namespace applies."""
    return name.removeprefix('/')


def publisher_profile(qos: Qos) -> Any:
    """Return the profile that a publisher of the topic offers."""
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=qos.publish_depth,
        reliability=(
            QoSReliabilityPolicy.RELIABLE
            if qos.reliability == 'reliable'
            else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL
            if qos.durability == 'transient_local'
            else QoSDurabilityPolicy.VOLATILE
        ),
    )


def subscription_profile(qos: Qos) -> Any:
    """
    Return the profile that a subscriber of the topic asks for.

    Best effort, so that any publisher fits (REP-2003, sensor data); a latched topic is asked for
    reliably, since only then is the last message sent again.
    """
    latched = qos.durability == 'transient_local'
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=qos.subscribe_depth,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if latched else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
        ),
    )


def create_publisher(node: Any, topic: Topic) -> Any:
    """Return a publisher of a contract topic, in the node's namespace."""
    return node.create_publisher(
        interface_class(topic.msgtype), relative_name(topic.name), publisher_profile(topic.qos)
    )


def create_subscription(
    node: Any, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False
) -> Any:
    """Return a subscription to a contract topic; `raw` hands over serialised bytes."""
    return node.create_subscription(
        interface_class(topic.msgtype),
        relative_name(topic.name),
        callback,
        subscription_profile(topic.qos),
        raw=raw,
    )


def create_service(
    node: Any,
    service: Service,
    callback: Callable[[Any, Any], Any],
    *,
    callback_group: Any = None,
) -> Any:
    """
    Return a server of a contract service, in the node's namespace.

    A coroutine as `callback` needs a group of its own: the node's default group runs nothing else
    while the coroutine waits.
    """
    return node.create_service(
        interface_class(service.srvtype),
        relative_name(service.name),
        callback,
        callback_group=callback_group,
    )


def create_client(node: Any, service: Service) -> Any:
    """Return a client of a contract service, in the node's namespace."""
    return node.create_client(interface_class(service.srvtype), relative_name(service.name))

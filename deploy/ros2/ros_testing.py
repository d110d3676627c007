# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for ROS 2, which Debian does not have, for tests of the nodes."""

import collections
import importlib
import io
import sys
import threading
import types
from unittest import mock

import genpy


def sent(message):
    """Returns the message as a subscriber receives it."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


class FakeRos:
    """The parts of ROS 2 that the nodes use. Messages are serialized, which checks their types."""

    def __init__(self, parameters, on_log):
        self.subscriptions = {}  # {topic: function of a message}
        self.published = collections.defaultdict(list)
        self.parameters = parameters
        self.on_log = on_log
        self.is_down = threading.Event()

    def publish(self, topic, message):
        self.published[topic].append(sent(message))

    def spin(self, node):
        self.is_down.wait()

    def run(self, module):
        """Runs the node of this module up to its end."""
        with mock.patch.dict(sys.modules, self.modules()):
            importlib.import_module(module).main()

    def modules(self):
        ros = self

        class Node:
            def __init__(self, name):
                pass

            def declare_parameter(self, name, value):
                return types.SimpleNamespace(value=ros.parameters.get(name, value))

            def create_publisher(self, kind, topic, qos):
                return types.SimpleNamespace(publish=lambda message: ros.publish(topic, message))

            def create_subscription(self, kind, topic, on_message, qos):
                ros.subscriptions[topic] = on_message

            def get_clock(self):
                return types.SimpleNamespace(now=lambda: types.SimpleNamespace(nanoseconds=1_700_000_000_000_000_000))

            def get_logger(self):
                return types.SimpleNamespace(info=ros.on_log, warning=lambda text, **_: ros.on_log(text), error=ros.on_log)

        class TransformBroadcaster:
            def __init__(self, node):
                self.sendTransform = lambda message: ros.publish("/tf", message)  # the name in ROS

        executors = types.SimpleNamespace(ExternalShutdownException=RuntimeError)
        qos = types.SimpleNamespace(qos_profile_sensor_data=10, QoSProfile=dict, QoSHistoryPolicy=mock.Mock(), QoSReliabilityPolicy=mock.Mock())
        return {
            "rclpy": types.SimpleNamespace(init=lambda: None, spin=lambda node: ros.spin(node), try_shutdown=ros.is_down.set,
                                           ok=lambda: not ros.is_down.is_set(), executors=executors),
            "rclpy.node": types.SimpleNamespace(Node=Node), "rclpy.qos": qos,
            "builtin_interfaces": types.SimpleNamespace(), "tf2_ros": types.SimpleNamespace(TransformBroadcaster=TransformBroadcaster),
            "builtin_interfaces.msg": types.SimpleNamespace(Time=lambda sec, nanosec: genpy.Time(sec, nanosec)),
            "event_camera_msgs": types.SimpleNamespace(), "event_camera_msgs.msg": types.SimpleNamespace(EventPacket=object),
        }

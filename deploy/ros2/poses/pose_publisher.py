#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node that publishes the poses of a session of evpose-server; README.md beside it has its parameters and topics.

    python3 pose_publisher.py --ros-args -p server:=tracker:50051 -p camera_frame:=event_camera_optical_frame
"""

import pathlib
import sys
import threading

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String
from tf2_ros import TransformBroadcaster

import evpose
from pose_messages import (ClockOffset, StateChanges, diagnostics, is_published, name_in_ros, pose_message, state_message,
                           transform_message, twist_message)
from session_follower import SessionFollower, choose_session

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from evpose_node import connect, run

_PARAMETERS = {"server": "127.0.0.1:50051", "session": "", "token_file": "", "tls_ca": "", "tls_certificate": "", "tls_key": "",
               "camera_frame": "camera_optical_frame", "object_frame_prefix": "", "epoch_ns": -1, "max_rate_hz": 0.0, "health_period_s": 1.0}


def stamp_of(nanoseconds):
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


class PosePublisher(Node):
    def __init__(self):
        super().__init__("evpose_poses")
        self._settings = {name: self.declare_parameter(name, value).value for name, value in _PARAMETERS.items()}
        self._offset = ClockOffset()
        self._outputs = {}
        self._states = {}  # publishers, by object
        self._state_changes = StateChanges()
        self._broadcaster = TransformBroadcaster(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._client = connect(self._settings)
        session = choose_session(self._client, self._settings["session"])
        self._session_name = session.name
        self._follower = SessionFollower(session)
        for object_id in session.object_ids:
            # Reliable, unlike the poses: a state that is not repeated must not be lost.
            self._states[object_id] = self.create_publisher(String, self._topic(object_id, "state"), 10)

    def work(self):
        """Publishes until the session has ended or stop() is called. Raises evpose.EvposeError."""
        try:
            self._follow()
        except evpose.CancelledError:  # by stop()
            pass

    def _follow(self):
        num_stored = self._follower.skip_stored()
        self.get_logger().info(f"publishes the poses of {self._session_name} after pose {num_stored}")
        health = threading.Thread(target=self._follow_health)
        health.start()
        try:
            self._follower.poses(self._publish, max_rate_hz=self._settings["max_rate_hz"] or None, on_outage=self._warn)
        finally:
            self._follower.stop()
            health.join()

    def _follow_health(self):
        try:
            self._follower.health(self._publish_health, self._settings["health_period_s"], self._warn)
        except evpose.EvposeError as error:
            self.get_logger().error(f"no more diagnostics: {error}")

    def stop(self):
        self._follower.stop()
        self._client.close()  # ends the calls that wait

    def _warn(self, error):
        self.get_logger().warning(f"trying again: {error}", throttle_duration_sec=5.0)

    def _publish(self, pose):
        settings = self._settings
        arrival_ns = self.get_clock().now().nanoseconds
        epoch_ns = settings["epoch_ns"]
        # The offset is kept also for poses that are not published.
        stamp_ns = epoch_ns + 1000 * pose.t_us if epoch_ns >= 0 else self._offset.stamp_ns(pose.t_us, arrival_ns)
        self._states[pose.object_id].publish(state_message(String, pose))
        if not is_published(pose):
            return
        stamp, frame = stamp_of(stamp_ns), settings["camera_frame"]
        poses, twists = self._outputs_of(pose.object_id)
        poses.publish(pose_message(PoseWithCovarianceStamped, pose, stamp, frame))
        twists.publish(twist_message(TwistStamped, pose, stamp, frame))
        child_frame = settings["object_frame_prefix"] + pose.object_id
        self._broadcaster.sendTransform(transform_message(TransformStamped, pose, stamp, frame, child_frame))

    def _outputs_of(self, object_id):
        if object_id not in self._outputs:
            self._outputs[object_id] = tuple(
                self.create_publisher(kind, self._topic(object_id, what), qos_profile_sensor_data)
                for kind, what in ((PoseWithCovarianceStamped, "pose"), (TwistStamped, "twist")))
        return self._outputs[object_id]

    @staticmethod
    def _topic(object_id, what):
        return f"evpose/{name_in_ros(object_id)}/{what}"

    def _publish_health(self, health):
        for object_id, message in self._state_changes.messages(String, health):
            self._states[object_id].publish(message)
        stamp = stamp_of(self.get_clock().now().nanoseconds)
        self._diagnostics.publish(diagnostics(DiagnosticArray, DiagnosticStatus, KeyValue, health, self._session_name, stamp))


def main():
    run(PosePublisher, "evpose_poses")


if __name__ == "__main__":
    main()

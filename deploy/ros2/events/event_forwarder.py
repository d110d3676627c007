#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node that sends the EventPackets of a camera to evpose-server; README.md beside it has its parameters.

    python3 event_forwarder.py --ros-args -r events:=/event_camera/events -p camera:=camera.yaml -p model:=object.obj
"""

import pathlib
import sys

from event_camera_msgs.msg import EventPacket
from rclpy.node import Node
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

import evpose
from event_packets import PacketQueue, PacketReader

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
from evpose_node import connect, run

_PARAMETERS = {"server": "127.0.0.1:50051", "token_file": "", "tls_ca": "", "tls_certificate": "", "tls_key": "", "camera": "", "model": "",
               "object_id": "object", "metres_per_unit": 1.0, "overload": "latest", "memory_bytes": 64 << 20, "keep_session": False}
# Depth of the queue of ROS 2, in packets of some milliseconds each, while Python is busy. A deeper queue would deliver old events.
_QUEUED_PACKETS = 1000


class EventForwarder(Node):
    def __init__(self):
        super().__init__("evpose_events")
        self._settings = {name: self.declare_parameter(name, value).value for name, value in _PARAMETERS.items()}
        settings = self._settings
        for name in ("camera", "model"):
            if not settings[name]:
                raise evpose.InvalidArgumentError(f"the parameter {name} is required: a file")
        if settings["overload"] not in ("latest", "block"):
            raise evpose.InvalidArgumentError(f"overload: {settings['overload']!r} is neither latest nor block")
        camera = evpose.read_camera(settings["camera"])
        self._client = connect(settings)
        model = self._client.upload_model(settings["model"], metres_per_unit=settings["metres_per_unit"])
        overload = evpose.Overload.LATEST if settings["overload"] == "latest" else evpose.Overload.BLOCK
        self._session = self._client.create_session([evpose.TrackedObject(model, settings["object_id"])], camera, evpose.Encoding.EVT3,
                                                    overload=overload)
        self._queue = PacketQueue(PacketReader(camera.width_px, camera.height_px), settings["memory_bytes"])
        # Deep and best effort: a reliable subscriber of a best-effort publisher receives nothing.
        qos = QoSProfile(depth=_QUEUED_PACKETS, history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._failure = None
        self.create_subscription(EventPacket, "events", self._on_packet, qos)

    def _on_packet(self, packet):
        try:
            self._queue.put(packet)
        except evpose.InvalidArgumentError as error:
            self._failure = error
            self._queue.end()

    def work(self):
        """Sends events until stop(). Raises evpose.EvposeError."""
        self.get_logger().info(f"feeds {self._session.name}")
        options = evpose.TrackOptions(is_live=True, memory_bytes=self._settings["memory_bytes"], on_notice=self._warn)
        try:
            with self._session.track(self._queue, options) as track:
                num_poses = sum(1 for _ in track)
            reader = self._queue.reader
            self.get_logger().info(f"{reader.num_packets} packets, {num_poses} poses; {reader.num_lost} packets lost, "
                                   f"{self._queue.num_dropped} dropped, {reader.num_refused} damaged")
        finally:
            if not self._settings["keep_session"]:
                self._session.delete()
            self._client.close()
        if self._failure is not None:
            raise self._failure

    def stop(self):
        self._queue.end()

    def _warn(self, notice):
        if isinstance(notice, (evpose.EventsDropped, evpose.DecodeFault)):
            self.get_logger().warning(f"{notice}", throttle_duration_sec=5.0)


def main():
    run(EventForwarder, "evpose_events")


if __name__ == "__main__":
    main()

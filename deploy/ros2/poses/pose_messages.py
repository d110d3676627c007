# SPDX-License-Identifier: Apache-2.0
"""Poses and health of evpose as messages of ROS. It needs no ROS: the caller passes the classes of the messages and the stamp."""

import collections
import json
import re

import evpose

# Poses of other states are not confirmed: a subscriber takes every message for a pose that it may act on.
_PUBLISHED = (evpose.TrackState.TRACKING, evpose.TrackState.DEGRADED)
# Levels of diagnostic_msgs/DiagnosticStatus.
OK, WARN, ERROR = 0, 1, 2
_LEVELS = {evpose.TrackState.TRACKING: OK, evpose.TrackState.LOST: ERROR}


class ClockOffset:
    """Estimates the ROS time at which the sensor's clock was 0, from the times at which poses arrive.

    A pose arrives late by the camera's buffers, the network and the tracker, and never early. So the offset is the least difference of
    both times over a window; it is late by the smallest of these delays. The window follows the drift of the clocks.
    """

    def __init__(self, window_ns=10_000_000_000):
        self._window_ns = window_ns
        self._candidates = collections.deque()  # (arrival, difference): increasing differences

    def stamp_ns(self, t_us, arrival_ns):
        """Returns the ROS time of the sensor time `t_us`, from the present offset with this arrival. `arrival_ns` must not decrease."""
        difference = arrival_ns - 1000 * t_us
        while self._candidates and self._candidates[-1][1] >= difference:
            self._candidates.pop()
        self._candidates.append((arrival_ns, difference))
        while self._candidates[0][0] < arrival_ns - self._window_ns:
            self._candidates.popleft()
        return 1000 * t_us + self._candidates[0][1]


def is_published(pose):
    """Whether a pose is published as a pose; with other states the topic of the state alone has it."""
    return pose.state in _PUBLISHED


def name_in_ros(text):
    """Returns a name of an object as part of a topic's name: letters, digits and underscores, not beginning with a digit."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return "_" + name if not name or name[0].isdigit() else name


def _set_vector(vector, numbers):
    vector.x, vector.y, vector.z = (float(number) for number in numbers)


def _set_quaternion(quaternion, numbers):
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = (float(number) for number in numbers)


def pose_message(make, pose, stamp, frame):
    """Returns a geometry_msgs/PoseWithCovarianceStamped: the pose of the object in the camera's optical frame (x right, y down, z forward).

    ROS has the covariance row by row in the order x, y, z, rotations about the fixed axes X, Y, Z; these are the axes of `frame`. That is
    evpose's perturbation on the left, [translation, rotation] in the camera frame."""
    message = make()
    message.header.stamp = stamp
    message.header.frame_id = frame
    _set_vector(message.pose.pose.position, pose.translation_m)
    _set_quaternion(message.pose.pose.orientation, pose.quaternion_xyzw)
    message.pose.covariance = [float(number) for number in pose.covariance.ravel()]
    return message


def twist_message(make, pose, stamp, frame):
    """Returns a geometry_msgs/TwistStamped: the velocity of the object's origin and its angular velocity, both relative to the camera and in
    its axes."""
    message = make()
    message.header.stamp = stamp
    message.header.frame_id = frame
    _set_vector(message.twist.linear, pose.twist[:3])
    _set_vector(message.twist.angular, pose.twist[3:])
    return message


def transform_message(make, pose, stamp, frame, child_frame):
    """Returns a geometry_msgs/TransformStamped of the object's frame in the camera's."""
    message = make()
    message.header.stamp = stamp
    message.header.frame_id = frame
    message.child_frame_id = child_frame
    _set_vector(message.transform.translation, pose.translation_m)
    _set_quaternion(message.transform.rotation, pose.quaternion_xyzw)
    return message


def state_message(make, pose):
    """Returns a std_msgs/String: the state of a pose as a JSON object, with the fields of a JSON line of `evpose replay`. The pose itself
    and its alternatives are in it only if the state is AMBIGUOUS; else the topic of the poses has it."""
    is_ambiguous = pose.state == evpose.TrackState.AMBIGUOUS
    fields = {"pose_seq": pose.seq, "object_id": pose.object_id, "t_us": pose.t_us}
    if is_ambiguous:
        fields.update(transform="camera_from_object", **_transform_fields(pose.camera_from_object))
    fields.update(state=pose.state.name, num_events=pose.num_events, explained_ratio=pose.explained_ratio,
                  residual_rms_px=pose.residual_rms_px)
    if is_ambiguous:
        fields.update(
            twist=pose.twist.tolist(), covariance_upper=[pose.covariance[row, column] for row in range(6) for column in range(row, 6)],
            alternatives=[{**_transform_fields(each.camera_from_object), "log_likelihood_ratio": each.log_likelihood_ratio}
                          for each in pose.alternatives])
    fields.update(lost_at_us=pose.latest_loss_t_us, loss_cause=pose.latest_loss_cause or None)
    return _text(make, fields)


def _transform_fields(transform):
    return {"translation_m": transform.translation_m.tolist(), "quaternion_xyzw": transform.quaternion_xyzw.tolist()}


def _text(make, fields):
    message = make()
    message.data = json.dumps(fields)
    return message


class StateChanges:
    """Finds the changes of the objects' states in successive healths: they also report states without a pose, such as LOST."""

    def __init__(self):
        self._states = {}

    def messages(self, make, health):
        """Returns [(object_id, std_msgs/String)] for the objects whose states differ from those of the last call; at first, all."""
        changed = [each for each in health.objects if self._states.get(each.object_id) != each.state]
        self._states.update((each.object_id, each.state) for each in changed)
        return [(each.object_id, _text(make, {"object_id": each.object_id, "t_us": health.t_us, "state": each.state.name}))
                for each in changed]


def diagnostics(make_array, make_status, make_value, health, session, stamp):
    """Returns a diagnostic_msgs/DiagnosticArray with a status for the session and one for each object."""
    array = make_array()
    array.header.stamp = stamp
    numbers = {
        "event rate [1/s]": health.event_rate_hz, "pose rate [1/s]": health.pose_rate_hz, "processing time / sensor time": health.real_time_ratio,
        "latency, median [ms]": health.latency_p50_s and 1e3 * health.latency_p50_s,
        "latency, 99th percentile [ms]": health.latency_p99_s and 1e3 * health.latency_p99_s,
        "events not tracked": health.skipped_events, "events dropped": health.dropped_events, "invalid words": health.invalid_words,
    }
    text = "falls behind the camera" if health.falls_behind else "keeps up with the camera"
    array.status.append(_status(make_status, make_value, "evpose", session, WARN if health.falls_behind else OK, text, numbers))
    for each in health.objects:
        numbers = {"explained ratio": each.explained_ratio, "losses": each.losses, "searches": each.initialization_attempts,
                   "latest loss": each.latest_loss_cause or None}
        text = each.state.name + (f": {each.detail}" if each.detail else "")
        level = _LEVELS.get(each.state, WARN)
        array.status.append(_status(make_status, make_value, f"evpose: {each.object_id}", session, level, text, numbers))
    return array


def _status(make_status, make_value, name, hardware, level, text, numbers):
    status = make_status()
    # A byte: an int in the Python of ROS 1, bytes in that of ROS 2.
    status.level = bytes([level]) if isinstance(status.level, bytes) else level
    status.name, status.message, status.hardware_id = name, text, hardware
    for key, number in numbers.items():
        if number is not None:
            value = make_value()
            value.key, value.value = key, f"{number:.6g}" if isinstance(number, float) else str(number)
            status.values.append(value)
    return status

# SPDX-License-Identifier: Apache-2.0
"""Poses one by one, or as a structured array."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import Any, Callable, Iterable, Optional, Sequence, Union

import numpy as np
import numpy.typing as npt

from evpose.convert import latest_loss, seconds
from evpose.errors import InvalidArgumentError
from evpose.geometry import Matrix, Transform, quaternion_from_message, transform_from_message
from evpose.types import TrackState

# A pose that competes with the reported one (Alternative).
ALTERNATIVE_DTYPE = np.dtype([
    ("translation_m", np.float64, (3,)),
    ("quaternion_xyzw", np.float64, (4,)),
    ("log_likelihood_ratio", np.float64),
])
_MAX_ALTERNATIVES = 4  # Pose.alternatives in proto/evpose/v1/session.proto

# One row for each pose. Transforms are camera_from_object; `object` is the index in Session.object_ids.
POSE_DTYPE = np.dtype([
    ("seq", np.uint64),
    ("object", np.uint8),
    ("t_us", np.int64),
    ("translation_m", np.float64, (3,)),
    ("quaternion_xyzw", np.float64, (4,)),
    ("covariance", np.float64, (6, 6)),
    ("twist", np.float64, (6,)),
    ("state", np.uint8),
    ("num_events", np.uint32),
    ("explained_ratio", np.float32),
    ("residual_rms_px", np.float32),
    ("latency_s", np.float64),
    ("num_alternatives", np.uint8),
    ("alternatives", ALTERNATIVE_DTYPE, (_MAX_ALTERNATIVES,)),  # the first num_alternatives; the others are zero
])

# The known states in which the server sends poses; it may send those of a state that is unknown here. AMBIGUOUS poses are not confirmed.
WITH_POSE = frozenset((TrackState.TRACKING, TrackState.DEGRADED, TrackState.AMBIGUOUS))

_UPPER = np.triu_indices(6)
# The position in the upper triangle, row by row, of each element of the symmetric matrix.
_FROM_UPPER = np.zeros((6, 6), dtype=np.intp)
_FROM_UPPER[_UPPER] = np.arange(21)
_FROM_UPPER = np.maximum(_FROM_UPPER, _FROM_UPPER.T)


@dataclasses.dataclass(frozen=True)
class Alternative:
    """A pose that competes with the reported one; log_likelihood_ratio 0 means equally likely."""

    camera_from_object: Transform
    log_likelihood_ratio: float


@dataclasses.dataclass(frozen=True)
class Pose:
    """The pose of one object at one time.

    seq               1, 2, 3, ... in the session
    t_us              sensor time of the pose, microseconds
    translation_m     of camera_from_object, metres, shape (3,)
    quaternion_xyzw   of camera_from_object, w >= 0, shape (4,)
    covariance        of [tx ty tz rx ry rz], a perturbation on the left in the camera frame, m and rad, shape (6, 6)
    twist             [vx vy vz wx wy wz] in the camera frame, m/s and rad/s, shape (6,)
    state             TRACKING, DEGRADED or AMBIGUOUS
    num_events        events in the gate
    explained_ratio   fraction of them that the model's lines explain
    residual_rms_px   root mean square of the residuals
    latency_s         from the receipt of the last events to the pose, on the server's clock; the only field that is not a
                      function of the session's bytes
    alternatives      with AMBIGUOUS: the other likely poses, at most 4, the most likely first
    latest_loss_t_us  sensor time of the object's latest loss before this pose, microseconds; None before its first loss
    latest_loss_cause such as "OUT_OF_VIEW"; "" before the first loss
    """

    seq: int
    object_id: str
    t_us: int
    translation_m: Matrix
    quaternion_xyzw: Matrix
    covariance: Matrix
    twist: Matrix
    state: TrackState
    num_events: int
    explained_ratio: float
    residual_rms_px: float
    latency_s: float
    alternatives: tuple[Alternative, ...]
    latest_loss_t_us: Optional[int] = None
    latest_loss_cause: str = ""

    @property
    def camera_from_object(self) -> Transform:
        """The pose as a transform: x_camera = camera_from_object * x_object."""
        return Transform(self.translation_m, self.quaternion_xyzw)

    def at(self, t_us: int) -> Transform:
        """Returns camera_from_object at another sensor time, microseconds, if the twist is constant in between. The acceleration a of
        the object adds an error of a dt^2 / 2."""
        return self.camera_from_object.perturbed(1e-6 * (t_us - self.t_us) * self.twist)


def _converted(pose: Pose, convert: Callable[[Transform], Transform], jacobian: Matrix) -> Pose:
    transform = convert(pose.camera_from_object)
    covariance = jacobian @ pose.covariance @ jacobian.T
    return dataclasses.replace(
        pose, translation_m=transform.translation_m, quaternion_xyzw=transform.quaternion_xyzw,
        covariance=0.5 * (covariance + covariance.T), twist=jacobian @ pose.twist,
        alternatives=tuple(dataclasses.replace(each, camera_from_object=convert(each.camera_from_object)) for each in pose.alternatives))


def in_world(pose: Pose, world_from_camera: Transform) -> Pose:
    """Returns the pose in a frame in which the camera is at rest, such as that of a robot: world_from_object, as
    `evpose replay --world-from-camera` writes it. The covariance is of a perturbation on the left in that frame; the twist is the velocity
    of the object's origin, and the rotation rate, in its axes. In the result, camera_from_object is world_from_object."""
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = world_from_camera.rotation
    return _converted(pose, lambda transform: world_from_camera @ transform, jacobian)


def of_camera(pose: Pose) -> Pose:
    """Returns the pose of a moving camera in the frame of an object at rest: object_from_camera, as `evpose replay --pose
    object-from-camera` writes it, with its covariance and twist. In the result, camera_from_object is object_from_camera."""
    rotation, t = pose.camera_from_object.rotation.T, pose.translation_m
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = -rotation
    jacobian[:3, 3:] = -rotation @ np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    return _converted(pose, Transform.inverse, jacobian)


def _twist(message: Any) -> list[float]:
    linear, angular = message.twist.linear_m_per_s, message.twist.angular_rad_per_s
    return [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]


def defect(message: Any) -> str:
    """Returns why a message of the server is no pose; "" if it is one."""
    if len(message.covariance.upper_triangle) != 21:
        return "covariance does not have 21 numbers"
    if not message.HasField("twist"):
        return "twist is missing"
    if message.state in (TrackState.INITIALIZING, TrackState.LOST):
        return f"the state {TrackState(message.state).name} has no pose"
    try:
        quaternion_from_message(message.camera_from_object.rotation)
        for alternative in message.alternatives:
            quaternion_from_message(alternative.camera_from_object.rotation)
    except ValueError as error:
        return str(error)
    return ""


def pose_from_message(message: Any) -> Pose:
    """Converts a message without defect()."""
    transform = transform_from_message(message.camera_from_object)
    loss_t_us, loss_cause = latest_loss(message)
    return Pose(
        seq=message.pose_seq, object_id=message.object_id, t_us=message.t_us, translation_m=transform.translation_m,
        quaternion_xyzw=transform.quaternion_xyzw, covariance=np.array(message.covariance.upper_triangle)[_FROM_UPPER],
        twist=np.array(_twist(message)), state=TrackState(message.state), num_events=message.num_events,
        explained_ratio=message.explained_ratio, residual_rms_px=message.residual_rms_px, latency_s=seconds(message.latency),
        alternatives=tuple(
            Alternative(transform_from_message(each.camera_from_object), each.log_likelihood_ratio) for each in message.alternatives),
        latest_loss_t_us=loss_t_us, latest_loss_cause=loss_cause)


def poses_from_messages(messages: Iterable[Any], object_ids: Sequence[str]) -> npt.NDArray[Any]:
    """Converts messages without defect() to an array of POSE_DTYPE, shape (n,)."""
    index = {object_id: i for i, object_id in enumerate(object_ids)}
    rows = []
    alternatives = []  # (row, its alternatives)
    for m in messages:
        t = m.camera_from_object.translation_m
        rows.append((m.pose_seq, index[m.object_id], m.t_us, (t.x, t.y, t.z), quaternion_from_message(m.camera_from_object.rotation),
                     m.covariance.upper_triangle[:], _twist(m), TrackState(m.state), m.num_events, m.explained_ratio,
                     m.residual_rms_px, seconds(m.latency), min(len(m.alternatives), _MAX_ALTERNATIVES)))
        if m.alternatives:
            alternatives.append((len(rows) - 1, m.alternatives[:_MAX_ALTERNATIVES]))
    poses = np.zeros(len(rows), dtype=POSE_DTYPE)
    if rows:
        for name, column in zip(POSE_DTYPE.names or (), zip(*rows)):
            values = np.array(column)
            poses[name] = values[:, _FROM_UPPER] if name == "covariance" else values
    for row, others in alternatives:
        for i, other in enumerate(others):
            t = other.camera_from_object.translation_m
            poses["alternatives"][row, i] = ((t.x, t.y, t.z), quaternion_from_message(other.camera_from_object.rotation),
                                             other.log_likelihood_ratio)
    return poses


def write_tum(path: Union[str, pathlib.Path], poses: npt.NDArray[Any]) -> None:
    """Writes the rows of an array of POSE_DTYPE as TUM: timestamp (seconds of the sensor's clock) tx ty tz qx qy qz qw. As in the
    files of `evpose replay`, poses that are AMBIGUOUS are left out. Raises InvalidArgumentError, without a change of the file, if there
    are poses and all of them are AMBIGUOUS; OSError."""
    is_written = poses["state"] != TrackState.AMBIGUOUS
    if len(poses) > 0 and not is_written.any():
        raise InvalidArgumentError(f"{path}: every pose is AMBIGUOUS, and a TUM file has none of them; save the array instead, "
                                   "for example with numpy.save, which keeps the alternatives")
    with open(path, "w", encoding="ascii") as file:
        for pose in poses[is_written]:
            numbers = (*pose["translation_m"].tolist(), *pose["quaternion_xyzw"].tolist())
            whole_s, micros = divmod(int(pose["t_us"]), 1_000_000)
            file.write(f"{whole_s}.{micros:06d} " + " ".join(f"{number:.17g}" for number in numbers) + "\n")

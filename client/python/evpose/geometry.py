# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms. A transform is named target_from_source: x_camera = camera_from_object * x_object."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Sequence

import numpy as np
import numpy.typing as npt

from evpose.errors import InvalidArgumentError
from evpose.v1 import geometry_pb2

Matrix = npt.NDArray[np.float64]
# Deviation from 1 of the norm of a quaternion that is accepted, as in the API.
_NORM_TOLERANCE = 1e-3


def _norm(q: Sequence[float]) -> float:
    # The order of the sums is that of Eigen's packets, so that poses have the bits of the C++ client.
    return math.sqrt((q[0] * q[0] + q[2] * q[2]) + (q[1] * q[1] + q[3] * q[3]))


def _rows_of_quaternion(q: Sequence[float]) -> list[list[float]]:
    """Returns the rotation matrix of a unit quaternion x y z w, with the operations of Eigen's toRotationMatrix()."""
    x, y, z, w = q
    tx, ty, tz = 2.0 * x, 2.0 * y, 2.0 * z
    twx, twy, twz = tx * w, ty * w, tz * w
    txx, txy, txz = tx * x, ty * x, tz * x
    tyy, tyz, tzz = ty * y, tz * y, tz * z
    return [
        [1.0 - (tyy + tzz), txy - twz, txz + twy],
        [txy + twz, 1.0 - (txx + tzz), tyz - twx],
        [txz - twy, tyz + twx, 1.0 - (txx + tyy)],
    ]


def _quaternion_of_rows(m: Sequence[Sequence[float]]) -> list[float]:
    """Returns the unit quaternion x y z w, w >= 0, of a rotation matrix, with the operations of Eigen."""
    q = [0.0, 0.0, 0.0, 0.0]
    trace = m[0][0] + (m[1][1] + m[2][2])
    if trace > 0.0:
        root = math.sqrt(trace + 1.0)
        q[3] = 0.5 * root
        scale = 0.5 / root
        q[0] = (m[2][1] - m[1][2]) * scale
        q[1] = (m[0][2] - m[2][0]) * scale
        q[2] = (m[1][0] - m[0][1]) * scale
    else:
        i = 1 if m[1][1] > m[0][0] else 0
        i = 2 if m[2][2] > m[i][i] else i
        j, k = (i + 1) % 3, (i + 2) % 3
        root = math.sqrt(m[i][i] - m[j][j] - m[k][k] + 1.0)
        q[i] = 0.5 * root
        scale = 0.5 / root
        q[3] = (m[k][j] - m[j][k]) * scale
        q[j] = (m[j][i] + m[i][j]) * scale
        q[k] = (m[k][i] + m[i][k]) * scale
    norm = _norm(q)
    sign = -1.0 if q[3] < 0.0 else 1.0
    return [sign * (value / norm) for value in q]


def _rows_of_any(q: Sequence[float]) -> list[list[float]]:
    norm = _norm(q)
    return _rows_of_quaternion([value / norm for value in q])


def _vector(values: npt.ArrayLike, count: int, name: str) -> Matrix:
    """Returns an array of `count` finite numbers. Raises InvalidArgumentError with `name`."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):  # NumPy: not numbers, or lists of different lengths
        raise InvalidArgumentError(f"{name}: is not an array of numbers") from None
    if array.shape != (count,):
        raise InvalidArgumentError(f"{name}: has the shape {array.shape}, but must have {count} numbers, shape ({count},)")
    if not np.isfinite(array).all():
        raise InvalidArgumentError(f"{name}: every number must be finite")
    return array


@dataclasses.dataclass(frozen=True)
class Transform:
    """A rotation followed by a translation.

    translation_m     metres, in the target's frame; shape (3,)
    quaternion_xyzw   unit quaternion x y z w, w >= 0; shape (4,)
    """

    translation_m: Matrix
    quaternion_xyzw: Matrix

    @staticmethod
    def from_quaternion(translation_m: npt.ArrayLike, quaternion_xyzw: npt.ArrayLike) -> Transform:
        """Makes a transform of a translation and a quaternion x y z w of norm 1 to within 1e-3.

        Raises InvalidArgumentError."""
        t = _vector(translation_m, 3, "translation_m")
        q = _vector(quaternion_xyzw, 4, "quaternion_xyzw")
        if not abs(_norm(q.tolist()) - 1.0) <= _NORM_TOLERANCE:
            raise InvalidArgumentError(
                f"quaternion: its norm is {_norm(q.tolist()):.6g}, but must be 1 to within 1e-3; normalise it (order x y z w)")
        return Transform(t, np.array(_quaternion_of_rows(_rows_of_any(q.tolist()))))

    @staticmethod
    def from_matrix(matrix: npt.ArrayLike) -> Transform:
        """Makes a transform of a homogeneous 4x4 (or 3x4) matrix. Raises InvalidArgumentError."""
        try:
            m = np.asarray(matrix, dtype=np.float64)
        except (TypeError, ValueError):
            raise InvalidArgumentError("transform: is not an array of numbers") from None
        if m.shape not in ((4, 4), (3, 4)):
            raise InvalidArgumentError(f"a transform is a 4x4 or 3x4 matrix, not one of shape {m.shape}")
        rotation = m[:3, :3]
        if not np.isfinite(m).all() or not np.allclose(rotation @ rotation.T, np.eye(3), atol=_NORM_TOLERANCE):
            raise InvalidArgumentError("transform: the upper left 3x3 part is not a rotation")
        if np.linalg.det(rotation) < 0.0:
            raise InvalidArgumentError("transform: the upper left 3x3 part is a reflection; its determinant must be 1")
        return Transform(m[:3, 3].copy(), np.array(_quaternion_of_rows(rotation.tolist())))

    @property
    def rotation(self) -> Matrix:
        """The rotation matrix, shape (3, 3)."""
        return np.array(_rows_of_any(self.quaternion_xyzw.tolist()))

    @property
    def matrix(self) -> Matrix:
        """The homogeneous matrix, shape (4, 4)."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = self.translation_m
        return m

    def perturbed(self, tangent: npt.ArrayLike) -> Transform:
        """Returns the transform after a perturbation [tx ty tz rx ry rz] on the left, m and rad: the rotation vector turns the source
        about its origin, in the target frame. Raises InvalidArgumentError."""
        xi = _vector(tangent, 6, "tangent")
        angle = float(np.linalg.norm(xi[3:]))
        half_sinc = 0.5 if angle == 0.0 else math.sin(0.5 * angle) / angle
        x, y, z, w = (*(half_sinc * xi[3:]), math.cos(0.5 * angle))
        qx, qy, qz, qw = self.quaternion_xyzw
        turned = [w * qx + x * qw + y * qz - z * qy, w * qy - x * qz + y * qw + z * qx,
                  w * qz + x * qy - y * qx + z * qw, w * qw - x * qx - y * qy - z * qz]
        return Transform.from_quaternion(self.translation_m + xi[:3], turned)

    def __matmul__(self, other: Transform) -> Transform:
        """world_from_camera @ camera_from_object is world_from_object."""
        return Transform.from_matrix(self.matrix @ other.matrix)

    def inverse(self) -> Transform:
        """source_from_target."""
        rotation = self.rotation.T
        return Transform(-rotation @ self.translation_m, np.array(_quaternion_of_rows(rotation.tolist())))

    def to_proto(self) -> Any:
        """Returns the transform as a message of the API. Raises InvalidArgumentError."""
        x, y, z = _vector(self.translation_m, 3, "translation_m").tolist()
        return geometry_pb2.RigidTransform(translation_m={"x": x, "y": y, "z": z}, rotation=rotation_to_proto(self.quaternion_xyzw))


def rotation_to_proto(quaternion_xyzw: npt.ArrayLike, name: str = "quaternion_xyzw") -> Any:
    """Returns a quaternion x y z w as a message of the API. Raises InvalidArgumentError with `name`."""
    x, y, z, w = _vector(quaternion_xyzw, 4, name).tolist()
    return geometry_pb2.Quaternion(x=x, y=y, z=z, w=w)


def quaternion_from_message(rotation: Any) -> list[float]:
    """Returns the quaternion x y z w of a message, as the C++ client returns it. Raises ValueError if it is not unit."""
    q = [rotation.x, rotation.y, rotation.z, rotation.w]
    if not abs(_norm(q) - 1.0) <= _NORM_TOLERANCE:
        raise ValueError("the rotation is not a unit quaternion")
    return _quaternion_of_rows(_rows_of_any(q))


def transform_from_message(message: Any) -> Transform:
    """Raises ValueError if the rotation is not a unit quaternion."""
    t = message.translation_m
    return Transform(np.array([t.x, t.y, t.z]), np.array(quaternion_from_message(message.rotation)))

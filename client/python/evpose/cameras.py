# SPDX-License-Identifier: Apache-2.0
"""Cameras, from ROS camera_info YAML or the output of `evpose camera --json`."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from evpose.errors import InvalidArgumentError
from evpose.files import PathLike, read_yaml, to_number, to_text
from evpose.v1 import geometry_pb2

# Numbers of distortion coefficients by the name of the lens model: k1 k2 p1 p2 [k3]; k1 k2 p1 p2 k3 k4 k5 k6; k1 k2 k3 k4.
_COUNTS = {"brown": (0, 4, 5), "rational": (8,), "fisheye": (4,)}
# The names of ROS, and those by which other tools call the same models.
_ROS_MODELS = {"plumb_bob": "brown", "radtan": "brown", "rational_polynomial": "rational", "equidistant": "fisheye", "fisheye": "fisheye",
               "kannala_brandt": "fisheye"}


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole camera with distortion. Pixel (0, 0) is the centre of the top-left pixel; all lengths are pixels.

    distortion    brown: k1 k2 p1 p2 k3, or empty; rational: k1 k2 p1 p2 k3 k4 k5 k6; fisheye: k1 k2 k3 k4
    lens_model    "brown" (plumb_bob), "rational" or "fisheye" (equidistant)
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    lens_model: str = "brown"

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px"):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) > 0):
                raise InvalidArgumentError(f"camera: {name} is {getattr(self, name)!r}, but must be a positive integer")
        for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
            if not math.isfinite(getattr(self, name)):
                raise InvalidArgumentError(f"camera: {name} is not a finite number")
        if self.fx_px <= 0.0 or self.fy_px <= 0.0:
            raise InvalidArgumentError("camera: fx_px and fy_px must be positive")
        if self.lens_model not in _COUNTS:
            raise InvalidArgumentError(f"camera: lens_model is {self.lens_model!r}, but must be one of {', '.join(_COUNTS)}")
        counts = _COUNTS[self.lens_model]
        if len(self.distortion) not in counts:
            wanted = " or ".join(map(str, counts))
            raise InvalidArgumentError(
                f"camera: distortion has {len(self.distortion)} numbers, but the lens model {self.lens_model} has {wanted}")
        if not all(map(math.isfinite, self.distortion)):
            raise InvalidArgumentError("camera: distortion: every number must be finite")

    def to_proto(self) -> Any:
        """Returns the camera as a message of the API."""
        # The API has all five coefficients of the Brown model or none.
        distortion = (*self.distortion, 0.0) if self.lens_model == "brown" and len(self.distortion) == 4 else self.distortion
        return geometry_pb2.CameraModel(
            width_px=self.width_px, height_px=self.height_px, fx_px=self.fx_px, fy_px=self.fy_px, cx_px=self.cx_px,
            cy_px=self.cy_px, distortion=distortion, lens_model=f"LENS_MODEL_{self.lens_model.upper()}")


def read_camera(path: PathLike) -> Camera:
    """Reads ROS camera_info YAML, or what `evpose camera --json` prints for any other camera file.

    Raises NotFoundError, and InvalidArgumentError with the file and the key."""
    data = read_yaml(path, "; not a camera file")
    if not isinstance(data, dict):
        raise InvalidArgumentError(f"{path}: not a camera file: it has no keys")
    try:
        return _from_evpose(data) if "fx_px" in data else _from_camera_info(data)
    except InvalidArgumentError as error:
        raise error.with_message(f"{path}: {error}") from None


def _numbers(data: dict[str, Any], key: str) -> list[float]:
    """Returns the numbers of a list, or of the list `data` of a matrix."""
    value = data.get(key)
    if isinstance(value, dict):
        value = value.get("data")
    if not isinstance(value, list):
        raise InvalidArgumentError(f"{key}: a list of numbers is missing")
    return [to_number(item, key) for item in value]


def _integer(data: dict[str, Any], key: str) -> int:
    number = to_number(data.get(key), key)
    if not number.is_integer():
        raise InvalidArgumentError(f"{key}: {data[key]!r} is not a whole number")
    return int(number)


def _from_evpose(data: dict[str, Any]) -> Camera:
    """Reads the object of `evpose camera --json`: width, height, lens_model, fx_px, fy_px, cx_px, cy_px, distortion."""
    return Camera(
        width_px=_integer(data, "width"), height_px=_integer(data, "height"), fx_px=to_number(data.get("fx_px"), "fx_px"),
        fy_px=to_number(data.get("fy_px"), "fy_px"), cx_px=to_number(data.get("cx_px"), "cx_px"), cy_px=to_number(data.get("cy_px"), "cy_px"),
        distortion=tuple(_numbers(data, "distortion")), lens_model=to_text(data.get("lens_model", "brown"), "lens_model"))


def _lens_of_camera_info(data: dict[str, Any]) -> tuple[str, list[float]]:
    """Returns the lens model and its coefficients."""
    key = "distortion_coefficients"
    model = to_text(data.get("distortion_model") or "", "distortion_model").strip().lower()
    is_stated = model not in ("", "none")
    coefficients = _numbers(data, key) if is_stated or data.get(key) else []
    if not is_stated and not any(coefficients):
        return "brown", []
    if model == "none":
        raise InvalidArgumentError(f"distortion_model: is none, but {key} are not 0; set it to plumb_bob")
    if not model and len(coefficients) not in (4, 5):
        raise InvalidArgumentError(f"distortion_model: is missing, and {key} has {len(coefficients)} numbers; "
                                   "give plumb_bob (4 or 5), rational_polynomial (8) or equidistant (4)")
    if model and model not in _ROS_MODELS:
        raise InvalidArgumentError(
            f"distortion_model: {model!r} is not supported; it must be plumb_bob, rational_polynomial, equidistant or none")
    lens_model = _ROS_MODELS.get(model, "brown")
    if lens_model == "rational" and len(coefficients) in (12, 14) and not any(coefficients[8:]):
        coefficients = coefficients[:8]  # OpenCV writes the thin prism, too
    return lens_model, coefficients


def _from_camera_info(data: dict[str, Any]) -> Camera:
    lens_model, coefficients = _lens_of_camera_info(data)
    matrix = _numbers(data, "camera_matrix")
    if len(matrix) != 9:
        raise InvalidArgumentError(f"camera_matrix: has {len(matrix)} numbers, but needs 9")
    if [matrix[i] for i in (1, 3, 6, 7, 8)] != [0.0, 0.0, 0.0, 0.0, 1.0]:
        raise InvalidArgumentError("camera_matrix: must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], row by row, without skew")
    return Camera(
        width_px=_integer(data, "image_width"), height_px=_integer(data, "image_height"), fx_px=matrix[0], fy_px=matrix[4],
        cx_px=matrix[2], cy_px=matrix[5], distortion=tuple(coefficients), lens_model=lens_model)

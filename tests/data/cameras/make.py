#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the camera files of this folder with the software that users write them with; SOURCE.txt names it. OpenCV calibrates three
lenses from images of a chessboard whose corners its own functions have projected, rounded to 1/100 px. The
other programs write the same results.

  cd tests/data/cameras && KALIBR=FOLDER_OF_KALIBR /usr/bin/python3 make.py

It needs Debian's python3-opencv, python3-camera-calibration, python3-sensor-msgs and colmap, and a clone of Kalibr."""

import importlib.util
import os
import struct
import subprocess
import sys
import tempfile
import types

import cv2
import numpy

SIZE = (1280, 720)
CAMERA = numpy.array([[1020.0, 0.0, 645.5], [0.0, 1018.0, 356.25], [0.0, 0.0, 1.0]])
BROWN = numpy.array([-0.31, 0.12, 0.0008, -0.0005, -0.02])
RATIONAL = numpy.array([0.4, 0.1, 0.0005, -0.0004, 0.01, 0.7, 0.2, 0.03])
FISHEYE = numpy.array([0.05, -0.01, 0.004, -0.001])


def board():
    grid = numpy.mgrid[0:9, 0:6].T.reshape(-1, 2) * 0.03
    return numpy.hstack([grid - grid.mean(axis=0), numpy.zeros((54, 1))])


def poses():
    """Rotation vectors and positions of 24 views: tilted to all sides, in all parts of the image."""
    for i in range(24):
        yield (numpy.array([0.5 * numpy.cos(i), 0.5 * numpy.sin(2.0 * i), 0.3 * numpy.sin(i)]),
               numpy.array([0.17 * numpy.cos(2.6 * i), 0.08 * numpy.sin(3.7 * i), 0.45 + 0.1 * numpy.sin(i)]))


def calibrate(distortion, flags):
    project = cv2.fisheye.projectPoints if flags is None else cv2.projectPoints
    points = [board().astype(numpy.float32).reshape(-1, 1, 3) for _ in poses()]
    images = [numpy.round(100.0 * project(board().reshape(-1, 1, 3), *pose, CAMERA, distortion)[0].reshape(-1, 1, 2)) / 100.0
              for pose in poses()]
    images = [image.astype(numpy.float32) for image in images]
    if flags is None:
        points = [each.astype(numpy.float64).reshape(1, -1, 3) for each in points]
        images = [each.astype(numpy.float64).reshape(1, -1, 2) for each in images]
        fit = cv2.fisheye.calibrate(points, images, SIZE, CAMERA.copy(), numpy.zeros((4, 1)), flags=cv2.fisheye.CALIB_USE_INTRINSIC_GUESS +
                                    cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC + cv2.fisheye.CALIB_FIX_SKEW)
    else:
        fit = cv2.calibrateCamera(points, images, SIZE, None, None, flags=flags)
    print(f"reprojection error {fit[0]:.4f} px")
    return fit[1], fit[2]


def write_opencv(path, matrix, coefficients, extra=()):
    """The names of OpenCV's sample calibration.cpp."""
    file = cv2.FileStorage(path, cv2.FILE_STORAGE_WRITE)
    file.write("image_width", SIZE[0])
    file.write("image_height", SIZE[1])
    for name, value in extra:
        file.write(name, value)
    file.write("camera_matrix", matrix)
    file.write("distortion_coefficients", coefficients)
    file.release()


def import_file(path, stubs):
    """A module whose imports that do not matter here are replaced."""
    for name in stubs:
        sys.modules.setdefault(name, types.ModuleType(name))
    spec = importlib.util.spec_from_file_location("foreign", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_ros(matrix, coefficients):
    package = importlib.util.find_spec("sensor_msgs").submodule_search_locations[0]
    calibrator = import_file(os.path.join(os.path.dirname(package), "camera_calibration/calibrator.py"), ["cv_bridge", "image_geometry"])
    projection = numpy.hstack([matrix, numpy.zeros((3, 1))])
    text = calibrator.Calibrator.lryaml("evk4", coefficients, matrix, numpy.eye(3), projection, SIZE, calibrator.CAMERA_MODEL.PINHOLE)
    with open("ros_calibrator.yaml", "w") as file:
        file.write(text)
    from sensor_msgs.msg import CameraInfo  # pylint: disable=import-outside-toplevel
    message = CameraInfo(width=SIZE[0], height=SIZE[1], distortion_model="plumb_bob", D=coefficients.ravel().tolist(),
                         K=matrix.ravel().tolist(), R=numpy.eye(3).ravel().tolist(), P=projection.ravel().tolist())
    message.header.frame_id = "evk4"
    with open("ros_message.txt", "w") as file:
        file.write(str(message) + "\n---\n")  # as `rostopic echo` prints it


def write_kalibr(brown, fisheye):
    reader = import_file(os.path.join(os.environ["KALIBR"], "aslam_offline_calibration/kalibr/python/kalibr_common/ConfigReader.py"),
                         ["aslam_cv", "aslam_cv_backend", "sm"])
    chain = reader.CameraChainParameters("camchain.yaml", createYaml=True)
    for index, (model, (matrix, coefficients)) in enumerate([("radtan", brown), ("equidistant", fisheye)]):
        camera = reader.CameraParameters("camchain.yaml", createYaml=True)
        camera.setRosTopic(f"/cam{index}/image_raw")
        camera.setIntrinsics("pinhole", [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
        camera.setDistortion(model, coefficients.ravel()[:4])
        camera.setResolution(list(SIZE))
        chain.addCameraAtEnd(camera)
        chain.setCamOverlaps(index, [])
    chain.writeYaml("kalibr_camchain.yaml")


def write_colmap(matrix, coefficients):
    """COLMAP converts a model in its binary format without points to text."""
    with tempfile.TemporaryDirectory() as folder:
        with open(os.path.join(folder, "cameras.bin"), "wb") as file:
            parameters = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + 0.5, matrix[1, 2] + 0.5, *coefficients.ravel()[:4]]
            file.write(struct.pack("<QIiQQ8d", 1, 1, 4, *SIZE, *parameters))  # 4: OPENCV
        for name in ("images.bin", "points3D.bin"):
            with open(os.path.join(folder, name), "wb") as file:
                file.write(struct.pack("<Q", 0))
        subprocess.run(["colmap", "model_converter", "--input_path", folder, "--output_path", folder, "--output_type", "TXT"], check=True)
        with open(os.path.join(folder, "cameras.txt")) as text, open("colmap_cameras.txt", "w") as file:
            file.write(text.read())


brown, rational, fisheye = calibrate(BROWN, 0), calibrate(RATIONAL, cv2.CALIB_RATIONAL_MODEL), calibrate(FISHEYE, None)
write_opencv("opencv_brown.yml", *brown)
write_opencv("opencv_rational.xml", *rational)
write_opencv("opencv_fisheye.json", *fisheye, extra=[("fisheye_model", 1)])
write_ros(*brown)
write_kalibr(brown, fisheye)
write_colmap(*brown)

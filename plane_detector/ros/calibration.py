# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of CameraInfo to a camera model, and of a camera model to CameraInfo."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from plane_detector.types import CameraIntrinsics


class Distortion(NamedTuple):
    """Distortion of an image: model and coefficients as in sensor_msgs/CameraInfo."""

    model: str
    coefficients: tuple[float, ...]


MODEL_NAMES = {'': 'plumb_bob', 'fisheye': 'equidistant', 'kannala_brandt4': 'equidistant'}
"""Names in sensor_msgs of distortion models for which drivers use other names."""
NO_DISTORTION = Distortion('plumb_bob', (0.0,) * 5)


def camera_info_to_msg(header: Header, intrinsics: CameraIntrinsics,
                       distortion: Distortion = NO_DISTORTION) -> CameraInfo:
    """Return the calibration of images with this header, rectified or not, reduced or not."""
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    return CameraInfo(
        header=header, width=intrinsics.width, height=intrinsics.height,
        distortion_model=distortion.model, d=list(distortion.coefficients),
        k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], r=np.eye(3).ravel().tolist(),
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0])


def intrinsics_from_msg(msg: CameraInfo, rectified: bool = False) -> CameraIntrinsics:
    """
    Return the pinhole model of the published image: from P, if it is rectified and has P, else
    from K.

    Binning and region of interest are applied as image_geometry's PinholeCameraModel does. Raises
    ValueError if that matrix is all zeros (the camera is not calibrated) or not finite, or the
    image has no size.
    """
    has_p = rectified and msg.p[0] != 0
    if not (has_p or np.any(msg.k)):
        raise ValueError('the K of the CameraInfo is zero, so the camera is not calibrated; '
                         'calibrate it, or make its driver load the calibration' + (
            f'. But its P has fx {msg.p[0]:g} px: if the images are rectified, remap to a topic '
            'whose name says so, as image_rect' if msg.p[0] and not rectified else ''))
    (fx, _, cx), (_, fy, cy) = (np.reshape(msg.p, (3, 4))[:2, :3] if has_p
                                else np.reshape(msg.k, (3, 3))[:2]).tolist()
    every_x, every_y = max(msg.binning_x, 1), max(msg.binning_y, 1)
    return CameraIntrinsics(fx / every_x, fy / every_y, (cx - msg.roi.x_offset) / every_x,
                            (cy - msg.roi.y_offset) / every_y, *image_size(msg))


def image_size(msg: CameraInfo) -> tuple[int, int]:
    """Return width and height of the published image: cropped, then binned."""
    width, height = msg.roi.width or msg.width, msg.roi.height or msg.height
    return width // max(msg.binning_x, 1), height // max(msg.binning_y, 1)

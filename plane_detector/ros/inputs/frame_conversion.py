# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From the messages of a frame to the inputs of the pipeline: rectified image, camera, depth."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, PointCloud2

from plane_detector.config import DepthConfig, NodeConfig
from plane_detector.geometry.rectification import Rectification, Reduction, make_rectification
from plane_detector.ros.calibration import (
    MODEL_NAMES,
    NO_DISTORTION,
    Distortion,
    image_size,
    intrinsics_from_msg,
)
from plane_detector.ros.inputs import image_decoding as encodings
from plane_detector.ros.inputs.depth_decoding import check_rays, depth_from_msg
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.types import CameraIntrinsics

_TRANSPORTS = ('compressed', 'compressedDepth')
_RECTIFIED_NAMES = {'rect', 'rectified'}
_ASPECT_TOLERANCE = 0.02
_SAME_SURFACE = 0.02
# The colour of pixels if there is depth but no image.
_GREY = 128
_MOST_ENLARGED = 32  # chosen: twice that of 256 x 192 beside the 12 million pixels of a phone


@dataclass(frozen=True)
class ConvertedFrame:
    """Inputs of the pipeline."""

    rgb: np.ndarray  # (H, W, 3) uint8, rectified, with these intrinsics
    intrinsics: CameraIntrinsics
    depth_m: np.ndarray | None  # (H, W) float32, measured, NaN invalid
    covered: np.ndarray | None = None  # (H, W) bool, the original has pixels; None: everywhere
    distortion: Distortion = NO_DISTORTION  # that the image still has


class FrameConverter:
    """
    Converts frames; the maps of the rectification are cached until the calibration changes.

    The name of the image topic shows whether the images are rectified; ``depth`` is what is known
    of measured depth.
    """

    def __init__(self, image_topic: str, depth: DepthConfig | None = None):
        self._depth = depth or DepthConfig()
        self._named_rectified = is_rectified_name(image_topic)
        self._calibration: tuple[Any, ...] = ()
        self._rectification: Rectification | None = None

    def convert(self, frame: Frame, settings: NodeConfig) -> ConvertedFrame:
        """
        Decode and rectify the messages of a frame.

        Raises
        ------
        ValueError
            A message is invalid, or the messages do not fit together.

        """
        has_colour, most_pixels = self._depth.colour == 'image', settings.max_image_pixels
        measured, depth_m = frame.depth if has_colour else frame.image, None
        if measured is not None:
            depth_m = depth_from_msg(measured, most_pixels, self._depth.unit)
        rgb = (_decode(frame, most_pixels) if has_colour
               else np.full((*depth_m.shape, 3), _GREY, np.uint8))
        info = frame.camera_info
        if not (info.width and info.height):
            info = _with_size(info, rgb)
        is_distorted = bool(np.any(info.d)) and not self._named_rectified
        rectify = is_distorted if settings.rectify == 'auto' else settings.rectify == 'true'
        intrinsics = replace(intrinsics_from_msg(info, rectify or self._named_rectified),
                             is_guessed=settings.lens_is_guessed)
        size, expected = rgb.shape[1::-1], (intrinsics.width, intrinsics.height)
        if size != expected:
            raise ValueError(encodings.wrong_size(size, expected))
        if isinstance(measured, PointCloud2):
            check_rays(measured, intrinsics)
        reduction = Reduction.to_side(expected, settings.max_side)
        if not reduction.is_none:
            rgb, intrinsics = reduction.image(rgb), reduction.camera(intrinsics)
        if depth_m is not None:
            depth_m = _fit_depth(depth_m, intrinsics)
        if not rectify:
            left = Distortion(_model_of(info), tuple(info.d)) if is_distorted else NO_DISTORTION
            return ConvertedFrame(rgb, intrinsics, depth_m, distortion=left)
        rectification = self._rectification_of(info, reduction)
        depth_m = None if depth_m is None else rectification.depth(depth_m)
        return ConvertedFrame(rectification.image(rgb), intrinsics, depth_m,
                              rectification.inside())

    def _rectification_of(self, info: CameraInfo, reduction: Reduction) -> Rectification:
        calibration = (reduction, info.distortion_model, *info.d, *info.k, *info.r, *info.p,
                       info.binning_x, info.binning_y, info.width, info.height, info.roi.x_offset,
                       info.roi.y_offset, info.roi.width, info.roi.height)
        if self._rectification is None or calibration != self._calibration:
            self._rectification = _rectification_from_msg(info, reduction)
            self._calibration = calibration
        return self._rectification


def is_rectified_name(topic: str) -> bool:
    """Return whether a topic is rectified by the end of its name: image_rect, rect/image, ..."""
    parts = [part for part in topic.split('/') if part not in _TRANSPORTS]
    words = [word for part in parts[-2:] for word in part.split('_')]
    return not _RECTIFIED_NAMES.isdisjoint(words)


def _rectification_from_msg(info: CameraInfo, reduction: Reduction) -> Rectification:
    model = _model_of(info)
    no_distortion = np.zeros(4 if model == 'equidistant' else 5)
    # Checked, and without the elements of K and P that the pinhole model does not use.
    camera, rectified = (reduction.camera(intrinsics_from_msg(info, is_rectified)).matrix
                         for is_rectified in (False, True))
    return make_rectification(model, np.asarray(info.d) if np.any(info.d) else no_distortion,
                              camera, np.reshape(info.r, (3, 3)), rectified, reduction.new_size)


def _model_of(info: CameraInfo) -> str:
    return MODEL_NAMES.get(info.distortion_model, info.distortion_model)


def _decode(frame: Frame, most_pixels: int) -> np.ndarray:
    if isinstance(frame.image, CompressedImage):
        return encodings.rgb_from_compressed_msg(
            frame.image, image_size(frame.camera_info), most_pixels)
    encodings.check_pixels((frame.image.width, frame.image.height), most_pixels)
    return encodings.rgb_from_msg(frame.image)


def _with_size(info: CameraInfo, rgb: np.ndarray) -> CameraInfo:
    """Return a CameraInfo; if it has no size, with the size of the image."""
    height, width = rgb.shape[:2]
    sized = copy(info)
    sized.width, sized.height = width * max(info.binning_x, 1), height * max(info.binning_y, 1)
    return sized


def _fit_depth(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Resize registered depth to the image without depths between foreground and background.

    Both have the same field of view, and so the same aspect ratio. Within a surface, 1/depth is
    interpolated, because planes are linear in it. Where the result differs from the depth of the
    nearest pixel by more than 2 %, there is an edge, and the depth of the nearest pixel is used.
    """
    size, (height, width) = (intrinsics.width, intrinsics.height), depth_m.shape
    aspect = (width * intrinsics.height) / (height * intrinsics.width)
    if abs(aspect - 1) > _ASPECT_TOLERANCE:
        raise ValueError(f'the depth image is {width} x {height}, which does not have the aspect '
                         f'ratio of the {intrinsics.width} x {intrinsics.height} image: it must '
                         'be registered to it')
    if size == (width, height):
        return depth_m
    if size[0] > _MOST_ENLARGED * width:
        raise ValueError(f'the depth image is {width} x {height}, over {_MOST_ENLARGED} times '
                         f'smaller than the {size[0]} x {size[1]} image: reduce the image by '
                         'max_side')
    nearest_m = cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT)
    smooth_m = 1 / cv2.resize(1 / depth_m, size, interpolation=cv2.INTER_LINEAR)
    is_surface = np.abs(smooth_m - nearest_m) <= _SAME_SURFACE * nearest_m
    return np.where(is_surface, smooth_m, nearest_m)

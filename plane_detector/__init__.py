# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes from an ordinary colour camera.

The recipe is :class:`~plane_detector.pipeline.PlaneDetector`, one folder a move::

    seen = source.observe(rgb, intrinsics)            depth/         image to depth or disparity
    regions = segment(seen.disparity, noise_floor)    segmentation/  disparity to planar regions
    scale = estimate_scale(disparity, ray_planes)     scale/         what makes it metres, if any
    planes = measure_planes(regions.rescaled(scale))  planes/        normal, offset, extent, class
    labels = tracker.update(planes)                   tracking/      labels that stay

The node in ros/ does this for every image of a topic and publishes the result.

Examples
--------
>>> import numpy as np
>>> from plane_detector import CameraIntrinsics, PlaneDetector
>>> camera = CameraIntrinsics.from_field_of_view(320, 240, horizontal_deg=60.0)
>>> rows, _ = np.mgrid[:240, :320]
>>> floor_m = 1.2 * camera.fy / (rows - camera.cy)             # 1.2 m below the camera
>>> detector = PlaneDetector(depth_model=lambda rgb: floor_m)  # leave it out: the best network
>>> detection = detector.detect(np.zeros((240, 320, 3), np.uint8), camera)
>>> detection.planes[0].normal.round(3) + 0.0, round(detection.planes[0].offset_m, 3)
(array([ 0., -1.,  0.]), 1.2)

"""

from importlib import import_module
from typing import Any

_HOMES = {'CameraIntrinsics': 'types', 'Config': 'config', 'Detection': 'types', 'Plane': 'types',
          'PlaneDetector': 'pipeline', 'PlaneSegmentation': 'types',
          'segment_planes': 'pipeline'}
__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import a public name when it is asked for: all of them take a second, see ros/node."""
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_HOMES[name]}'), name)

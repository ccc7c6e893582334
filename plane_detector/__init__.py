# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Plane detection with an ordinary colour camera.

:class:`~plane_detector.pipeline.PlaneDetector` runs the stages; each has its own folder:

- depth/: image to depth or disparity
- directions/: lines of the image to vertical and horizontal axes
- segmentation/: disparity to planar regions
- scale/: scale and shift to metres
- planes/: normal, offset, extent, covariance, class
- ground/: ground, obstacles, drops
- tracking/: stable labels

The node in ros/ does this for the images of a topic and publishes the results.

Examples
--------
>>> import numpy as np
>>> from plane_detector import CameraIntrinsics, PlaneDetector
>>> camera = CameraIntrinsics.from_field_of_view(320, 240, horizontal_deg=60.0)
>>> rows, _ = np.mgrid[:240, :320]
>>> floor_m = 1.2 * camera.fy / (rows - camera.cy)             # 1.2 m below the camera
>>> detector = PlaneDetector(depth_model=lambda rgb: floor_m)  # default: the best network
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
PAGES = '$(ros2 pkg prefix --share plane_detector)/docs'
"""Where the pages of docs/ are installed, for messages and helps."""


def __getattr__(name: str) -> Any:
    """Import a public name on first access, because importing all of them takes a second."""
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_HOMES[name]}'), name)

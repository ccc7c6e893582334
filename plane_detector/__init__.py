# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes from an ordinary colour camera.

1. depth: a network estimates depth or disparity from the picture (ONNX Runtime);
2. segmentation: cells of 1/z are peeled plane by plane with RANSAC, largest first, and cleaned
   with DBSCAN in the grid of the picture;
3. scale: what fixes the unit of the depth is found, or the result says that nothing does;
4. measurement: the planes get normal, offset, extent and covariance in metres;
5. ros: the node does this for every image of a topic and publishes the result.
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

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

from plane_detector.config import Config
from plane_detector.pipeline import PlaneDetector
from plane_detector.segmentation import segment_planes
from plane_detector.types import CameraIntrinsics, Detection, Plane, PlaneSegmentation

__all__ = ['CameraIntrinsics', 'Config', 'Detection', 'Plane', 'PlaneDetector',
           'PlaneSegmentation', 'segment_planes']

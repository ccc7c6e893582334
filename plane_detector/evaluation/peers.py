# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Plane segmentation methods, ours and others, with a common interface.

The other methods are optional: `Method.absent` states why one is not available.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from plane_detector.config import Config, PaperConfig, SegmentationConfig
from plane_detector.evaluation.datasets import numbered
from plane_detector.evaluation.metrics import MIN_PIXELS
from plane_detector.evaluation.reference_planes import fit_planes
from plane_detector.geometry.projection import depth_to_points
from plane_detector.pipeline import segment_planes
from plane_detector.segmentation.baselines import paper_labels
from plane_detector.types import CameraIntrinsics, PlaneSegmentation

MIN_SHARE = MIN_PIXELS / (640 * 480)
"""Smallest plane of the other methods, as a share of the image."""
Segments = tuple[np.ndarray, np.ndarray]
"""Labels (H, W) int32, -1 for none, and planes (K, 4): unit normal to the camera, offset."""


class Method:
    """A plane segmentation method, in three steps of which the second is timed."""

    name = ''  # in the tables
    absent = ''  # why it is not available
    slow = False  # it takes seconds per image

    def prepare(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> Any:
        """Return the input of :meth:`run`."""
        return depth_m, intrinsics

    def run(self, prepared: Any) -> Any:
        """Segment."""
        raise NotImplementedError

    def result(self, raw: Any) -> Segments:
        """Convert the output of :meth:`run` to labels and planes."""
        raise NotImplementedError

    def __call__(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> Segments:
        """Run all three steps."""
        return self.result(self.run(self.prepare(depth_m, intrinsics)))


class Ours(Method):
    """`segment_planes` with its default settings."""

    name = 'plane_detector'

    def __init__(self, config: Config | None = None) -> None:
        self.config = config or Config()

    def run(self, prepared: Any) -> PlaneSegmentation:
        """Segment; from depth to labels of all pixels and measured planes."""
        return segment_planes(*prepared, self.config)

    def result(self, raw: PlaneSegmentation) -> Segments:
        """Return labels and planes of a segmentation."""
        return raw.labels, plane_array(raw)


class Paper(Ours):
    """The paper's method: sequential RANSAC of pyRANSAC-3D, then DBSCAN."""

    name = f'paper, {PaperConfig.max_points} points'
    slow = True

    def __init__(self) -> None:
        super().__init__(Config(segmentation=SegmentationConfig(method='paper')))
        try:
            import pyransac3d  # noqa: F401
        except ImportError as error:
            self.absent = f'pyransac3d does not load: {error}'


class PlainRansac(Paper):
    """The paper's RANSAC without its clustering."""

    name = f'RANSAC alone, {PaperConfig.max_points} points'

    def run(self, prepared: Any) -> Any:
        """Find the planes by sequential RANSAC."""
        rng = np.random.default_rng(self.config.ransac.seed)
        return paper_labels(*prepared, self.config, rng, cluster=False), *prepared

    def result(self, raw: Any) -> Segments:
        """Fit the planes to their pixels."""
        labels, depth_m, intrinsics = raw
        labels = numbered(labels, labels >= 0)
        return labels, fit_planes(labels, depth_m, intrinsics)


class OpenCv(Method):
    """OpenCV 5's RgbdNormals and findPlanes."""

    def __init__(self, threshold_m: float, min_share: float = MIN_SHARE) -> None:
        self.threshold_m, self.min_share = threshold_m, min_share
        self.name = f'OpenCV findPlanes, {100 * threshold_m:g} cm'
        if not (hasattr(cv2, 'findPlanes') and hasattr(cv2, 'RgbdNormals')):
            self.absent = f'OpenCV {cv2.__version__} has no findPlanes, OpenCV 5 has'
        self._normals: tuple[CameraIntrinsics, Any] | None = None

    def prepare(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> Any:
        """Return the points, four floats each, and the estimator of normals."""
        points = np.zeros((*depth_m.shape, 4), np.float32)
        points[..., :3] = depth_to_points(depth_m, intrinsics)
        return points, self._estimator(intrinsics)

    def run(self, prepared: Any) -> Any:
        """Estimate the normals and segment."""
        points, estimator = prepared
        least = round(self.min_share * points.shape[0] * points.shape[1])
        return cv2.findPlanes(points, estimator.apply(points), block_size=20, min_size=least,
                              threshold=self.threshold_m)

    def result(self, raw: Any) -> Segments:
        """Convert the mask, 255 for no plane, to labels."""
        mask, planes = raw
        labels = mask.astype(np.int32)
        labels[mask == 255] = -1
        planes = np.zeros((0, 4)) if planes is None else planes.reshape(-1, 4).astype(float)
        length = np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
        planes /= np.maximum(length, 1e-12) * np.where(planes[:, 3:] < 0, -1.0, 1.0)
        return labels, planes

    def _estimator(self, intrinsics: CameraIntrinsics) -> Any:
        """Return the estimator of normals, cached per camera because it computes tables."""
        if self._normals is None or self._normals[0] != intrinsics:
            self._normals = intrinsics, cv2.RgbdNormals.create(
                intrinsics.height, intrinsics.width, cv2.CV_32F,
                intrinsics.matrix.astype(np.float32), 5, 50.0,
                cv2.RgbdNormals_RGBD_NORMALS_METHOD_FALS)
        return self._normals[1]


def all_methods() -> list[Method]:
    """Return our method first, then all others, available or not."""
    return [Ours(), Paper(), PlainRansac(), OpenCv(0.03), OpenCv(0.05)]


def plane_array(segmentation: PlaneSegmentation) -> np.ndarray:
    """Return normals and offsets of the planes, (K, 4)."""
    return np.column_stack([segmentation.planes.normals, segmentation.planes.offsets_m])

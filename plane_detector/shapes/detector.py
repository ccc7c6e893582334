# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes in consecutive images, with stable labels."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import load_once
from plane_detector.config import Config
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.shapes.detection import find_shapes
from plane_detector.tracking.shape_tracker import ShapeTrack, update_shape_tracks
from plane_detector.types import CameraIntrinsics, PlaneSegmentation, Shape

Found = tuple[PlaneSegmentation, tuple[Shape, ...], tuple[int, ...]]


class ShapeDetector:
    """Finds the shapes that the settings request; must be called with every image in order."""

    def __init__(self) -> None:
        self._tracks: tuple[ShapeTrack, ...] = ()

    def reset(self) -> None:
        """Discard all known shapes."""
        self._tracks = ()

    def detect(self, depth_m: np.ndarray, planes: PlaneSegmentation, regions: PixelRegions,
               intrinsics: CameraIntrinsics, config: Config, in_metres: bool) -> Found:
        """
        Return planes, shapes and the labels of the shapes.

        Parameters
        ----------
        depth_m : (H, W) floating
            NaN where invalid.
        planes : PlaneSegmentation
            Planes of this depth.
        regions : PixelRegions
            The regions that they were measured on, in 1/m.
        intrinsics : CameraIntrinsics
        config : Config
            Its ``shapes``, ``tracking`` and the seed of ``ransac``.
        in_metres : bool
            Whether depth is in metres; otherwise no shapes are searched for.

        Returns
        -------
        PlaneSegmentation
            As returned by :func:`find_shapes`; unchanged if no shapes are requested.
        tuple of Shape
            Largest first.
        tuple of int
            Label of each shape, above 0; empty if shapes are not tracked.

        """
        if not (config.shapes.wanted and in_metres):
            return planes, (), ()
        load_once('shapes')
        planes, shapes = find_shapes(depth_m, planes, regions, intrinsics, config.shapes,
                                     np.random.default_rng(config.ransac.seed))
        if not config.tracking.enabled:
            self.reset()
            return planes, shapes, ()
        self._tracks, labels = update_shape_tracks(
            self._tracks, shapes, planes.labels, len(planes.planes), config.tracking.keep_frames)
        return planes, shapes, labels

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Data passed between the stages. All frozen; lengths in metres, optical frame (REP-103)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np


@dataclass(frozen=True)
class CameraIntrinsics:
    """
    Pinhole model of a rectified image.

    Parameters
    ----------
    fx, fy : float
        Focal lengths in pixels.
    cx, cy : float
        Principal point in pixels; the centre of the first pixel is (0, 0).
    width, height : int
        Size of the image in pixels.

    Raises
    ------
    ValueError
        A focal length or a side is not positive, or a value is not finite.

    Examples
    --------
    >>> CameraIntrinsics(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480).width
    640

    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy]).all():
            raise ValueError(f'camera intrinsics must be finite, not {self}')
        if min(self.fx, self.fy) <= 0:
            raise ValueError(f'focal lengths must be positive, not fx {self.fx}, fy {self.fy}: '
                             'is the camera calibrated?')
        if min(self.width, self.height) <= 0:
            raise ValueError(f'image size must be positive, not {self.width} x {self.height}')

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal_deg: float):
        """
        Return the intrinsics of a centred camera with square pixels.

        Examples
        --------
        >>> camera = CameraIntrinsics.from_field_of_view(640, 480, horizontal_deg=90.0)
        >>> round(camera.fx, 6), camera.cx, camera.cy
        (320.0, 319.5, 239.5)

        """
        focal_px = float(0.5 * width / np.tan(np.radians(horizontal_deg) / 2))
        return cls(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, width, height)


@dataclass(frozen=True)
class Prediction:
    """
    Output of a depth network for one image.

    Attributes
    ----------
    output : str
        Kind of ``values``: ``metric_depth``, ``disparity`` (1/metres) or ``relative_disparity``
        (unknown scale and shift).
    values : (H, W) float32
        NaN where invalid, including pixels that the network masks.
    normals_camera : (H, W, 3) float32, optional
        Unit normals of the surfaces in the optical frame, pointing to the camera; NaN invalid.
    normal_confidence : (H, W) float32, optional
        Confidence of the network in its normals, in the network's own unit; higher is better.
    is_indoor : bool
        By a network of indoor images only, which is wrong outdoors.

    """

    output: str
    values: np.ndarray
    normals_camera: np.ndarray | None = None
    normal_confidence: np.ndarray | None = None
    is_indoor: bool = False


@runtime_checkable
class DepthModel(Protocol):
    """
    Interface of a depth model.

    :class:`~plane_detector.depth.estimator.DepthEstimator` runs networks; a plain function is
    wrapped in a :class:`~plane_detector.depth.depth_function.DepthFunction`.

    Attributes
    ----------
    output : str
        ``metric_depth`` (metres), ``disparity`` (1/metres) or ``relative_disparity`` (unknown
        scale and shift).
    noise_share : float
        Typical error of its disparity as a share of the disparities of the image, see
        :func:`~plane_detector.geometry.disparity.noise_reference`; 0: not known.
    focal_per_height : float
        Focal length over image height for which its metres are correct; 0: not known.

    """

    output: str
    noise_share: float
    focal_per_height: float

    @property
    def facts(self) -> Mapping[str, str]:
        """Description for the log and the diagnostics; ``depth_model`` is one of its keys."""

    def edge_blur_px(self, width: int, height: int) -> float:
        """Return the largest error of depth edges, in pixels of an image of this size."""

    def fit_to_rate(self, rate_hz: float, other_s: float) -> None:
        """Choose the largest input that keeps the rate beside the other work on a frame."""

    def advise(self, share: float) -> str:
        """Return how to reduce its time to this share; empty if there is no way."""

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics) -> Prediction:
        """Return the depth of an image (H, W, 3) uint8, of the size of the image."""


@dataclass(frozen=True)
class Plane:
    """
    One plane, normal . p + offset = 0 in the optical frame.

    Attributes
    ----------
    normal : (3,) float64
        Unit normal, pointing to the camera.
    offset_m : float
        Distance from camera to plane, at least 0.
    centroid_m : (3,) float64
        Mean of the pixels' points, projected onto the plane.
    inlier_count : int
        Pixels with this plane's label; at least 1.
    rms_m : float
        Root mean square distance of those pixels' points from the plane.
    area_m2 : float
        Area that those pixels cover on the plane.
    covariance : (4, 4) float64
        Covariance of (normal, offset_m) from the fit.
    confidence : float
        Probability, 0 to 1, that the plane exists in the scene.

    Examples
    --------
    >>> wall = Plane(np.array([0, 0, -1.0]), 2.0, np.array([0, 0, 2.0]), 9, 0.0, 1.0, np.eye(4), 1)
    >>> float(wall.normal @ wall.centroid_m + wall.offset_m)
    0.0

    """

    normal: np.ndarray
    offset_m: float
    centroid_m: np.ndarray
    inlier_count: int
    rms_m: float
    area_m2: float
    covariance: np.ndarray
    confidence: float


class ShapeType(IntEnum):
    """Values of the field ``type`` of ``~/shapes``."""

    SPHERE = 1
    CYLINDER = 2
    CONE = 3


@dataclass(frozen=True)
class Shape:
    """
    A sphere, cylinder or cone in the optical frame, seen from outside.

    Attributes
    ----------
    type : ShapeType
    position_m : (3,) float64
        Centre of a sphere, middle of the visible part of a cylinder's axis, apex of a cone.
    axis : (3,) float64
        Unit vector along the axis, of a cone from the apex into it; zeros for a sphere.
    radius_m : float
        0 for a cone.
    half_angle_rad : float
        Between axis and surface of a cone, else 0.
    length_m : float
        Extent of the visible part along the axis, of a cone from the apex; 0 for a sphere.
    inlier_count : int
        Pixels with this shape's label.
    rms_m : float
        Root mean square distance of those pixels' points from the surface.
    covariance : (D, D) float64
        Of the fitted parameters: centre, radius (sphere, 4); position across the axis (2), axis
        across itself (2, radians), radius (cylinder, 5); apex, axis, half angle (cone, 6).
    confidence : float
        Share, 0 to 1, of the surrounding surface that the shape explains.

    """

    type: ShapeType
    position_m: np.ndarray
    axis: np.ndarray
    radius_m: float
    half_angle_rad: float
    length_m: float
    inlier_count: int
    rms_m: float
    covariance: np.ndarray
    confidence: float


@dataclass(frozen=True)
class PlaneSegmentation:
    """
    The planes of one image, largest first, and the plane of each pixel.

    Attributes
    ----------
    planes : tuple of Plane
        Empty when there is none.
    labels : (H, W) int32
        Index into ``planes``, -1 for no plane and where depth is invalid.
    disparity_noise : float
        Standard deviation of 1/depth used by the segmentation, 1/m.
    systematic_noise : float
        The part of it with which the sensor bends whole planes, 1/m.

    """

    planes: tuple[Plane, ...]
    labels: np.ndarray
    disparity_noise: float
    systematic_noise: float = field(default=0.0, kw_only=True)


@dataclass(frozen=True)
class Detection(PlaneSegmentation):
    """
    Result of the whole pipeline for one image.

    Attributes
    ----------
    depth_m : (H, W) float32
        NaN invalid; the unit is unknown if ``scale_method`` is ``relative``.
    scale_method : str
        Method that determined the unit: ``metric``, ``fixed``, ..., or ``relative`` for none.
    stage_seconds : mapping of str to float
        Time of each stage.
    track_labels : tuple of int
        Label of each plane, above 0, the same from image to image; empty: not tracked.
    classes : tuple of int
        A value of ``PlaneClass`` for each plane; empty: all unknown.
    scale_note, scale_event : str
        Result of the scale method with its uncertainty, or why there is none; what changed with
        this image, if anything.
    shapes : tuple of Shape
        Largest first; with N planes, ``labels`` are N + i in the pixels of shape i.
    shape_labels : tuple of int
        Label of each shape, above 0 and the same from image to image; empty: not tracked.
    gravity_camera : (3,) float64 or None
        Direction of gravity in the optical frame, as used for the classes; None: unknown.
    gravity_source : str
        ``imu``, ``tf``, ``measured`` (by either), ``parameter``, ``image`` or ``none``.
    gravity_note : str
        Why the image does not give the direction of gravity, if it was tried.
    gravity_probability : float
        That the direction of gravity is right within 5 degrees, if the image gives it; else NaN.
    horizontal_axes : (A, 3) float64
        Perpendicular horizontal axes of the scene, from the lines of the image; none: (0, 3).
    ground : (H, W) bool
        Pixels that a robot may roll on, and lower levels; nowhere if gravity, the unit or the own
        floor are not known.
    drops_m : (N, 3) float64
        Points along the edges where the ground ends and the next surface is lower.
    drop_depths_m : (N,) float64
        By how much it is lower; NaN where nothing is seen behind the edge.
    drop_note : str
        Why there are no drops; empty if they are searched for.
    camera_height_m, tilt_deg : float
        Height above the own floor, and angle of the optical axis below the horizon; NaN unknown.

    """

    depth_m: np.ndarray
    scale_method: str
    stage_seconds: Mapping[str, float] = field(default_factory=dict)
    track_labels: tuple[int, ...] = ()
    classes: tuple[int, ...] = ()
    scale_note: str = ''
    scale_event: str = ''
    shapes: tuple[Shape, ...] = ()
    shape_labels: tuple[int, ...] = ()
    gravity_camera: np.ndarray | None = None
    gravity_source: str = 'none'
    gravity_note: str = ''
    gravity_probability: float = float('nan')
    horizontal_axes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    ground: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    drops_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    drop_depths_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    drop_note: str = ''
    camera_height_m: float = float('nan')
    tilt_deg: float = float('nan')

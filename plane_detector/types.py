# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Data passed between the stages. All frozen; lengths in metres, optical frame (REP-103)."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any, Protocol, overload, runtime_checkable

import numpy as np

from plane_detector.plane_fields import PlaneClass, PlaneColumns, columns_of, row_of

# chosen: a larger jump back means another stream, such as a bag that starts again; images that
# arrive out of order are only a few periods apart.
JUMP_S = 1.0
# chosen: the widest rectilinear lens sees 125 degrees; the focal length of a fisheye lens of 220
# degrees is .26 times the side that its image circle fills.
MOST_FIELD_OF_VIEW_DEG = 160.0
# derived: 1 / (2 tan(80 degrees)) is .0882, for the field of view above.
# chosen: 1000 times the longer side are .06 degrees, far beyond the longest telephoto lens; above
# that, products of coefficients overflow.
_LEAST_FOCAL_SHARE, _MOST_FOCAL_SHARE, _MOST_CENTRE_SHARE = 0.088, 1000.0, 1000.0

# chosen: of 170 cameras of public sets the principal point is within .05 of the middle; half the
# size moves it by .25, two thirds by .17. The shares of both sides of another size are equal.
_MOST_OFF_CENTRE, _SAME_SHARE = 0.12, 1.2


@dataclass(frozen=True)
class CameraIntrinsics:
    """
    Pinhole model of a rectified image.

    Parameters
    ----------
    fx, fy : float
        Focal lengths in pixels: at least .088 times the width and the height, a field of view
        of 160 degrees, at most 1000 times the longer side.
    cx, cy : float
        Principal point in pixels; the centre of the first pixel is (0, 0). It may lie outside of
        the image, by less than 1000 times the longer side.
    width, height : int
        Size of the image in pixels.
    is_guessed : bool
        The focal lengths are a guess, for example from an unmeasured field of view, so results
        that depend on angles between rays are uncertain.

    Raises
    ------
    ValueError
        A value is not a number, not finite or out of these ranges, or a side is not positive.

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
    is_guessed: bool = False

    def __post_init__(self) -> None:
        # From any number, including an element of a float32 matrix: kernels take float64.
        for name, kind in {**dict.fromkeys(('fx', 'fy', 'cx', 'cy'), float),
                           **dict.fromkeys(('width', 'height'), int)}.items():
            object.__setattr__(self, name, _number(name, getattr(self, name), kind))
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy]).all():
            raise ValueError(f'camera intrinsics must be finite, not {self}')
        if min(self.fx, self.fy) <= 0:
            raise ValueError(f'focal lengths must be positive, not fx {self.fx}, fy {self.fy}: '
                             'is the camera calibrated?')
        if min(self.width, self.height) <= 0:
            raise ValueError(f'image size must be positive, not {self.width} x {self.height}')
        side = max(self.width, self.height)
        for name, least_px, share in (
                ('fx', _LEAST_FOCAL_SHARE * self.width, _MOST_FOCAL_SHARE),
                ('fy', _LEAST_FOCAL_SHARE * self.height, _MOST_FOCAL_SHARE),
                ('cx', -_MOST_CENTRE_SHARE * side, _MOST_CENTRE_SHARE),
                ('cy', -_MOST_CENTRE_SHARE * side, _MOST_CENTRE_SHARE)):
            if not least_px <= getattr(self, name) <= share * side:
                raise ValueError(
                    f'{name} {getattr(self, name):g} px cannot be that of a {self.width} x '
                    f'{self.height} image, {least_px:g} to {share * side:g} px can: calibrate '
                    'the camera again, or correct its CameraInfo')

    @property
    def matrix(self) -> np.ndarray:
        """Camera matrix K, (3, 3) float64."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)

    @property
    def question(self) -> str:
        """
        Why this may be the camera of another image, and the remedy; empty without evidence.

        Examples
        --------
        >>> CameraIntrinsics(300.0, 300.0, 160.0, 90.0, 640, 360).question
        'the principal point, (160, 90) px, is at .25 and .25 of the 640 x 360 image, ...'

        """
        shares = self.cx / self.width, self.cy / self.height
        if self.is_guessed or max(abs(share - 0.5) for share in shares) <= _MOST_OFF_CENTRE:
            return ''
        found = (f'the principal point, ({self.cx:.0f}, {self.cy:.0f}) px, is at '
                 + ' and '.join(f'{share:.2f}'.replace('0.', '.') for share in shares)
                 + f' of the {self.width} x {self.height} image, but near the middle of most')
        if min(shares) > 0 and max(shares) < _SAME_SHARE * min(shares):
            factor = 1 / sum(shares)
            return (f'{found}: are fx {self.fx:.0f}, fy, cx and cy those of about a '
                    f'{self.width / factor:.0f} x {self.height / factor:.0f} image, binned or '
                    f'resized? Then multiply them by {factor:.2f}, or send the CameraInfo of this '
                    'image')
        return (f'{found}: if it is not cropped there, it has the CameraInfo of another image; '
                'send its own, or calibrate the camera')

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal_deg: float,
                           is_guessed: bool = False):
        """
        Return the intrinsics of a centred camera with square pixels.

        Raises
        ------
        ValueError
            As of the class, or the angle is not above 0 and at most 160 degrees.

        Examples
        --------
        >>> camera = CameraIntrinsics.from_field_of_view(640, 480, horizontal_deg=90.0)
        >>> round(camera.fx, 6), camera.cx, camera.cy
        (320.0, 319.5, 239.5)

        """
        if not (isinstance(horizontal_deg, Real)
                and 0 < horizontal_deg <= MOST_FIELD_OF_VIEW_DEG):
            raise ValueError('the horizontal field of view must be above 0 and at most '
                             f'{MOST_FIELD_OF_VIEW_DEG:g} degrees, not {horizontal_deg!r}')
        focal_px = float(0.5 * width / np.tan(np.radians(horizontal_deg) / 2))
        return cls(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, width, height,
                   is_guessed)


def _number(name: str, value: object, kind: type) -> int | float:
    """Return a value of a camera as a plain int or float; ValueError if it is none."""
    try:
        number = kind(value)
        if number == value or number != number:
            return number
    except (TypeError, ValueError, OverflowError):
        pass
    what = 'a whole number of pixels' if kind is int else 'a number of pixels'
    raise ValueError(f'{name} of the camera must be {what}, not {value!r}')


@dataclass(frozen=True)
class Prediction:
    """
    Output of a depth network for one image.

    Its kind is ``metric_depth``, ``disparity`` (1/metres), ``relative_disparity`` (unknown scale
    and shift) or ``relative_depth`` (unknown scale).
    """

    output: str  # kind of ``values``
    values: np.ndarray  # (H, W) float32, NaN where invalid or masked by the network
    # (H, W, 3) float32, of the surfaces in the optical frame, pointing toward the camera; NaN
    # invalid
    normals_camera: np.ndarray | None = None
    normal_confidence: np.ndarray | None = None  # (H, W) float32, in the network's own unit
    is_indoor: bool = False  # from a network trained only indoors, which is wrong outdoors


@runtime_checkable
class DepthModel(Protocol):
    """
    Interface of a depth model.

    :class:`~plane_detector.depth.estimator.DepthEstimator` runs networks; a plain function is
    wrapped in a :class:`~plane_detector.depth.observation.DepthFunction`.

    Attributes
    ----------
    output : str
        ``metric_depth`` (metres), ``disparity`` (1/metres), ``relative_disparity`` (unknown scale
        and shift) or ``relative_depth`` (unknown scale).
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

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics) -> Prediction:
        """Return the depth of an image (H, W, 3) uint8, of the size of the image."""


@row_of(PlaneColumns)
class Plane:
    """
    One plane, normal . p + offset = 0 in the optical frame; see `PlaneColumns` for the attributes.

    Examples
    --------
    >>> wall = Plane(np.array([0, 0, -1.0]), 2.0, np.array([0, 0, 2.0]), 9, 0.0, 1.0, np.eye(4), 1)
    >>> float(wall.normal @ wall.centroid_m + wall.offset_m)
    0.0

    """

    if TYPE_CHECKING:  # made from the columns
        def __init__(self, *values: Any, **named: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...


@dataclass(frozen=True, eq=False)
class Planes(PlaneColumns, Sequence[Plane]):
    """
    K planes in one frame, as arrays; indexing and iteration give each as a :class:`Plane`.

    A slice, a mask or an array of indices selects some of them as :class:`Planes`, as with an
    array.

    Examples
    --------
    >>> wall = Plane(np.array([0, 0, -1.0]), 2.0, np.array([0, 0, 2.0]), 9, 0.0, 1.0, np.eye(4), 1)
    >>> planes = Planes.of([wall, wall])
    >>> planes.normals.shape, planes[1].offset_m, [plane.inlier_count for plane in planes]
    ((2, 3), 2.0, [9, 9])
    >>> len(planes[:1]), len(planes[planes.offsets_m > 1.0]), len(planes[[1, 0, 1]])
    (1, 2, 3)

    """

    @classmethod
    def of(cls, planes: Sequence[Plane]) -> Planes:
        """Return the arrays of single planes."""
        return cls(*(np.array([getattr(plane, row.one) for plane in planes], row.dtype)
                     .reshape(-1, *row.shape) for row in columns_of(cls).values()))

    @overload
    def __getitem__(self, index: int) -> Plane: ...

    @overload
    def __getitem__(self, index: slice | np.ndarray | Sequence[int]) -> Planes: ...

    def __getitem__(self, index):
        if isinstance(index, slice) or np.ndim(index):
            return self.selected(index)
        return Plane(*self.row(operator.index(index)))

    @cached_property
    def distances_m(self) -> np.ndarray:
        """Distance of each centroid from the origin of the frame, (K,), above 0."""
        return np.maximum(np.sqrt((self.centroids_m ** 2).sum(axis=1)), 1e-12)

    @cached_property
    def normal_variances(self) -> np.ndarray:
        """Sum of the variances of each normal, (K,), squared radians."""
        return np.einsum('nii->n', self.covariances[:, :3, :3])


NO_PLANES = Planes.of(())
NO_SHAPE_LABELS = np.zeros((0, 0), np.int32)


class ShapeType(IntEnum):
    """Values of the field ``type`` of ``~/shapes``."""

    SPHERE = 1
    CYLINDER = 2
    CONE = 3


@dataclass(frozen=True)
class Shape:
    """A sphere, cylinder or cone in the optical frame, seen from outside."""

    type: ShapeType
    # (3,) float64: centre of a sphere, middle of the visible part of a cylinder's axis, apex of a
    # cone.
    position_m: np.ndarray
    axis: np.ndarray  # (3,) float64, unit vector, of a cone from the apex; zeros for a sphere
    radius_m: float  # 0 for a cone
    half_angle_rad: float  # between axis and surface of a cone, else 0
    length_m: float  # of the visible part along the axis, of a cone from the apex; 0 for a sphere
    inlier_count: int  # pixels with this shape's label
    rms_m: float  # root mean square distance of those pixels' points from the surface
    # (D, D) float64, of the fitted parameters: centre, radius (sphere, 4); position across the
    # axis (2), axis across itself (2, radians), radius (cylinder, 5); apex, axis, half angle
    # (cone, 6).
    covariance: np.ndarray
    confidence: float  # share, 0 to 1, of the surrounding surface that the shape explains
    label: int = 0  # as that of a plane; planes and shapes are counted apart


@dataclass(frozen=True)
class PlaneSegmentation:
    """The planes of one image, largest first, and the plane of each pixel."""

    planes: Planes  # empty when there is none
    labels: np.ndarray  # (H, W) int32, index into ``planes``; -1: no plane, or invalid depth
    disparity_noise: float  # standard deviation of 1/depth used by the segmentation, 1/m
    # The part of it with which the sensor bends whole planes, 1/m.
    systematic_noise: float = field(default=0.0, kw_only=True)
    # Why there are no planes, or which planes were dropped; empty if neither.
    plane_note: str = field(default='', kw_only=True)


RELATIVE = 'relative'
"""Method of a scale that nothing determines."""


@dataclass(frozen=True)
class ScaleEstimate:
    """1/z = scale * disparity + shift, and the method that estimated it."""

    # 1/metres, or 1/unit if the unit is unknown; the unit is then the median depth of the image
    # for which it was chosen.
    scale: float
    shift: float
    method: str  # metric, depth_topic, camera_height, manhattan, fixed or relative
    is_metric: bool  # not for relative, nor for manhattan without a height
    has_true_angles: bool  # between planes; for relative only if the network's depth has no shift
    # Standard deviation of depth due to scale and shift, as a share of depth, at the disparity
    # quantile of the farthest 10 % of the image; NaN if unknown.
    uncertainty: float
    note: str  # result of the method, or why the others refused; for the log and the diagnostics
    span: tuple[float, float, float]  # 10 %, 50 %, 90 % of disparity; NaN for metric
    # Standard deviation of normals due to the shift; NaN if unknown.
    angle_sigma_deg: float = math.nan

    @property
    def unit_method(self) -> str:
        """Method that determined the unit; ``relative`` if none did."""
        return self.method if self.is_metric else RELATIVE

    def with_covariance(self, covariance: np.ndarray) -> ScaleEstimate:
        """Return the estimate with its uncertainty from the covariance of scale and shift."""
        far = np.array([self.span[0], 1.0])
        inverse_depth = far @ [self.scale, self.shift]
        sigma = np.sqrt(max(far @ covariance @ far, 0.0))
        return replace(self, uncertainty=float(sigma / inverse_depth)
                       if inverse_depth > 0 else math.nan)

    def __str__(self) -> str:
        sigma = f', +-{self.uncertainty:.1%}' if np.isfinite(self.uncertainty) else ''
        unit = '' if self.is_metric else ', unit unknown'
        angles = (f', angles +-{self.angle_sigma_deg:.1f} deg'
                  if np.isfinite(self.angle_sigma_deg) else '')
        return f'{self.method}{unit}{sigma}{angles}: {self.note}'


METRIC = ScaleEstimate(1.0, 0.0, 'metric', True, True, math.nan, 'measured depth',
                       (math.nan,) * 3)
"""Of depth in metres, as measured."""

# A given direction with a larger tolerance only distinguishes the floor from the walls.
COARSE_DEG = 5.0


@dataclass(frozen=True)
class Gravity:
    """A direction of gravity and its source."""

    # (3,) float64 or None: unit direction in the optical frame; None if unknown
    gravity_camera: np.ndarray | None
    tolerance_deg: float  # its largest error
    source: str  # name of the sensor, ``parameter``, ``image`` or ``none``
    note: str = ''  # why the image does not give it, if it was tried
    # that the one of the image is right within 5 degrees; NaN for other sources
    probability: float = math.nan

    @property
    def is_sure(self) -> bool:
        """Whether it is known accurately enough for angles."""
        return self.gravity_camera is not None and self.tolerance_deg <= COARSE_DEG


NO_GRAVITY = Gravity(None, 0.0, 'none')

OBSTACLE_DISTANCES_M = (1.0, 2.0, 3.0)
"""How far ahead the smallest obstacle that can be seen is stated."""


class GroundLack(Enum):
    """What an image lacks for its ground."""

    NOTHING = 0
    GRAVITY = 1  # its direction, or a good one
    UNIT = 2
    DEPTH = 3  # hardly any pixel has it


@dataclass(frozen=True)
class Mounting:
    """
    How the camera is mounted, as stated and as measured from the floor.

    Examples
    --------
    >>> mounting = Mounting(0.6, 0.702, 0.02, 20.0, 20.1, 0.1, 2.5)
    >>> mounting.problem
    'the floor is 0.70 m below the camera, not 0.60 m as stated'

    """

    stated_height_m: float  # NaN: not stated
    height_m: float
    height_error_m: float  # largest difference that is not a problem
    stated_tilt_deg: float  # of the optical axis below the horizon; NaN: not stated
    tilt_deg: float
    angle_deg: float  # between the stated direction down and that of the floor, also sideways
    angle_error_deg: float

    @property
    def problem(self) -> str:
        """Which differences exceed their errors; empty if none."""
        problems = []
        if abs(self.height_m - self.stated_height_m) > self.height_error_m:
            problems.append(f'the floor is {self.height_m:.2f} m below the camera, not '
                            f'{self.stated_height_m:.2f} m as stated')
        if self.angle_deg > self.angle_error_deg:
            problems.append(f'by the floor, the camera is tilted {self.tilt_deg:.1f} degrees '
                            f'down, not {self.stated_tilt_deg:.1f} as stated, and off by '
                            f'{self.angle_deg:.1f} in all')
        return '; '.join(problems)


@dataclass(frozen=True)
class GroundResult:
    """Traversable ground, obstacles, and where the ground ends."""

    lack: GroundLack = GroundLack.GRAVITY  # if set, everything below is missing
    # (H, W) bool, traversable pixels, and lower levels; nowhere if the own floor is unknown.
    mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    # (H, W) bool, pixels with depth that are not ground, without specks and flying pixels
    obstacles: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    # (H, W) float32, height of each pixel over the ground before it, and its standard deviation;
    # NaN where depth is invalid or the own floor is unknown
    heights_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    height_sigmas_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    # (3,) float64, height of the smallest detectable obstacle at OBSTACLE_DISTANCES_M, given the
    # noise of the image; (0,) if the own floor is unknown
    smallest_obstacles_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    # (N, 3) float64, points along the edges where the ground ends and the next surface is lower,
    # and by how much, (N,); NaN where nothing is visible behind the edge.
    drops_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    drop_depths_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    drop_note: str = ''  # why there are no drops; empty if they are searched for
    # Where the ground ends at what may be an edge or the end of the sensor's range; empty if there
    # is no such place.
    edge_note: str = ''
    camera_height_m: float = math.nan  # above the own floor; NaN unknown
    tilt_deg: float = math.nan  # of the optical axis below the horizon; NaN unknown
    mounting: Mounting | None = None  # if part of it is stated and a floor is visible

    @property
    def is_known(self) -> bool:
        """Whether nothing is missing."""
        return self.lack is GroundLack.NOTHING


@dataclass(frozen=True)
class Detection(PlaneSegmentation):
    """
    Result of the whole pipeline for one image.

    The answers about its ground are properties; ``ground_result`` has what belongs to them.
    """

    depth_m: np.ndarray  # (H, W) float32, NaN invalid; in the unit of ``scale``
    scale: ScaleEstimate
    gravity: Gravity = field(default=NO_GRAVITY, kw_only=True)  # as used for the classes
    # Or an object with its attributes, computed on first access, as `find_ground` returns.
    ground_result: GroundResult = field(default_factory=GroundResult, kw_only=True)
    # The depth comes from a sensor, not from a network.
    is_measured: bool = field(default=True, kw_only=True)
    # How many pixels repeat which depth exactly and were dropped, and which of them are still
    # obstacles; empty if none.
    constant_note: str = field(default='', kw_only=True)
    # Evidence against the stated camera, depth or gravity, with the remedy; empty if there is
    # none.
    input_note: str = field(default='', kw_only=True)
    scale_event: str = field(default='', kw_only=True)  # change with this image, if any
    shapes: tuple[Shape, ...] = field(default=(), kw_only=True)  # largest first
    # (H, W) int32, index into ``shapes``, -1 none; (0, 0) without shapes
    shape_labels: np.ndarray = field(default_factory=lambda: NO_SHAPE_LABELS, kw_only=True)
    # Why there are no shapes; empty if they are searched for.
    shape_note: str = field(default='', kw_only=True)
    stage_seconds: Mapping[str, float] = field(default_factory=dict, kw_only=True)

    @property
    def classes(self) -> tuple[PlaneClass, ...]:
        """Class of each plane."""
        return tuple(map(PlaneClass, self.planes.classes.tolist()))

    @property
    def ground(self) -> np.ndarray:
        """Pixels of the ground, (H, W) bool."""
        return self.ground_result.mask

    @property
    def obstacles(self) -> np.ndarray:
        """Pixels of obstacles, (H, W) bool."""
        return self.ground_result.obstacles

    @property
    def drops_m(self) -> np.ndarray:
        """Points along the edges of the ground, (N, 3) float64."""
        return self.ground_result.drops_m

    @property
    def scale_note(self) -> str:
        """Result of the method of the scale, or why the others refused; then the input note."""
        return '; '.join(filter(None, (self.scale.note, self.input_note)))

    @property
    def drop_depths_m(self) -> np.ndarray:
        """How much lower the surface behind them is, (N,) float64; NaN where none is visible."""
        return self.ground_result.drop_depths_m

    @property
    def drop_note(self) -> str:
        """Why there are no drops; empty if they are searched for."""
        return self.ground_result.drop_note

    @property
    def heights_m(self) -> np.ndarray:
        """Height of each pixel over the ground before it, (H, W) float32; NaN unknown."""
        return self.ground_result.heights_m

    @property
    def ground_pixels(self) -> GroundResult:
        """The same as ``ground_result``, under its name in earlier versions."""
        return self.ground_result

    @property
    def mounting(self) -> Mounting | None:
        """Measured height and tilt of the camera next to the stated ones, if any are stated."""
        return self.ground_result.mounting

    @property
    def camera_height_m(self) -> float:
        """Height of the camera above the own floor; NaN unknown."""
        return self.ground_result.camera_height_m

    @property
    def tilt_deg(self) -> float:
        """Angle of the optical axis below the horizon; NaN unknown."""
        return self.ground_result.tilt_deg

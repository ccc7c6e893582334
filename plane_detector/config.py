# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
All settings: one frozen dataclass per stage of the pipeline, and one for the node.

Defaults are written here and nowhere else. The ROS parameters, the yaml file and the table in
docs/parameters.md are made from these fields. The metadata of a field holds its description,
unit, range and choices; every instance is checked against them when it is created.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from plane_detector.settings import Settings, fixed_setting, setting


@dataclass(frozen=True)
class DepthConfig(Settings, section='depth'):
    """Source of depth, and how the network runs."""

    source: str = fixed_setting(
        'model', 'source of depth: the network (model), depth images (topic) or organised point '
        'clouds on depth/points (points)', choices=('model', 'topic', 'points'))
    transport: str = fixed_setting(
        'raw', 'raw: sensor_msgs/Image on depth; compressedDepth: sensor_msgs/CompressedImage on '
        'depth/compressedDepth', choices=('raw', 'compressedDepth'))
    unit: float = fixed_setting(
        0.0, 'metres per raw unit of measured depth, for example 0.0001; 0: by the encoding, '
        '16UC1 in millimetres, 32FC1 in metres', 'm', 0.0, 1.0)
    kind: str = setting(
        'z', 'meaning of measured depth images: z: depth along the optical axis, as from depth '
        'cameras; ray: distance from the camera along each ray, as from some simulators',
        choices=('z', 'ray'))
    colour: str = fixed_setting(
        'image', 'image: depth belongs to a colour image; none: depth alone, no colour image is '
        'needed', choices=('image', 'none'))
    model: str = fixed_setting(
        'auto', 'name of a network of the zoo, path of an .onnx file, or auto: the best network '
        'that is cached or can be downloaded now')
    output: str = fixed_setting(
        'auto', 'output of the network: metric_depth (metres), disparity (1/metres), '
        'relative_disparity (unknown scale and shift), relative_depth (unknown scale), auto: as '
        'stated in the zoo; required if model is a path',
        choices=('auto', 'metric_depth', 'disparity', 'relative_disparity', 'relative_depth'))
    short_side: int = fixed_setting(
        0, 'short side of the input of a network that accepts any size; the aspect ratio of the '
        'image determines the other side; 0: default of the network', 'px', 0, 8192)
    views: int = fixed_setting(
        0, 'number of views that a metric network averages: 1: the whole image; 2, 3: also one or '
        'two crops with the field of view of its training, if the image has a wider one; 0: as '
        'stated in the zoo, or 1', '', 0, 3)
    side_multiple: int = fixed_setting(
        14, 'the input sides of a network that accepts any size are multiples of this; ignored '
        'for networks of the zoo', 'px', 1, 1024)
    mean: tuple[float, ...] = fixed_setting(
        (0.485, 0.456, 0.406), 'subtracted from the scaled RGB values; ignored for networks of '
        'the zoo')
    std: tuple[float, ...] = fixed_setting(
        (0.229, 0.224, 0.225), 'divisor of the scaled RGB values after mean is subtracted; '
        'ignored for networks of the zoo', low=1e-6)
    input_scale: float = fixed_setting(
        1.0 / 255.0, 'factor on the pixel values, applied first; ignored for networks of the zoo',
        low=1e-9)
    noise_share: float = fixed_setting(
        0.0, 'typical error of disparity as a share of its range in an image; 0: unknown; '
        'ignored for networks of the zoo', '', 0.0, 1.0)
    max_depth: float = setting(
        80.0, 'depth beyond this is invalid', 'm', 0.01, 1e4)
    max_range: float = setting(
        0.0, 'range within which the sensor reliably measures the floor: where the ground ends '
        'nearer than this with nothing behind it, there is a drop; 0: unknown, the largest range '
        'observed so far is used', 'm', 0.0, 1e4)
    providers: tuple[str, ...] = fixed_setting(
        ('CPUExecutionProvider',), 'ONNX Runtime execution providers; the first one that '
        'runs is used')
    threads: int = fixed_setting(
        0, 'threads of the network; 0: one per core', '', 0, 256)
    # chosen: 2.5 times what Depth Anything V2 small takes at 924 x 518; on a Jetson, all programs
    # share the memory.
    gpu_memory: float = fixed_setting(
        4.0, 'memory that the network may use with CUDAExecutionProvider', 'GiB', 0.1, 1024.0)
    cache_dir: str = fixed_setting(
        '', 'folder for downloaded networks; empty: $XDG_CACHE_HOME/plane_detector')

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ('mean', 'std'):
            if len(getattr(self, name)) != 3:
                raise ValueError(f'depth.{name} must be 3 numbers, not {getattr(self, name)!r}')
        if not self.providers:
            raise ValueError('depth.providers must name at least one execution provider')
        if self.colour == 'none' and not self.is_measured:
            raise ValueError('depth.colour can be none only with depth.source topic or points')
        if self.kind == 'ray' and self.source == 'points':
            raise ValueError('depth.kind ray is for depth images only: with depth.source points, '
                             'each point has its own z')

    @property
    def is_measured(self) -> bool:
        """Whether a sensor measures depth, and no network is used."""
        return self.source != 'model'


@dataclass(frozen=True)
class ScaleConfig(Settings, section='scale'):
    """From disparity of unknown scale and shift to metres: 1/z = scale * disparity + shift."""

    method: str = setting(
        'auto', 'method that determines the unit of depth; auto: the first of metric, '
        'depth_topic, camera_height, manhattan, fixed that works with the network, the inputs and '
        'the scene',
        choices=('auto', 'metric', 'depth_topic', 'camera_height', 'manhattan', 'fixed', 'none'))
    disparity_scale: float = setting(
        0.0, 'factor on the network\'s relative disparity; 0: unknown', '1/m', 0.0, 1e6)
    disparity_shift: float = setting(0.0, 'offset added to the scaled disparity', '1/m', -1e3, 1e3)
    reference_focal_px: float = setting(
        -1.0, 'focal length, at the width of this image, of the camera that a metric network '
        'assumes: depth is multiplied by fx / this; 0: no correction; -1: the focal length that '
        'the zoo states for the network', 'px', -1.0, 1e5)
    camera_height: float = setting(
        0.0, 'height of the camera above the floor; 0: unknown', 'm', 0.0, 1000.0)
    gravity: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), 'downward direction in the optical frame, of any length; 0 0 0: unknown',
        '', -1e6, 1e6)
    gravity_tolerance: float = setting(
        2.0, 'largest error of the direction of gravity; above 5 degrees it only serves to '
        'distinguish the floor from the walls', 'deg', 0.0, 45.0)
    imu_to_camera: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0, 1.0), 'quaternion x y z w that rotates vectors from the frame of the IMU '
        'to the optical frame', '', -1.0, 1.0)
    smoothing: float = setting(
        0.8, 'weight of the previous scale and shift in each frame; 0: no smoothing',
        '', 0.0, 0.999, python_only=True)
    max_jump: float = setting(
        0.15, 'a frame whose scale and shift would change depth by more than this share is an '
        'outlier', '', 0.001, 10.0, python_only=True)
    reset_after: int = setting(
        3, 'this many consecutive outlier frames that agree with each other start a new scene',
        'frames', 1, 1000, python_only=True)
    hold_frames: int = setting(
        90, 'number of frames for which the last scale and shift are kept while they cannot be '
        'estimated', 'frames', 0, 1000000, python_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, length in (('gravity', 3), ('imu_to_camera', 4)):
            if len(numbers := getattr(self, name)) != length:
                raise ValueError(f'scale.{name} must be {length} numbers, not {numbers!r}')
        if max(map(abs, self.imu_to_camera)) < 1e-6:
            raise ValueError('scale.imu_to_camera must be a quaternion, not all zeros')


@dataclass(frozen=True)
class DirectionsConfig(Settings, section='directions'):
    """What the straight lines of the image are used for."""

    gravity: bool = setting(
        True, 'estimate the direction of gravity from the lines and the depth of the image if '
        'there is no IMU, TF or scale.gravity; used if they show reliably how the camera is '
        'mounted')
    mounting: str = setting(
        'any', 'mounting of the camera, used when gravity is estimated from the image: any: the '
        'camera may be on its side, upside down or looking straight down, which the depth of a '
        'network often leaves undecided; upright: it is neither', choices=('any', 'upright'))
    orient_planes: bool = setting(
        True, 'rotate planes in the depth of a network to the most likely orientation given their '
        'lines and the axes of the scene; measured depth is not changed')
    hold_time: float = setting(
        0.1, 'time by the stamps for which the lines of an image are reused for later images: '
        'with measured depth, where lines only provide gravity, and with a network while nothing '
        'moves; five to twenty times longer while the normals of planes show that the camera does '
        'not turn; 0: lines are detected in every image', 's', 0.0, 1.0, python_only=True)


@dataclass(frozen=True)
class SegmentationConfig(Settings, section='segmentation'):
    """Method and limits of the segmentation into planes."""

    method: str = setting(
        'disparity', 'disparity: the method of this package; paper: sequential RANSAC of '
        'pyRANSAC-3D, then DBSCAN, with metric thresholds', choices=('disparity', 'paper'))
    max_planes: int = setting(32, 'maximum number of planes', '', 1, 255)
    min_plane_share: float = setting(
        0.003, 'size of the smallest plane, as a share of the pixels', '', 0.0, 1.0)
    disparity_noise: float = setting(
        0.0, 'standard deviation of 1/depth; 0: estimated from the image, but at least the '
        'noise stated for the network', '1/m', 0.0, 10.0)
    flatness_distance: float = setting(
        0.015, 'adjacent planes of measured depth are merged if the depth deviates from their '
        'common plane by at most this (rms, including noise) and the angle between them is at '
        'most flatness_angle, unless there is a step between them; 0: only the noise decides',
        'm', 0.0, 1.0)
    flatness_angle: float = setting(
        4.0, 'largest angle between planes that are merged because of flatness_distance',
        'deg', 0.0, 45.0, python_only=True)
    memory: bool = setting(
        True, 'planes of measured depth persist from image to image unless the depth clearly '
        'contradicts them, and classes and confidences of tracked planes are averages; false: '
        'each image is judged independently')
    snap_to_picture: bool = setting(
        True, 'with the depth of a network, borders of planes move to image edges within about '
        '3 pixels of the network input', python_only=True)


@dataclass(frozen=True)
class RansacConfig(Settings, section='ransac'):
    """Search for planes by sequential RANSAC."""

    max_iterations: int = setting(
        1000, 'maximum number of hypotheses per search', '', 1, 1000000, python_only=True)
    seed: int = setting(0, 'seed of the random generator', '', 0, 2**31 - 1, python_only=True)


@dataclass(frozen=True)
class DbscanConfig(Settings, section='dbscan'):
    """Density clustering of the cells of one plane, in the grid of the image."""

    eps: float = setting(
        1.5, 'radius of the neighbourhood', 'cells', 1.0, 20.0, python_only=True)
    min_samples: int = setting(
        3, 'number of neighbours of a core cell, including itself', '', 1, 1000, python_only=True)


@dataclass(frozen=True)
class TrackingConfig(Settings, section='tracking'):
    """Matching of planes between images, so that they keep their labels."""

    enabled: bool = setting(
        True, 'a plane keeps its label from image to image; false: labels are assigned by size in '
        'each image')
    keep_frames: int = setting(
        30, 'number of frames for which a plane that is not found keeps its label',
        'frames', 0, 250, python_only=True)


@dataclass(frozen=True)
class GroundConfig(Settings, section='ground'):
    """What is traversable ground, what is an obstacle, and what is a drop."""

    max_step: float = setting(
        0.03, 'highest step, up or down, that the robot can drive over', 'm', 0.0, 1.0)
    max_slope: float = setting(15.0, 'steepest ramp that the robot can drive on', 'deg', 0.0, 45.0)
    min_height: float = setting(
        0.05, 'a point is an obstacle if its height above the ground exceeds this and its own '
        'error', 'm', 0.0, 1.0)
    min_drop: float = setting(
        0.08, 'there is a drop where the ground ends and the next surface is lower by more than '
        'this', 'm', 0.01, 10.0)
    ignore_box: tuple[float, ...] = setting(
        (0.0,) * 6, 'box around the visible parts of the robot: minimum x y z, then maximum x y '
        'z, in the optical frame; depth in it is neither ground nor obstacle; all 0: no box',
        'm', -100.0, 100.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        box = self.ignore_box
        if len(box) != 6 or any(low > high for low, high in zip(box[:3], box[3:], strict=False)):
            raise ValueError('ground.ignore_box must be 6 numbers, the minimum x y z and the '
                             f'maximum x y z of a box, not {box!r}')


@dataclass(frozen=True)
class GridConfig(Settings, section='grid'):
    """The grid of ground, obstacles and drops, seen from above."""

    resolution: float = setting(0.05, 'side length of a cell', 'm', 0.01, 1.0)
    size: float = setting(
        10.0, 'side length of the grid, which is centred on the origin of base_frame or the point '
        'below the camera', 'm', 0.5, 100.0)
    max_height: float = setting(
        2.0, 'points higher above the ground than this are not obstacles, because the robot '
        'passes below them', 'm', 0.1, 100.0)


@dataclass(frozen=True)
class MapConfig(Settings, section='map'):
    """One persistent plane per surface, from the planes of all images and the poses of TF."""

    enabled: bool = fixed_setting(
        False, 'keep a map of the planes of all images in target_frame, which must not move with '
        'the camera: odom or map')
    file: str = fixed_setting(
        'auto', 'file that ~/map/save writes and ~/map/load reads; ~ is the home folder; auto: '
        'the name of the node with the suffix _map.json, in the working directory')
    cell: float = fixed_setting(
        0.04, 'side length of the square cells that record where a plane was observed',
        'm', 0.005, 1.0)
    pose_jitter: float = fixed_setting(
        0.005, 'standard deviation of the part of the position error that is independent in each '
        'image; for the rotation, half as many radians', 'm', 0.0, 1.0)
    pose_drift: float = fixed_setting(
        0.01, 'standard deviation of the drift of the poses after one metre or radian; it grows '
        'with the square root of the distance travelled', '', 0.0, 1.0)


SHAPE_TYPES = ('sphere', 'cylinder', 'cone')


@dataclass(frozen=True)
class ShapesConfig(Settings, section='shapes'):
    """Spheres, cylinders and cones where there is no plane."""

    types: str = setting(
        'none', 'shapes to search for in metric depth where there is no plane: none, all, or some '
        'of sphere, cylinder, cone, separated by commas')

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = set(self.types.replace(' ', '').split(',')) - {*SHAPE_TYPES, 'all', 'none'}
        if unknown:
            raise ValueError('shapes.types must be none, all or some of '
                             f'{", ".join(SHAPE_TYPES)}, separated by commas, not {self.types!r}')

    @property
    def wanted(self) -> tuple[str, ...]:
        """Names of the shapes to search for."""
        named = self.types.replace(' ', '').split(',')
        return tuple(name for name in SHAPE_TYPES if name in named or 'all' in named)


@dataclass(frozen=True)
class PaperConfig(Settings, section='paper'):
    """Metric thresholds of the paper's method, the baseline."""

    distance_threshold: float = setting(0.05, 'RANSAC inlier distance', 'm', 1e-4, 10.0)
    max_iterations: int = setting(
        1000, 'number of RANSAC iterations per plane', '', 1, 10000, python_only=True)
    dbscan_eps: float = setting(0.1, 'DBSCAN radius', 'm', 1e-4, 1.0)
    dbscan_min_samples: int = setting(
        10, 'number of DBSCAN neighbours of a core point', '', 1, 10000, python_only=True)
    max_points: int = setting(
        20000, 'points are reduced to this number before the search; the time grows with its '
        'square if all of them are within dbscan_eps', '', 100, 50000, python_only=True)


@dataclass(frozen=True)
class Config(Settings):
    """
    All settings of the pipeline.

    Examples
    --------
    >>> Config(segmentation=SegmentationConfig(max_planes=5)).segmentation.max_planes
    5
    >>> SegmentationConfig(max_planes=0)
    Traceback (most recent call last):
    ValueError: segmentation.max_planes must be in [1, ...], not 0

    """

    depth: DepthConfig = field(default_factory=DepthConfig)
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    directions: DirectionsConfig = field(default_factory=DirectionsConfig)
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)
    ransac: RansacConfig = field(default_factory=RansacConfig)
    dbscan: DbscanConfig = field(default_factory=DbscanConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    shapes: ShapesConfig = field(default_factory=ShapesConfig)
    ground: GroundConfig = field(default_factory=GroundConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    map: MapConfig = field(default_factory=MapConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)


@dataclass(frozen=True)
class NodeConfig(Settings):
    """Settings of the ROS node only."""

    autostart: bool = fixed_setting(
        True, 'configure and activate at startup, without a lifecycle manager')
    exit_on_failure: bool = fixed_setting(
        False, 'with autostart: true: exit with code 1 if the node cannot be configured or '
        'activated, for supervisors; false: keep running, and retry if that can help')
    input_reliability: str = fixed_setting(
        'auto', 'reliability of the inputs; auto: as offered by their publishers',
        choices=('auto', 'reliable', 'best_effort'))
    image_transport: str = fixed_setting(
        'raw', 'raw: sensor_msgs/Image on image; compressed: sensor_msgs/CompressedImage on '
        'image/compressed', choices=('raw', 'compressed'))
    max_image_pixels: int = setting(
        25_000_000, 'larger images are refused, compressed ones before they are decoded; a '
        'million pixels take about 50 MB', 'px', 1, 2**30)
    rectify: str = setting(
        'auto', 'undo the lens distortion of CameraInfo; auto: if there is distortion and the '
        'name of the topic does not say that it is rectified', choices=('auto', 'true', 'false'))
    lens_is_guessed: bool = setting(
        False, 'the CameraInfo is a guess, for example from an unmeasured field of view, so '
        'results that depend on angles between rays, such as gravity from the lines of the image, '
        'are uncertain')
    stamp_slop: float = setting(
        0.02, 'largest difference between the stamps of an image and its depth image, if no depth '
        'image has the same stamp', 's', 0.0, 10.0)
    use_imu: bool = fixed_setting(
        False, 'use the direction of gravity from sensor_msgs/Imu on imu; scale.imu_to_camera is '
        'the mounting of the IMU')
    max_side: int = setting(
        0, 'images with a longer side above this are first reduced to it, to save time; all '
        'outputs have the reduced size; 0: off', 'px', 0, 65536)
    base_frame: str = fixed_setting(
        '', 'frame of the robot with its origin on the floor, for example base_footprint: TF '
        'provides the direction of gravity and the height of the camera; empty: off')
    target_frame: str = fixed_setting(
        '', 'frame of the clouds, planes, poses, markers and grid, for example base_link, odom or '
        'map; requires TF; empty: the frame of the image')
    points_color: str = setting(
        'image', 'colours of ~/points: image: colours of the image; label: one colour per plane, '
        'as in the markers; overlay: both mixed, as in the overlay',
        choices=('image', 'label', 'overlay'))
    picture_rate: float = setting(
        10.0, 'highest rate of ~/markers, ~/overlay and ~/overlay/compressed, which are made for '
        'people; the last one is always published; 0: one per image', 'Hz', 0.0, 1000.0)
    mode: str = setting(
        'continuous', 'continuous: always process the newest frame; on_demand: one frame per call '
        'of ~/detect', choices=('continuous', 'on_demand'))
    points_decimation: int = setting(
        1, 'the clouds contain every n-th row and column; 1: all of them', '', 1, 64)

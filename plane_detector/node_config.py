# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the ROS node only; see :mod:`plane_detector.config`, which hands them out."""

from __future__ import annotations

from dataclasses import dataclass

from plane_detector.settings import Settings, fixed_setting, setting


@dataclass(frozen=True)
class NodeConfig(Settings):
    """Settings of the ROS node only."""

    autostart: bool = fixed_setting(
        True, 'configure and activate at start, without a lifecycle manager')
    exit_on_failure: bool = fixed_setting(
        False, 'with autostart: exit with code 1 if the node cannot be configured or activated, '
        'for supervisors; false: keep running, and retry if that can help')
    input_reliability: str = fixed_setting(
        'auto', 'reliability of the inputs; auto: as offered by their publishers',
        choices=('auto', 'reliable', 'best_effort'))
    image_transport: str = fixed_setting(
        'raw', 'raw: sensor_msgs/Image on image; compressed: sensor_msgs/CompressedImage on '
        'image/compressed', choices=('raw', 'compressed'))
    max_image_pixels: int = setting(
        50_000_000, 'a compressed image of more pixels is refused before it is decoded', 'px', 1,
        2**30)
    rectify: str = setting(
        'auto', 'undo the lens distortion of CameraInfo; auto: if there is any and the topic is '
        'not named as rectified', choices=('auto', 'true', 'false'))
    stamp_slop: float = setting(
        0.02, 'largest difference between the stamps of an image and its depth image, if no depth '
        'image has the same stamp', 's', 0.0, 10.0)
    use_imu: bool = fixed_setting(
        False, 'use the direction of gravity from sensor_msgs/Imu on imu; its mounting is '
        'scale.imu_to_camera')
    max_side: int = setting(
        0, 'images whose longer side is larger are first reduced to this, to save time; all '
        'outputs have the reduced size; 0: off', 'px', 0, 65536)
    base_frame: str = fixed_setting(
        '', 'frame of the robot with its origin on the floor, such as base_footprint: direction '
        'of gravity and height of the camera come from TF; empty: off')
    base_up: tuple[float, ...] = setting(
        (0.0, 0.0, 1.0), 'direction up in base_frame', '', -1e6, 1e6)
    target_frame: str = fixed_setting(
        '', 'frame of the clouds, planes, poses and markers, such as base_link, odom or map, by '
        'TF; empty: that of the image')
    tf_timeout: float = setting(
        0.2, 'longest time to wait for a transform; then the frame is skipped', 's', 0.0, 10.0)
    points_color: str = setting(
        'image', 'colours of ~/points: those of the image, one per plane as in the markers '
        '(label), or both mixed as in the overlay', choices=('image', 'label', 'overlay'))
    mode: str = setting(
        'continuous', 'continuous: process the newest frame repeatedly; on_demand: one frame per '
        'call of ~/detect', choices=('continuous', 'on_demand'))
    points_decimation: int = setting(
        1, 'the clouds contain every n-th row and column; 1: all', '', 1, 64)
    marker_lifetime: float = setting(
        0.0, 'markers disappear after this time without new ones; 0: never', 's', 0.0, 1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.base_up) != 3 or not any(self.base_up):
            raise ValueError(f'base_up must be 3 numbers, not all zeros, not {self.base_up!r}')

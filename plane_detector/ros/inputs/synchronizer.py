# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Assembly of frames from messages that belong together.

The same code is used for live topics and for bags: the result depends on the stamps and on the
order within each topic, not on how the topics interleave.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2

from plane_detector.config import Config
from plane_detector.geometry.disparity import UNITLESS
from plane_detector.geometry.gravity import GravityFilter
from plane_detector.ros.calibration import image_size
from plane_detector.types import JUMP_S

_CACHED = 16
_NOT_MEASURED = -1  # derived: first element of a covariance, by sensor_msgs/Imu
JUMP_NS = round(1e9 * JUMP_S)


@dataclass(frozen=True)
class Frame:
    """
    The messages of one image.

    Its CameraInfo has the same stamp if there is one, otherwise it is the latest. An image of
    another size waits for the next CameraInfo while these keep arriving.
    """

    image: Image | CompressedImage | PointCloud2  # depth itself, if there is no colour
    camera_info: CameraInfo
    depth: Image | CompressedImage | PointCloud2 | None  # measured, beside the image
    gravity_camera: np.ndarray | None  # (3,) float64, direction in the optical frame, by an IMU
    epoch: int  # increases if time jumps back: frames of different epochs share no history
    imu_problem: str = ''  # problem with the readings of the IMU; empty if there is none


def depth_use(config: Config, output: str) -> str:
    """
    Return whether measured depth beside an image is ``required``, ``optional`` or ``unused``.

    Only network outputs of unknown scale use the unit of measured depth.
    """
    if config.depth.is_measured:
        return 'required' if config.depth.colour == 'image' else 'unused'
    if config.scale.method == 'depth_topic':
        return 'optional'
    return 'optional' if output in UNITLESS and config.scale.method == 'auto' else 'unused'


class FrameSynchronizer:
    """
    Matches images, calibrations, depth images and gravity by their stamps.

    Parameters
    ----------
    depth : str
        ``unused``; ``required``: an image without depth is dropped; ``optional``: depth is used if
        available, and awaited until the next image at most.
    stamp_slop_s : float
        A depth image with exactly the stamp of the image is used. If a later one shows that there
        is none, the nearest within this time is used.
    imu_to_camera : (4,) float
        Quaternion x y z w of the mounting of the IMU.

    """

    def __init__(self, depth: str = 'unused', stamp_slop_s: float = 0.0,
                 imu_to_camera: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)):
        self._depth_use, self._stamp_slop_s = depth, stamp_slop_s
        self._images, self._infos, self._depths = _Messages(), _Messages(), _Messages()
        self._gravity = GravityFilter(imu_to_camera)
        self._last_ns = 0
        self._dropped = 0
        self._unpaired_ns: int | None = None

    @property
    def epoch(self) -> int:
        """Number of jumps back in time so far."""
        return self._images.jumps

    def apply(self, depth: str, stamp_slop_s: float) -> None:
        """Change the parameters of this object; waiting messages are matched by the new ones."""
        self._depth_use, self._stamp_slop_s = depth, stamp_slop_s

    def mount_imu(self, imu_to_camera: Sequence[float]) -> None:
        """Change the mounting of the IMU."""
        self._gravity.mount(imu_to_camera)

    def take_dropped(self) -> int:
        """Return the number of images dropped without a partner since the last call."""
        count, self._dropped = self._dropped, 0
        return count

    def take_unpaired_s(self) -> float | None:
        """
        Return how much later the nearest depth image is than the last image dropped without depth.

        None if no image was dropped for lack of a depth image since the last call, or if there is
        no depth image at all.
        """
        taken, self._unpaired_ns = self._unpaired_ns, None
        return None if taken is None else taken * 1e-9

    def add_image(self, msg: Image | CompressedImage) -> list[Frame]:
        """Add an image; return the frames that are complete now, oldest first."""
        epoch = self._images.jumps
        most = 1 if self._depth_use == 'unused' else _CACHED
        if dropped := self._images.add(msg, most):
            self._dropped += dropped
            if self._depth_use == 'required' and self._infos.latest is not None:
                self._unpaired_ns = self._depths.offset_of_nearest(ns_of(msg))
        if self._images.jumps != epoch:
            self._depths.forget_after(ns_of(msg) + JUMP_NS)
            self._gravity.reset()
        return self._complete()

    def add_camera_info(self, msg: CameraInfo) -> list[Frame]:
        """Add a calibration; return the frames that are complete now, oldest first."""
        if self._infos.latest is None:  # of the earlier images, only one with its stamp is usable
            self._dropped += self._images.keep({ns_of(msg)})
        self._infos.add(msg)
        return self._complete()

    def add_depth(self, msg: Image) -> list[Frame]:
        """Add a depth image; return the frames that are complete now, oldest first."""
        self._depths.add(msg)
        return self._complete()

    def finish(self) -> list[Frame]:
        """Return the frames still waiting for a better partner, at the end of the messages."""
        return self._complete(at_end=True)

    def add_imu(self, msg: Imu) -> None:
        """Add a reading of the IMU, for frames that are completed later."""
        force, turn = msg.linear_acceleration, msg.angular_velocity
        has_turn = msg.angular_velocity_covariance[0] != _NOT_MEASURED
        self._gravity.add(ns_of(msg) * 1e-9, (force.x, force.y, force.z),
                          (turn.x, turn.y, turn.z) if has_turn else None)

    def _complete(self, at_end: bool = False) -> list[Frame]:
        frames = []
        images, infos, depths = (one.by_stamp for one in (self._images, self._infos, self._depths))
        for stamp_ns, image in list(images.items()) if infos else ():
            is_decided, depth = self._depth_for(stamp_ns, at_end)
            info = infos.get(stamp_ns, self._infos.latest)
            if not is_decided or (not at_end and self._awaits_calibration(image, info)):
                continue
            del images[stamp_ns]
            if depth is None and self._depth_use == 'required':
                self._dropped += 1
                self._unpaired_ns = self._depths.offset_of_nearest(stamp_ns)
                continue
            # Depth older than the last frame but one is dropped: images may arrive out of order.
            oldest_ns = min(self._last_ns, stamp_ns) - round(self._stamp_slop_s * 1e9)
            for other_ns in [other_ns for other_ns in depths if other_ns < oldest_ns]:
                del depths[other_ns]
            self._last_ns = stamp_ns
            gravity = self._gravity.gravity_camera(stamp_ns * 1e-9)
            frames.append(Frame(image, info, depth, gravity, self._images.jumps,
                                self._gravity.problem))
        return frames

    def _awaits_calibration(self, image: Image | CompressedImage, info: CameraInfo) -> bool:
        """Return whether an image does not fit its calibration and a later one may still come."""
        if isinstance(image, CompressedImage) or info.header.stamp == image.header.stamp:
            return False
        can_come = (self._infos.has_recent(self._images.latest_ns)
                    and self._infos.latest_ns <= ns_of(image))
        return can_come and image_size(info) not in ((image.width, image.height), (0, 0))

    def _depth_for(self, stamp_ns: int, at_end: bool) -> tuple[bool, Image | None]:
        """Return whether the depth image of an image is determined, and the depth image."""
        exact = self._depths.by_stamp.get(stamp_ns)
        if exact is not None or self._depth_use == 'unused':
            return True, exact
        can_wait = not at_end and (self._depth_use == 'required' or (
            self._depths.has_recent(stamp_ns) and self._images.latest_ns <= stamp_ns))
        if can_wait and self._depths.latest_ns <= stamp_ns:
            return False, None
        offset_ns = self._depths.offset_of_nearest(stamp_ns)
        if offset_ns is None or abs(offset_ns) > round(self._stamp_slop_s * 1e9):
            return True, None
        return True, self._depths.by_stamp[stamp_ns + offset_ns]


class _Messages:
    """The latest messages of one topic by stamp; emptied when time jumps back."""

    def __init__(self) -> None:
        self.by_stamp: dict[int, Any] = {}  # in the order of arrival; the last one for each stamp
        self.latest: Any = None
        self.latest_ns = 0
        self.jumps = 0

    def add(self, msg: Any, most: int = _CACHED) -> int:
        """Add a message; return how many of this epoch are dropped: same stamp, or too many."""
        stamp_ns = ns_of(msg)
        if self.latest is not None and stamp_ns < self.latest_ns - JUMP_NS:
            self.jumps += 1
            self.by_stamp.clear()
        before = len(self.by_stamp) + 1
        self.by_stamp.pop(stamp_ns, None)
        self.by_stamp[stamp_ns] = self.latest = msg
        self.latest_ns = stamp_ns
        while len(self.by_stamp) > most:
            del self.by_stamp[next(iter(self.by_stamp))]
        return before - len(self.by_stamp)

    def keep(self, stamps_ns: Collection[int]) -> int:
        """Keep only the messages with these stamps; return how many are dropped."""
        gone = [stamp_ns for stamp_ns in self.by_stamp if stamp_ns not in stamps_ns]
        for stamp_ns in gone:
            del self.by_stamp[stamp_ns]
        return len(gone)

    def forget_after(self, stamp_ns: int) -> None:
        """Remove later messages, which were sent before a jump back in time."""
        self.keep([other_ns for other_ns in self.by_stamp if other_ns <= stamp_ns])
        self.latest_ns = min(self.latest_ns, stamp_ns) if self.by_stamp else 0

    def has_recent(self, stamp_ns: int) -> bool:
        """Whether messages arrived shortly before a stamp."""
        return self.latest is not None and self.latest_ns > stamp_ns - JUMP_NS

    def offset_of_nearest(self, stamp_ns: int) -> int | None:
        """Return how much later than a stamp the message nearest to it is; None without one."""
        return min((other_ns - stamp_ns for other_ns in self.by_stamp), key=abs, default=None)


def stamp_text(stamped: Any) -> str:
    """
    Return the exact stamp of a message, or of anything else with a header, in seconds.

    Examples
    --------
    >>> from sensor_msgs.msg import Image
    >>> msg = Image()
    >>> msg.header.stamp.nanosec = 50
    >>> stamp_text(msg)
    '0.000000050'

    """
    stamp = stamped.header.stamp
    return f'{stamp.sec}.{stamp.nanosec:09d}'


def ns_of(stamped: Any) -> int:
    """Return the stamp of a message, or of anything else with a header, in nanoseconds."""
    return stamped.header.stamp.sec * 1_000_000_000 + stamped.header.stamp.nanosec

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Assembly of frames from the messages that belong together.

The same code is used for live topics and for bags: the result depends on the stamps and on the
order within each topic, not on how the topics interleave.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2

from plane_detector.config import Config
from plane_detector.geometry.disparity import UNITLESS
from plane_detector.geometry.gravity import gravity_from_acceleration, smooth_gravity
from plane_detector.ros.calibration import image_size
from plane_detector.types import JUMP_S

_CACHED = 16
JUMP_NS = round(1e9 * JUMP_S)
_SILENT_IMU_S = 1.0


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


def depth_use(config: Config, output: str) -> str:
    """
    Return whether measured depth beside an image is ``required``, ``optional`` or ``unused``.

    Of the outputs of networks only those of unknown scale use the unit of measured depth.
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
        ``unused``; ``required``: an image without depth is dropped; ``optional``: depth is used
        if available, and waited for until the next image at most.
    stamp_slop_s : float
        A depth image with exactly the stamp of the image is used. If a later one shows that there
        is none, the nearest within this time is used.
    imu_to_camera : (4,) float
        Quaternion x y z w of the mounting of the IMU.

    """

    def __init__(self, depth: str = 'unused', stamp_slop_s: float = 0.0,
                 imu_to_camera: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)):
        self._depth_use, self._stamp_slop_s = depth, stamp_slop_s
        self._images = _MessageBuffer()
        self._infos = _MessageBuffer()
        self._depths = _MessageBuffer()
        self._gravity = _GravityFilter(imu_to_camera)
        self._last_ns = 0
        self._dropped = 0
        self._unpaired_ns: int | None = None
        self.epoch = 0

    def apply(self, depth: str, stamp_slop_s: float) -> None:
        """Change the parameters of this object; messages that wait are matched by the new ones."""
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
        Return how much later than the last image dropped for it the nearest depth image is.

        None if no image was dropped for lack of a depth image since the last call, or if there is
        no depth image at all.
        """
        taken, self._unpaired_ns = self._unpaired_ns, None
        return None if taken is None else taken * 1e-9

    def add_image(self, msg: Image | CompressedImage) -> list[Frame]:
        """Add an image; return the frames that are complete now, oldest first."""
        if self._images.add(msg):
            self.epoch += 1
            self._depths.forget_after(ns_of(msg) + JUMP_NS)
            self._gravity.reset()
        dropped = self._images.shrink_to(1 if self._depth_use == 'unused' else _CACHED)
        self._dropped += dropped
        if dropped and self._depth_use == 'required' and self._infos.latest is not None:
            self._unpaired_ns = self._depths.offset_of_nearest(ns_of(msg))
        return self._complete()

    def add_camera_info(self, msg: CameraInfo) -> list[Frame]:
        """Add a calibration; return the frames that are complete now, oldest first."""
        first = self._infos.latest is None
        self._infos.add(msg)
        self._infos.shrink_to(_CACHED)
        if first:  # of the images before it, only one with its stamp is usable
            self._dropped += self._images.keep(lambda stamp_ns, _: stamp_ns == ns_of(msg))
        return self._complete()

    def add_depth(self, msg: Image) -> list[Frame]:
        """Add a depth image; return the frames that are complete now, oldest first."""
        self._depths.add(msg)
        self._depths.shrink_to(_CACHED)
        return self._complete()

    def finish(self) -> list[Frame]:
        """Return the frames still waiting for a better partner, when no more messages come."""
        return self._complete(at_end=True)

    def add_imu(self, msg: Imu) -> None:
        """Add an accelerometer reading, for frames that are completed later."""
        force = msg.linear_acceleration
        self._gravity.add(ns_of(msg) * 1e-9, (force.x, force.y, force.z))

    def _complete(self, at_end: bool = False) -> list[Frame]:
        frames = []
        for stamp_ns, image in self._images.items() if self._infos.latest else ():
            decided, depth = self._depth_for(stamp_ns, at_end)
            info = self._infos.exact(stamp_ns) or self._infos.latest
            if not decided or (not at_end and self._awaits_calibration(image, info)):
                continue
            self._images.keep(lambda _, other, done=image: other is not done)
            if depth is None and self._depth_use == 'required':
                self._dropped += 1
                self._unpaired_ns = self._depths.offset_of_nearest(stamp_ns)
                continue
            self._forget_depths(stamp_ns)
            gravity = self._gravity.gravity_camera(stamp_ns * 1e-9)
            frames.append(Frame(image, info, depth, gravity, self.epoch))
        return frames

    def _forget_depths(self, stamp_ns: int) -> None:
        """Forget depth images from before the last frame but one: images may change places."""
        oldest_ns = min(self._last_ns, stamp_ns) - round(self._stamp_slop_s * 1e9)
        self._depths.keep(lambda other_ns, _: other_ns >= oldest_ns)
        self._last_ns = stamp_ns

    def _awaits_calibration(self, image: Image | CompressedImage, info: CameraInfo) -> bool:
        """Return whether an image does not fit its calibration and a later one may still come."""
        if isinstance(image, CompressedImage) or info.header.stamp == image.header.stamp:
            return False
        can_come = (self._infos.has_recent(ns_of(self._images.latest))
                    and not self._infos.is_past(ns_of(image)))
        return can_come and image_size(info) not in ((image.width, image.height), (0, 0))

    def _depth_for(self, stamp_ns: int, at_end: bool) -> tuple[bool, Image | None]:
        """Return whether the depth image of an image is determined, and the depth image."""
        exact = self._depths.exact(stamp_ns)
        if exact is not None or self._depth_use == 'unused':
            return True, exact
        can_wait = not at_end and (self._depth_use == 'required' or (
            self._depths.has_recent(stamp_ns) and not self._images.is_past(stamp_ns)))
        if can_wait and not self._depths.is_past(stamp_ns):
            return False, None
        return True, self._depths.nearest(stamp_ns, round(self._stamp_slop_s * 1e9))


class _MessageBuffer:
    """The latest messages of one topic by stamp; emptied when time jumps back."""

    def __init__(self) -> None:
        self._messages: deque[tuple[int, Any]] = deque()
        self._latest_ns = 0
        self.latest: Any = None

    def add(self, msg: Any) -> bool:
        """Add a message; return whether time has jumped back."""
        stamp_ns = ns_of(msg)
        jumped = self.latest is not None and stamp_ns < self._latest_ns - JUMP_NS
        if jumped:
            self._messages.clear()
        self._messages.append((stamp_ns, msg))
        self._latest_ns, self.latest = stamp_ns, msg
        return jumped

    def shrink_to(self, count: int) -> int:
        """Remove the oldest messages beyond a count; return their number."""
        removed = max(len(self._messages) - count, 0)
        for _ in range(removed):
            self._messages.popleft()
        return removed

    def keep(self, condition: Callable[[int, Any], bool]) -> int:
        """Keep the messages that meet a condition on stamp and message; return how many go."""
        before = len(self._messages)
        self._messages = deque(entry for entry in self._messages if condition(*entry))
        return before - len(self._messages)

    def forget_after(self, stamp_ns: int) -> None:
        """Remove later messages, which are from before a jump back in time."""
        self.keep(lambda other_ns, _: other_ns <= stamp_ns)
        self._latest_ns = min(self._latest_ns, stamp_ns) if self._messages else 0

    def items(self) -> list[tuple[int, Any]]:
        """Return stamp and message of each, in the order of arrival."""
        return list(self._messages)

    def exact(self, stamp_ns: int) -> Any:
        """Return the last message with this stamp, or None."""
        return next((msg for other_ns, msg in reversed(self._messages) if other_ns == stamp_ns),
                    None)

    def is_past(self, stamp_ns: int) -> bool:
        """Whether a later message has arrived, so that none with this stamp will."""
        return self._latest_ns > stamp_ns

    def has_recent(self, stamp_ns: int) -> bool:
        """Whether messages arrived shortly before a stamp."""
        return self.latest is not None and self._latest_ns > stamp_ns - JUMP_NS

    def nearest(self, stamp_ns: int, slop_ns: int) -> Any:
        """Return the message nearest in time within the slop, or None."""
        offset_ns = self.offset_of_nearest(stamp_ns)
        if offset_ns is None or abs(offset_ns) > slop_ns:
            return None
        return self.exact(stamp_ns + offset_ns)

    def offset_of_nearest(self, stamp_ns: int) -> int | None:
        """Return how much later than a stamp the message nearest to it is; None without one."""
        return min((other_ns - stamp_ns for other_ns, _ in self._messages), key=abs, default=None)


class _GravityFilter:
    """Smooths readings of an accelerometer over time; those during acceleration are ignored."""

    def __init__(self, imu_to_camera: Sequence[float]):
        self._imu_to_camera = imu_to_camera
        self.reset()

    def mount(self, imu_to_camera: Sequence[float]) -> None:
        """Change the mounting of the IMU; readings by another one are discarded."""
        if tuple(imu_to_camera) != tuple(self._imu_to_camera):
            self._imu_to_camera = imu_to_camera
            self.reset()

    def reset(self) -> None:
        """Discard all readings."""
        self._gravity_camera: np.ndarray | None = None
        self._stamp_s = -np.inf

    def add(self, stamp_s: float, acceleration: Sequence[float]) -> None:
        """Add a reading (x, y, z) in m/s^2."""
        reading = gravity_from_acceleration(acceleration, self._imu_to_camera)
        if reading is None:
            return
        if stamp_s < self._stamp_s - _SILENT_IMU_S:
            self.reset()
        interval_s = min(stamp_s - self._stamp_s, 1e3)
        self._gravity_camera = smooth_gravity(self._gravity_camera, reading, interval_s)
        self._stamp_s = stamp_s

    def gravity_camera(self, stamp_s: float) -> np.ndarray | None:
        """Return the direction of gravity (3,), optical frame; None without recent readings."""
        return self._gravity_camera if stamp_s - self._stamp_s <= _SILENT_IMU_S else None


def stamp_text(stamped: Any) -> str:
    """
    Return the stamp of a message, or of what else has a header, in seconds and exact.

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
    """Return the stamp of a message, or of what else has a header, in nanoseconds."""
    return stamped.header.stamp.sec * 1_000_000_000 + stamped.header.stamp.nanosec

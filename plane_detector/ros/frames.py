# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Which messages belong together.

The same code pairs the messages of live topics and those of a bag: what goes with what depends
on the stamps and on the order within each topic, not on how the topics interleave.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image

_CACHED = 16
_JUMP_NS = 1_000_000_000


@dataclass(frozen=True)
class Frame:
    """
    The messages of one picture.

    Attributes
    ----------
    image : sensor_msgs.msg.Image or CompressedImage
        The picture.
    camera_info : sensor_msgs.msg.CameraInfo
        With the same stamp where there is one, else the latest.
    depth : sensor_msgs.msg.Image or None
        Measured depth, where it is used.
    epoch : int
        Grows when time jumps back: frames of two epochs have no common past.

    """

    image: Image | CompressedImage
    camera_info: CameraInfo
    depth: Image | None
    epoch: int


class FrameAssembler:
    """
    Puts pictures, calibrations and depth images together by their stamps.

    Parameters
    ----------
    needs_depth : bool
        A frame without a depth image is none.
    stamp_slop_s : float
        A depth image with exactly the picture's stamp is taken; else, once a later one shows
        that there is none, the nearest within this time.

    """

    def __init__(self, needs_depth: bool = False, stamp_slop_s: float = 0.0):
        self._needs_depth = needs_depth
        self.stamp_slop_s = stamp_slop_s
        self._images = _StampedCache()
        self._infos = _StampedCache()
        self._depths = _StampedCache()
        self._dropped = 0
        self.epoch = 0

    @property
    def missing(self) -> tuple[str, ...]:
        """What has not been received yet, of what a frame needs."""
        needed = {'image': self._images, 'camera_info': self._infos}
        if self._needs_depth:
            needed['depth'] = self._depths
        return tuple(name for name, cache in needed.items() if cache.latest is None)

    def take_dropped(self) -> int:
        """Return how many pictures were dropped for want of a partner since the last call."""
        count, self._dropped = self._dropped, 0
        return count

    def add_image(self, msg: Image | CompressedImage) -> list[Frame]:
        """Take a picture; return the frames that are complete now, oldest first."""
        if self._images.add(msg):
            self.epoch += 1
            self._depths.forget_after(_stamp_ns(msg) + _JUMP_NS)
        self._dropped += self._images.shrink_to(_CACHED if self._needs_depth else 1)
        return self._complete()

    def add_camera_info(self, msg: CameraInfo) -> list[Frame]:
        """Take a calibration; return the frames that are complete now, oldest first."""
        first = self._infos.latest is None
        self._infos.add(msg)
        self._infos.shrink_to(_CACHED)
        if first:  # of the pictures from before any calibration only its own is of any use
            self._dropped += self._images.keep(lambda stamp_ns, _: stamp_ns == _stamp_ns(msg))
        return self._complete()

    def add_depth(self, msg: Image) -> list[Frame]:
        """Take a depth image; return the frames that are complete now, oldest first."""
        self._depths.add(msg)
        self._depths.shrink_to(_CACHED)
        return self._complete()

    def _complete(self) -> list[Frame]:
        frames = []
        for stamp_ns, image in self._images.items() if self._infos.latest else ():
            depth = self._depths.exact(stamp_ns)
            if self._needs_depth and depth is None:
                if not self._depths.is_past(stamp_ns):
                    continue
                depth = self._depths.nearest(stamp_ns, round(self.stamp_slop_s * 1e9))
            self._images.keep(lambda _, other, done=image: other is not done)
            if self._needs_depth and depth is None:
                self._dropped += 1
                continue
            info = self._infos.exact(stamp_ns) or self._infos.latest
            frames.append(Frame(image, info, depth, self.epoch))
        return frames


class _StampedCache:
    """The last messages of one topic by stamp; emptied when time jumps back."""

    def __init__(self) -> None:
        self._messages: deque[tuple[int, Any]] = deque()
        self._latest_ns = 0
        self.latest: Any = None

    def add(self, msg: Any) -> bool:
        """Add a message; return whether time has jumped back."""
        stamp_ns = _stamp_ns(msg)
        jumped = self.latest is not None and stamp_ns < self._latest_ns - _JUMP_NS
        if jumped:
            self._messages.clear()
        self._messages.append((stamp_ns, msg))
        self._latest_ns, self.latest = stamp_ns, msg
        return jumped

    def shrink_to(self, count: int) -> int:
        """Remove the oldest messages beyond a count; return how many."""
        removed = max(len(self._messages) - count, 0)
        for _ in range(removed):
            self._messages.popleft()
        return removed

    def keep(self, condition: Callable[[int, Any], bool]) -> int:
        """Remove what does not meet a condition on stamp and message; return how many."""
        before = len(self._messages)
        self._messages = deque(entry for entry in self._messages if condition(*entry))
        return before - len(self._messages)

    def forget_after(self, stamp_ns: int) -> None:
        """Forget what is later: it is from before a jump back in time."""
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
        """Whether a later message has come, so that none with this stamp will."""
        return self._latest_ns > stamp_ns

    def nearest(self, stamp_ns: int, slop_ns: int) -> Any:
        """Return the message nearest in time within the slop, or None."""
        if not self._messages:
            return None
        other_ns, msg = min(self._messages, key=lambda entry: abs(entry[0] - stamp_ns))
        return msg if abs(other_ns - stamp_ns) <= slop_ns else None


def _stamp_ns(msg: Any) -> int:
    return msg.header.stamp.sec * 1_000_000_000 + msg.header.stamp.nanosec

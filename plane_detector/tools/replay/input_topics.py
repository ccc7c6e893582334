# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the topics and the depth of a bag: those requested, or the only ones that fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from plane_detector.config import Config
from plane_detector.ros.calibration import image_size
from plane_detector.ros.inputs.synchronizer import depth_use
from plane_detector.tools.replay.bag_reader import BagError, BagReader, Topic
from plane_detector.tools.replay.options import ReplayOptions

_CLASSES = {'sensor_msgs/msg/Image': Image, 'sensor_msgs/msg/CompressedImage': CompressedImage,
            'sensor_msgs/msg/CameraInfo': CameraInfo, 'sensor_msgs/msg/Imu': Imu}
_ROLES = {'image': (Image, CompressedImage), 'camera_info': (CameraInfo,), 'depth': (Image,),
          'imu': (Imu,)}
_DEPTH_ENCODINGS = ('16uc1', '32fc1')
_GREY_ENCODINGS = ('mono8', 'mono16')
_RECTIFIED_WORD = 'rect'


@dataclass(frozen=True)
class InputTopics:
    """Names of the input topics; empty if not used."""

    image: str
    camera_info: str
    depth: str = ''
    imu: str = ''

    @property
    def names(self) -> tuple[str, ...]:
        """All topics that are used."""
        return tuple(name for f in fields(self) if (name := getattr(self, f.name)))


def input_class(bag: BagReader, topic: str) -> Any:
    """Return the class of an input topic's messages."""
    return _CLASSES[bag.connection(topic).msgtype]


def find_camera(bag: BagReader, wanted: Mapping[str, str]) -> InputTopics:
    """
    Choose image and calibration, by default among all images, and the calibration beside it.

    Parameters
    ----------
    bag : BagReader
    wanted : mapping of str to str
        Requested topics, by ``image``, ``camera_info``, ``depth`` and ``imu``.

    Raises
    ------
    BagError
        A topic is missing, has another type, or several fit; the message lists the topics.

    """
    for role, name in wanted.items():
        _check(bag, role, name)
    image = wanted.get('image') or _find_image(bag)
    return InputTopics(image, wanted.get('camera_info') or _find_camera_info(bag, image))


@dataclass(frozen=True)
class DepthChoice:
    """Settings with the source of depth, its topic if one was found in the bag, and why."""

    config: Config
    topic: str
    why: str

    def describe(self, facts: Mapping[str, str]) -> str:
        """Return one line with the source, by the facts of a detector, and the reason."""
        if self.config.depth.source == 'topic':
            return f'measured: {self.why}'
        reason = facts.get('depth_model_reason', '')
        return f'network {facts["depth_model"]}{f" ({reason})" if reason else ""}, {self.why}'


def choose_depth(bag: BagReader, camera: InputTopics, options: ReplayOptions) -> DepthChoice:
    """
    Return measured depth if the bag has it for this image, unless another source is requested.

    Measured depth needs no transform if it has the frame_id and the size of the image.

    Raises
    ------
    BagError
        Several depth topics fit.

    """
    config = options.config
    if not options.depth_by_bag:
        what = options.topics.get('depth', 'the depth topic')
        measured = config.depth.source == 'topic'
        return DepthChoice(
            config, '', f'{what if measured else "not measured depth"}, as requested')
    image, size = _first(bag, camera.image), _size_of(bag, camera)
    others, fitting = [], []
    for topic in _depth_images(bag, camera.image):
        depth = _first(bag, topic.name)
        what = (f'{topic.name} ({depth.width} x {depth.height}, {depth.encoding}, frame_id '
                f'{depth.header.frame_id!r})')
        fits = (depth.header.frame_id == image.header.frame_id
                and (depth.width, depth.height) == size)
        (fitting if fits else others).append((topic, what))
    if fitting:
        name = _only(bag, 'depth', [topic for topic, _ in fitting])
        return DepthChoice(replace(config, depth=replace(config.depth, source='topic')), name,
                           f'{fitting[0][1]}, registered to the image')
    if others:
        return DepthChoice(config, '', (
            f'because {", ".join(what for _, what in others)} is not registered to the image '
            f'({size[0]} x {size[1]}, frame_id {image.header.frame_id!r})'))
    return DepthChoice(config, '', 'because the bag has no depth images')


def with_companions(bag: BagReader, camera: InputTopics, choice: DepthChoice, output: str,
                    options: ReplayOptions) -> InputTopics:
    """
    Add the topics of depth and IMU, if they are used.

    Depth is the requested or the chosen topic; else it is found among the images with the frame_id
    of the image, because others are not registered to it. ``output`` is the kind of depth that the
    network returns, see :func:`depth_use`.

    Raises
    ------
    BagError
        A required topic is missing, or several fit; the message lists the topics.

    """
    use, wanted, depth, imu = depth_use(choice.config, output), options.topics, '', ''
    if use != 'unused':
        depth = (wanted.get('depth') or choice.topic
                 or _find_depth(bag, camera.image, use == 'required'))
    if options.settings.use_imu:
        imu = wanted.get('imu') or _only(bag, 'imu', _of_role(bag, 'imu'))
    return replace(camera, depth=depth, imu=imu)


def _check(bag: BagReader, role: str, name: str) -> None:
    """Check that a requested topic exists and has a suitable type."""
    types = {topic.name: topic.msg_type for topic in bag.topics}
    option = '--' + role.replace('_', '-')
    if name not in types:
        raise BagError(f'there is no topic {name}, as given by {option}. {bag.describe()}')
    if _CLASSES.get(types[name]) not in _ROLES[role]:
        expected = ' or '.join(f'sensor_msgs/msg/{c.__name__}' for c in _ROLES[role])
        raise BagError(f'{name} is of type {types[name]}, but {option} must be {expected}. '
                       f'{bag.describe()}')
    if _first(bag, name) is None:
        raise BagError(f'no message on {name} can be read. {bag.describe()}')


def _of_role(bag: BagReader, role: str) -> list[Topic]:
    """Return the topics with a suitable type that have messages."""
    return [topic for topic in bag.topics
            if topic.count and _CLASSES.get(topic.msg_type) in _ROLES[role]
            and _first(bag, topic.name) is not None]


def _find_image(bag: BagReader) -> str:
    """Return the best topic: colour, then rectified, then raw; raise if several are equal."""
    candidates = [topic for topic in _of_role(bag, 'image')
                  if not topic.name.endswith(('/compressedDepth', '/theora'))
                  and _encoding(bag, topic) not in _DEPTH_ENCODINGS]
    preferences = (lambda topic: _calibrations(bag, topic.name) != [],
                   lambda topic: _encoding(bag, topic) not in _GREY_ENCODINGS,
                   lambda topic: _RECTIFIED_WORD in topic.name,
                   lambda topic: topic.msg_type == 'sensor_msgs/msg/Image')
    for preferred in preferences:
        candidates = [topic for topic in candidates if preferred(topic)] or candidates
    return _only(bag, 'image', candidates)


def _find_camera_info(bag: BagReader, image: str) -> str:
    beside = _calibrations(bag, image)
    return beside[0] if beside else _only(bag, 'camera_info', _of_role(bag, 'camera_info'))


def _calibrations(bag: BagReader, image: str) -> list[str]:
    """Return the CameraInfo topics in the namespace of an image topic or its raw form."""
    names = [topic.name for topic in _of_role(bag, 'camera_info')]
    folders = [image.rsplit('/', depth)[0] for depth in (1, 2) if image.count('/') >= depth]
    return [f'{folder}/camera_info' for folder in folders if f'{folder}/camera_info' in names]


def _find_depth(bag: BagReader, image: str, required: bool) -> str:
    """Return the depth topic in the frame of the image; registered depth is in this frame."""
    frame_id = _first(bag, image).header.frame_id
    candidates = [topic for topic in _depth_images(bag, image)
                  if _first(bag, topic.name).header.frame_id == frame_id]
    if not candidates and not required:
        return ''
    return _only(bag, 'depth', candidates)


def _depth_images(bag: BagReader, image: str) -> list[Topic]:
    return [topic for topic in _of_role(bag, 'depth')
            if topic.name != image and _encoding(bag, topic) in _DEPTH_ENCODINGS]


def _size_of(bag: BagReader, camera: InputTopics) -> tuple[int, int]:
    """Return width and height of the image; for a compressed one, those of its calibration."""
    image = _first(bag, camera.image)
    if isinstance(image, CompressedImage):
        return image_size(_first(bag, camera.camera_info))
    return image.width, image.height


def _only(bag: BagReader, role: str, candidates: Sequence[Topic]) -> str:
    if len(candidates) == 1:
        return candidates[0].name
    option = '--' + role.replace('_', '-')
    if not candidates:
        empty = [topic.name for topic in bag.topics if topic.count
                 and _CLASSES.get(topic.msg_type) in _ROLES[role] and not _first(bag, topic.name)]
        why = f', and no message is recorded on {", ".join(empty)}' if empty else ''
        raise BagError(f'no topic for {option} was found{why}. {bag.describe()}')
    names = ', '.join(topic.name for topic in candidates)
    raise BagError(f'{names} all fit: select one by {option}. {bag.describe()}')


def _encoding(bag: BagReader, topic: Topic) -> str:
    """Return the encoding of the first image, in lower case; empty for a compressed one."""
    return getattr(_first(bag, topic.name), 'encoding', '').lower()


def _first(bag: BagReader, topic: str) -> Any:
    return bag.first(topic, input_class(bag, topic))

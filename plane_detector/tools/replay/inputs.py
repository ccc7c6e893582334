# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The inputs of a replay: the topics of a bag, those requested or the only ones that fit, its frames
in the order in which they are complete, their copies, and its transforms.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.calibration import image_size
from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer, depth_use, ns_of
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer
from plane_detector.tools.replay.bag_reader import BagError, BagReader, Recorded, Topic, to_message
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.writer import BagWriter

_CLASSES = {'sensor_msgs/msg/Image': Image, 'sensor_msgs/msg/CompressedImage': CompressedImage,
            'sensor_msgs/msg/CameraInfo': CameraInfo, 'sensor_msgs/msg/Imu': Imu}
_ROLES = {'image': (Image, CompressedImage), 'camera_info': (CameraInfo,), 'depth': (Image,),
          'imu': (Imu,)}
_DEPTH_ENCODINGS = ('16uc1', '32fc1')
_GREY_ENCODINGS = ('mono8', 'mono16')
_RECTIFIED_WORD = 'rect'
_TRANSFORM_TYPES = ('tf2_msgs/msg/TFMessage', 'tf/msg/tfMessage')
# derived: an image waits for its partners while at most 16 others do, see FrameSynchronizer.
_WAITING = 3 * 64


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
        return tuple(filter(None, astuple(self)))


def input_class(bag: BagReader, topic: str) -> Any:
    """Return the class of an input topic's messages."""
    return _CLASSES[bag.connection(topic).msgtype]


def find_camera(bag: BagReader, wanted: Mapping[str, str]) -> InputTopics:
    """
    Choose image and calibration, by default among all images, and the calibration beside it.

    The requested topics are those of ``image``, ``camera_info``, ``depth`` and ``imu``.

    Raises
    ------
    BagError
        A topic is missing, has another type, or several fit; the message lists the topics.

    """
    for role, name in wanted.items():
        _check(bag, role, name)
    image = wanted.get('image') or _find_image(bag)
    beside = _calibrations(bag, image)
    return InputTopics(image, wanted.get('camera_info') or (
        beside[0] if beside else _only(bag, 'camera_info', _of_role(bag, 'camera_info'))))


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
        what = (options.topics.get('depth', 'the depth topic') if config.depth.source == 'topic'
                else 'not measured depth')
        return DepthChoice(config, '', f'{what}, as requested')
    frame_id, size = _first(bag, camera.image).header.frame_id, _size_of(bag, camera)
    others, fitting = [], []
    for topic in _depth_images(bag, camera.image):
        depth = _first(bag, topic.name)
        what = (f'{topic.name} ({depth.width} x {depth.height}, {depth.encoding}, frame_id '
                f'{depth.header.frame_id!r})')
        fits = depth.header.frame_id == frame_id and (depth.width, depth.height) == size
        (fitting if fits else others).append((topic, what))
    if fitting:
        name = _only(bag, 'depth', [topic for topic, _ in fitting])
        return DepthChoice(replace(config, depth=replace(config.depth, source='topic')), name,
                           f'{fitting[0][1]}, registered to the image')
    why = (f'{", ".join(what for _, what in others)} is not registered to the image '
           f'({size[0]} x {size[1]}, frame_id {frame_id!r})' if others
           else 'the bag has no depth images')
    return DepthChoice(config, '', f'because {why}')


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
    use, depth, imu = depth_use(choice.config, output), '', ''
    if use != 'unused':
        frame_id = _first(bag, camera.image).header.frame_id
        registered = [topic for topic in _depth_images(bag, camera.image)
                      if _first(bag, topic.name).header.frame_id == frame_id]
        depth = options.topics.get('depth') or choice.topic or (
            _only(bag, 'depth', registered) if registered or use == 'required' else '')
    if options.settings.use_imu:
        imu = options.topics.get('imu') or _only(bag, 'imu', _of_role(bag, 'imu'))
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


def _calibrations(bag: BagReader, image: str) -> list[str]:
    """Return the CameraInfo topics in the namespace of an image topic or its raw form."""
    names = [topic.name for topic in _of_role(bag, 'camera_info')]
    folders = [image.rsplit('/', depth)[0] for depth in (1, 2) if image.count('/') >= depth]
    return [f'{folder}/camera_info' for folder in folders if f'{folder}/camera_info' in names]


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
    """Return the only candidate; raise BagError if there is none, or several."""
    if len(candidates) == 1:
        return candidates[0].name
    option = '--' + role.replace('_', '-')
    if candidates:
        names = ', '.join(topic.name for topic in candidates)
        raise BagError(f'{names} all fit: select one by {option}. {bag.describe()}')
    empty = [topic.name for topic in bag.topics if topic.count
             and _CLASSES.get(topic.msg_type) in _ROLES[role] and not _first(bag, topic.name)]
    why = f', and no message is recorded on {", ".join(empty)}' if empty else ''
    raise BagError(f'no topic for {option} was found{why}. {bag.describe()}')


def _encoding(bag: BagReader, topic: Topic) -> str:
    """Return the encoding of the first image, in lower case; empty for a compressed one."""
    return getattr(_first(bag, topic.name), 'encoding', '').lower()


def _first(bag: BagReader, topic: str) -> Any:
    return bag.first(topic, input_class(bag, topic))


def requested_times(bag: BagReader, image: str, options: ReplayOptions) -> tuple[int, int]:
    """Return start and end of the replay; raise BagError if there is no image between them."""
    length_ns = bag.end_ns - bag.start_ns
    start_ns = bag.start_ns + round(min(options.start_s * 1e9, length_ns))
    stop_ns = start_ns + round(min(options.duration_s * 1e9, bag.end_ns - start_ns))
    if start_ns == stop_ns or not any(bag.read([image], start_ns, stop_ns)):
        raise BagError(
            f'{options.source} spans 0 to {length_ns * 1e-9:.3f} s, and in the requested part, '
            f'--start {options.start_s:g} --duration {options.duration_s:g}, there is '
            f'no image on {image}')
    return start_ns, stop_ns


class CopiedMessages:
    """
    Copies messages of some topics into the new bag.

    If only one frame of ``every`` is processed, only its image, calibration and depth are copied,
    but all messages of other topics.
    """

    def __init__(self, writer: BagWriter, topics: Sequence[str], inputs: InputTopics, every: int):
        self.topics = frozenset(topics)
        self._writer, self._of_frame = writer, (inputs.image, inputs.depth, inputs.camera_info)
        self._chosen = self.topics & set(self._of_frame) if every > 1 else frozenset()
        self._waiting: OrderedDict[tuple[str, int], Recorded] = OrderedDict()

    def add(self, recorded: Recorded, msg: Any) -> None:
        """Copy a message, or keep it until its frame is taken; ``msg`` is None if damaged."""
        if recorded.topic in self._chosen:
            if msg is not None:
                self._waiting[recorded.topic, ns_of(msg)] = recorded
            if len(self._waiting) > _WAITING:
                self._waiting.popitem(last=False)
        elif recorded.topic in self.topics:
            self._writer.copy(recorded)

    def take(self, frame: Frame) -> None:
        """Copy the messages of a frame that were not copied with an earlier one."""
        for topic, msg in zip(self._of_frame, (frame.image, frame.depth, frame.camera_info),
                              strict=True):
            if msg is not None and (topic, ns_of(msg)) in self._waiting:
                self._writer.copy(self._waiting.pop((topic, ns_of(msg))))


def read_frames(bag: BagReader, topics: InputTopics, times_ns: tuple[int, int],
                synchronizer: FrameSynchronizer, copies: CopiedMessages
                ) -> Iterator[tuple[int, Frame]]:
    """
    Yield the frames recorded from one time up to another, each with the time of its last message.

    Messages that cannot be decoded are skipped and counted in ``bag.damaged``.
    """
    time_ns, names = times_ns[0], frozenset(topics.names)
    add = {topics.image: synchronizer.add_image, topics.camera_info: synchronizer.add_camera_info,
           topics.depth: synchronizer.add_depth, topics.imu: synchronizer.add_imu}
    # Calibrations that are recorded once may come late, or before the start.
    synchronizer.add_camera_info(_first(bag, topics.camera_info))
    for recorded in bag.read(names | copies.topics, *times_ns):
        time_ns, msg = recorded.time_ns, None
        if recorded.topic in names:
            try:
                msg = to_message(recorded, input_class(bag, recorded.topic))
            except BagError:
                bag.damaged += 1
        copies.add(recorded, msg)
        if msg is not None:
            yield from ((time_ns, frame) for frame in add[recorded.topic](msg) or ())
    yield from ((time_ns, frame) for frame in synchronizer.finish())


def read_transforms(bag: BagReader, settings: NodeConfig) -> FrameTransforms | None:
    """
    Return all transforms of a bag; None if the settings name no frame.

    All are read before the first image, because they may be recorded after the image they precede.
    Damaged messages and invalid transforms are skipped and counted in ``bag.damaged``. BagError is
    raised if there are none.
    """
    if not (settings.base_frame or settings.target_frame):
        return None
    topics = [topic.name for topic in bag.topics
              if topic.msg_type in _TRANSFORM_TYPES and topic.count]
    if not topics:
        raise BagError('base_frame and target_frame need transforms, tf2_msgs/msg/TFMessage on '
                       f'/tf and /tf_static. {bag.describe()}')
    buffer = TransformBuffer()
    for recorded in bag.read(topics):
        is_static = recorded.topic.rpartition('/')[2] == 'tf_static'
        try:
            transforms = bag.plain(recorded).transforms
        except Exception:  # damaged bytes may cause any exception in a parser
            bag.damaged += 1
            continue
        for transform in transforms:
            try:
                buffer.add(transform, is_static)
            except ValueError:  # recorders keep them, tf2 ignores them
                bag.damaged += 1
    return FrameTransforms(buffer)

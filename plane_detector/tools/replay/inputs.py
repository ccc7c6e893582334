# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The inputs of a replay: the topics of a bag (requested, or the only ones that fit), its frames in
the order in which they are complete, their copies, and its transforms.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, NamedTuple

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2

from plane_detector._runtime.stopping import raise_if_stopped
from plane_detector.config import Config, NodeConfig
from plane_detector.geometry.gravity import is_identity
from plane_detector.ros.calibration import image_size
from plane_detector.ros.inputs.depth_decoding import (
    COMPRESSED_DEPTH,
    depth_size,
    is_compressed_depth,
)
from plane_detector.ros.inputs.image_decoding import DEPTH_ENCODINGS
from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer, ns_of
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer
from plane_detector.tools.replay.bag_reader import BagError, BagReader, Recorded, Topic, to_message
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.writer import BagWriter

_CLASSES = {f'sensor_msgs/msg/{kind.__name__}': kind
            for kind in (Image, CompressedImage, CameraInfo, Imu, PointCloud2)}
_ROLES = {'image': (Image, CompressedImage), 'camera_info': (CameraInfo,),
          'depth': (Image, CompressedImage, PointCloud2), 'imu': (Imu,)}
_GREY_ENCODINGS = ('mono8', 'mono16', '8uc1')
_RECTIFIED_WORD = 'rect'
_TRANSFORM_TYPES = ('tf2_msgs/msg/TFMessage', 'tf/msg/tfMessage')
# derived: an image waits for its partners while at most 16 others wait, see FrameSynchronizer.
_WAITING = 3 * 64


@dataclass(frozen=True)
class InputTopics:
    """Names of the input topics; empty if not used. Without colour, depth is the image."""

    image: str
    camera_info: str
    depth: str = ''
    imu: str = ''

    @property
    def names(self) -> tuple[str, ...]:
        """All topics that are used."""
        return tuple(filter(None, astuple(self)))


@dataclass(frozen=True)
class Inputs:
    """The topics of a replay, its settings with the source of depth, and why this source."""

    topics: InputTopics
    config: Config
    why: str

    def describe(self, facts: Mapping[str, str]) -> str:
        """Return a line with the source of depth, from the facts of a detector, and the reason."""
        if self.config.depth.is_measured:
            return f'measured: {self.why}'
        reason = facts.get('depth_model_reason', '')
        return f'network {facts["depth_model"]}{f" ({reason})" if reason else ""}, {self.why}'


def input_class(bag: BagReader, topic: str) -> Any:
    """Return the class of an input topic's messages."""
    return _CLASSES[bag.connection(topic).msgtype]


def choose_inputs(bag: BagReader, options: ReplayOptions) -> Inputs:
    """
    Choose the topics of a bag, the source of depth, and its settings.

    1. The image is the one requested, or else the best colour image. Where there is none, or with
       ``depth.colour: none``, each depth image is a frame.
    2. The calibration is the one requested, or the one next to the image, or the only one.
    3. Measured depth is used if it is requested, or if it has the frame_id and size of the image,
       so that it needs no transform, and no other source is requested.
    4. The depth topic is the one requested, or the only one with the frame_id of the image.
    5. The IMU is the one requested, or the only one, with ``use_imu``.

    Raises
    ------
    BagError
        A topic is missing, has another type, or several fit; the message lists the topics.

    """
    for role, name in options.topics.items():
        _check(bag, role, name)
    config, requested = options.config, options.topics
    imu = '' if not options.settings.use_imu else (
        requested.get('imu') or _only(bag, 'imu', _of_role(bag, 'imu')))
    images, depths = _colour_images(bag), _depth_topics(bag, config.depth.source)
    without_colour = options.depth_by_bag and depths and not images and 'image' not in requested
    if config.depth.colour == 'none' or without_colour:
        depth = requested.get('depth') or _only(bag, 'depth', depths)
        topics = InputTopics(depth, _calibration(bag, depth, requested), '', imu)
        return Inputs(topics, _measured(bag, config, depth, 'none'),
                      f'{_described(bag, depth)}, without a colour image')
    image = requested.get('image') or _best_image(bag, images)
    topics = InputTopics(image, _calibration(bag, image, requested), '', imu)
    depths = [topic for topic in depths if topic.name != image]
    why = 'as requested'
    if options.depth_by_bag:
        depth, why = _registered(bag, topics, depths)
        if depth:
            return Inputs(replace(topics, depth=depth), _measured(bag, config, depth, 'image'),
                          why)
    elif config.depth.is_measured:
        why = f'{requested.get("depth", "the depth topic")}, as requested'
    else:
        why = 'not measured depth, as requested'
    frame_id = _first(bag, image).header.frame_id
    same_frame = [topic for topic in depths if _first(bag, topic.name).header.frame_id == frame_id]
    depth = requested.get('depth', '')
    is_needed = config.depth.is_measured or config.scale.method == 'depth_topic'
    if not depth and (is_needed or len(same_frame) == 1):  # it may fix the scale of a network
        depth = _only(bag, 'depth', same_frame)
    if depth and config.depth.is_measured:
        config = _measured(bag, config, depth, 'image')
    return Inputs(replace(topics, depth=depth), config, why)


def _registered(bag: BagReader, camera: InputTopics, depths: Sequence[Topic]) -> tuple[str, str]:
    """Return the depth topic that is registered to the image, or '', and the reason."""
    frame_id, size = _first(bag, camera.image).header.frame_id, _size_of(bag, camera)
    fitting = [topic for topic in depths
               if _first(bag, topic.name).header.frame_id == frame_id
               and depth_size(_first(bag, topic.name)) == size]
    if fitting:
        name = _only(bag, 'depth', fitting)
        return name, f'{_described(bag, name)}, registered to the image'
    if not depths:
        return '', 'because the bag has no depth images'
    named = ', '.join(_described(bag, topic.name) for topic in depths)
    return '', (f'because {named} is not registered to the image ({size[0]} x {size[1]}, frame_id '
                f'{frame_id!r})')


def _described(bag: BagReader, depth: str) -> str:
    """Return a depth topic with the properties that show whether it is registered."""
    msg = _first(bag, depth)
    width, height = depth_size(msg)
    kind = getattr(msg, 'encoding', getattr(msg, 'format', 'points'))
    return f'{depth} ({width} x {height}, {kind}, frame_id {msg.header.frame_id!r})'


def _measured(bag: BagReader, config: Config, depth: str, colour: str) -> Config:
    """Return the settings with this topic as source of depth."""
    kind = input_class(bag, depth)
    return replace(config, depth=replace(
        config.depth, source='points' if kind is PointCloud2 else 'topic', colour=colour,
        transport='compressedDepth' if kind is CompressedImage else 'raw'))


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


def _colour_images(bag: BagReader) -> list[Topic]:
    return [topic for topic in _of_role(bag, 'image')
            if not topic.name.endswith('/theora') and not _is_depth(_first(bag, topic.name))]


def _depth_topics(bag: BagReader, source: str) -> list[Topic]:
    """Return the topics of depth images, each in one transport only, or of organised clouds."""
    if source == 'points':
        return [topic for topic in _of_role(bag, 'depth')
                if getattr(_first(bag, topic.name), 'height', 1) > 1
                and input_class(bag, topic.name) is PointCloud2]
    found = [topic for topic in _of_role(bag, 'image') if _is_depth(_first(bag, topic.name))]
    raw = {topic.name for topic in found}
    return [topic for topic in found
            if not topic.name.endswith(COMPRESSED_DEPTH)
            or topic.name.removesuffix(COMPRESSED_DEPTH) not in raw]


def _is_depth(msg: Image | CompressedImage) -> bool:
    if isinstance(msg, CompressedImage):
        return is_compressed_depth(msg)
    return msg.encoding.lower() in DEPTH_ENCODINGS


def _best_image(bag: BagReader, candidates: Sequence[Topic]) -> str:
    """Return the best topic: colour, then rectified, then raw; raise if several are equal."""
    preferences = (lambda topic: _beside(bag, topic.name) != [],
                   lambda topic: getattr(_first(bag, topic.name), 'encoding', '').lower()
                   not in _GREY_ENCODINGS,
                   lambda topic: _RECTIFIED_WORD in topic.name,
                   lambda topic: topic.msg_type == 'sensor_msgs/msg/Image')
    for preferred in preferences:
        candidates = [topic for topic in candidates if preferred(topic)] or candidates
    return _only(bag, 'image', candidates)


def _calibration(bag: BagReader, image: str, requested: Mapping[str, str]) -> str:
    """Return the CameraInfo topic that is requested, next to the image, or the only one."""
    beside = _beside(bag, image)
    return requested.get('camera_info') or (
        beside[0] if beside else _only(bag, 'camera_info', _of_role(bag, 'camera_info')))


def _beside(bag: BagReader, image: str) -> list[str]:
    """Return the CameraInfo topics in the namespace of an image topic or its raw form."""
    names = [topic.name for topic in _of_role(bag, 'camera_info')]
    folders = [image.rsplit('/', depth)[0] for depth in (1, 2) if image.count('/') >= depth]
    return [f'{folder}/camera_info' for folder in folders if f'{folder}/camera_info' in names]


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


def _first(bag: BagReader, topic: str) -> Any:
    return bag.first(topic, input_class(bag, topic))


def imu_to_camera(bag: BagReader, inputs: Inputs, transforms: FrameTransforms | None
                  ) -> tuple[float, ...]:
    """Return the mounting of the IMU: from the settings, or from TF if they are the identity."""
    set_by_user, topics = inputs.config.scale.imu_to_camera, inputs.topics
    if not topics.imu or not is_identity(set_by_user) or transforms is None:
        return set_by_user
    imu, camera = _first(bag, topics.imu).header, _first(bag, topics.image).header
    if imu.frame_id in ('', camera.frame_id):
        return set_by_user
    return transforms.rotation(imu.frame_id, camera) or set_by_user


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
        self.topics, self.every = frozenset(topics), every
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


class ReadFrame(NamedTuple):
    """A frame of a bag."""

    index: int  # among all frames
    time_ns: int  # when its last message was recorded
    frame: Frame
    dropped: int  # images without a partner since the previous frame


def read_frames(bag: BagReader, topics: InputTopics, times_ns: tuple[int, int],
                synchronizer: FrameSynchronizer, copies: CopiedMessages) -> Iterator[ReadFrame]:
    """Yield one frame of ``copies.every``, with its messages copied; Stopped ends it."""
    found = _all_frames(bag, topics, times_ns, synchronizer, copies)
    for index, (time_ns, frame) in enumerate(found):
        raise_if_stopped()
        if index % copies.every == 0:
            copies.take(frame)
            yield ReadFrame(index, time_ns, frame, synchronizer.take_dropped())


def _all_frames(bag: BagReader, topics: InputTopics, times_ns: tuple[int, int],
                synchronizer: FrameSynchronizer, copies: CopiedMessages
                ) -> Iterator[tuple[int, Frame]]:
    """Yield frames and times; messages that cannot be decoded are counted in ``bag.damaged``."""
    time_ns, names = times_ns[0], frozenset(topics.names)
    add = {topics.image: synchronizer.add_image, topics.camera_info: synchronizer.add_camera_info,
           topics.depth: synchronizer.add_depth, topics.imu: synchronizer.add_imu}
    # Calibrations that are recorded once may appear late, or before the start.
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


def transform_topics(bag: BagReader) -> list[str]:
    """Return the topics of transforms that have messages."""
    return [topic.name for topic in bag.topics
            if topic.msg_type in _TRANSFORM_TYPES and topic.count]


def read_transforms(bag: BagReader, settings: NodeConfig, topics: InputTopics
                    ) -> FrameTransforms | None:
    """
    Return all transforms of a bag that the settings need; None if they need none.

    All are read before the first image, because a transform may be recorded after the image that
    it precedes. They are read twice, because a robot may have thirty joints, and only the path
    from the camera to the robot is kept. Damaged messages and invalid transforms are skipped and
    counted in ``bag.damaged``. BagError is raised if there are none but the settings name a frame;
    an IMU works without.
    """
    is_required = settings.base_frame or settings.target_frame
    if not (is_required or settings.use_imu):
        return None
    names = transform_topics(bag)
    if not names and not is_required:
        return None
    if not names:
        raise BagError('base_frame and target_frame need transforms, tf2_msgs/msg/TFMessage on '
                       f'/tf and /tf_static. {bag.describe()}')
    parents, damaged = defaultdict(set), bag.damaged
    for transform, _ in _transforms(bag, names):
        parents[transform.child_frame_id].add(transform.header.frame_id)
    bag.damaged = damaged  # the second pass counts them again
    above = [settings.base_frame, settings.target_frame, *(
        _first(bag, name).header.frame_id for name in (topics.image, topics.imu) if name)]
    needed: set[str] = set()
    while above:
        if (frame := above.pop()) not in needed:
            needed.add(frame)
            above += parents[frame]
    buffer = TransformBuffer()
    for transform, is_static in _transforms(bag, names):
        try:
            if transform.child_frame_id in needed:
                buffer.add(transform, is_static)
        except ValueError:  # recorders keep them, tf2 ignores them
            bag.damaged += 1
    return FrameTransforms(buffer)


def _transforms(bag: BagReader, topics: Sequence[str]) -> Iterator[tuple[Any, bool]]:
    """Yield each transform, and whether it is static; count damaged messages."""
    for recorded in bag.read(topics):
        try:
            transforms = bag.plain(recorded).transforms
        except Exception:  # damaged bytes may cause any exception in a parser
            bag.damaged += 1
            continue
        for transform in transforms:
            yield transform, recorded.topic.rpartition('/')[2] == 'tf_static'

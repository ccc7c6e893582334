# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What an image costs: time as a ratio to a fixed piece of work, memory, loops, and code to read.

Both are timed alternately, by thread time, in one process: a slower or busier machine slows both.
Other effects of a busy machine, mainly on its caches, are in the spread.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

import plane_detector
from plane_detector import PlaneDetector, segment_planes
from plane_detector._runtime import compilation
from plane_detector.config import NodeConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.benchmark.relative import NOISE_SHARE, with_network_errors
from plane_detector.evaluation.benchmark.samples import noisy_depth, room
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.evaluation.scores.measured import seeded
from plane_detector.evaluation.scores.table import LOWER, Draw, Measurement, Values

TURNS = 15
# chosen: four times what ratios of one version differed by on two cores that ran sixteen
# processes, and less than half of what must be seen, twice the time.
BUSY_SHARE = 0.4
GROWTH_SHARE = 0.05
"""What a feature may add to read or to compile without a stated reason."""
PACKAGE = Path(plane_detector.__file__).parent
STAGES = ('depth', 'directions', 'segmentation', 'scale', 'measurement', 'ground', 'tracking',
          'patches')
# Stages that take less than this share of an image are not evaluated individually.
MEASURED_STAGES = ('segmentation', 'measurement', 'ground', 'tracking')
NETWORK_STAGES = ('directions', 'segmentation', 'measurement', 'ground', 'patches')


class ThreadTimer:
    """The stages of an image in the time of their thread; used as a StageTimer."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time the block."""
        start_s = time.thread_time()
        yield
        self.seconds[name] = time.thread_time() - start_s


def fixed_work() -> Callable[[], None]:
    """Return the workload with which all others are compared, some 10 ms."""
    rng = np.random.default_rng(0)
    image, order = rng.random((480, 640), np.float32), rng.random(40_000)
    bytes_ = (255 * image).astype(np.uint8)
    v, u = np.indices(image.shape, np.float32)

    def work() -> None:
        cv2.GaussianBlur(image, (0, 0), 3.0)
        cv2.remap(image, u + 0.5, v + 0.5, cv2.INTER_LINEAR)
        cv2.distanceTransform(bytes_ & 254, cv2.DIST_L2, 5)
        cv2.connectedComponents((image > 0.6).astype(np.uint8))
        cv2.Canny(bytes_, 50, 150)
        np.sort(order)
    return work


def ratios(parts: Callable[[int], dict[str, float]], draw: Draw) -> dict[str, float]:
    """Return the seconds of parts over those of fixed work: medians of turns, means of scenes."""
    work, turns = fixed_work(), defaultdict(list)
    for turn in range(TURNS + 2):
        for seed in _scenes(draw):
            unit_s = timed(work)
            for name, seconds in parts(seed).items():
                if turn >= 2:  # loops are loaded, memory is there
                    turns[name, seed].append(seconds / unit_s)
    medians: dict[str, list[float]] = defaultdict(list)
    for (name, _), values in turns.items():
        medians[name].append(float(np.median(values)))
    return {name: float(np.mean(values)) for name, values in medians.items()}


def _scenes(draw: Draw) -> range:
    return range(draw.seed, draw.seed + 3)


def timed(function: Callable[[], object]) -> float:
    """Return the thread time of a call in seconds."""
    start_s = time.thread_time()
    function()
    return time.thread_time() - start_s


def _stages(detector: PlaneDetector, scene, depth_m: np.ndarray | None,
            gravity: np.ndarray | None) -> dict[str, float]:
    timer = ThreadTimer()
    start_s = time.thread_time()
    seen = detector.estimate_depth(scene.rgb, scene.intrinsics, depth_m, timer=timer)
    detector.find_planes(seen, detector.find_directions(seen, gravity))
    return {**timer.seconds, 'detect': time.thread_time() - start_s}


def of_measured(draw: Draw) -> Values:
    """Return the ratios of measured depth: segmentation alone, all, and the stages."""
    detector = PlaneDetector(seeded(0))

    def once(seed: int) -> dict[str, float]:
        scene = room(seed)
        depth_m = noisy_depth(scene, 0.002, seed)
        return {'segment_planes': timed(lambda: segment_planes(depth_m, scene.intrinsics)),
                **_stages(detector, scene, depth_m, scene.gravity_camera)}
    found = ratios(once, draw)
    return {f'cost, measured: {name}': found[name] for name in ('segment_planes', 'detect')} | {
        f'cost, measured: stage {name}': found[name] for name in MEASURED_STAGES}


def _network(scene, seed: int) -> DepthFunction:
    rng = np.random.default_rng([seed, 6])
    depth_m = (1 / with_network_errors(1 / scene.depth_m, 0.03, rng)).astype(np.float32)
    return DepthFunction(lambda rgb: depth_m, noise_share=NOISE_SHARE, blur_px=4)


def of_network(draw: Draw) -> Values:
    """Return the ratios of a network's depth without its inference."""
    scenes = {seed: textured(rooms.random_room, seed) for seed in _scenes(draw)}
    detectors = {seed: PlaneDetector(seeded(0, 'model'), _network(scene, seed))
                 for seed, scene in scenes.items()}

    def once(seed: int) -> dict[str, float]:
        detectors[seed].reset()  # each image is new, as on a moving camera
        return _stages(detectors[seed], scenes[seed], None, None)
    found = ratios(once, draw)
    return {'cost, network: detect': found['detect'],
            **{f'cost, network: stage {name}': found[name] for name in NETWORK_STAGES}}


def of_messages(draw: Draw) -> Values:
    """Return the ratio of making all messages of an image."""
    from std_msgs.msg import Header

    from plane_detector.ros.frame_processor import make_messages
    from plane_detector.ros.outputs.frame import DetectedFrame
    from plane_detector.ros.outputs.topics import OUTPUTS
    detections = {seed: PlaneDetector(seeded(0)).detect(
        room(seed).rgb, room(seed).intrinsics, noisy_depth(room(seed), 0.002, seed),
        room(seed).gravity_camera) for seed in _scenes(draw)}

    def once(seed: int) -> dict[str, float]:
        scene = room(seed)
        frame = DetectedFrame(detections[seed], scene.intrinsics, None, 0.0, header=Header(),
                              rgb=scene.rgb, settings=NodeConfig())
        return {'messages': timed(lambda: make_messages(frame, tuple(OUTPUTS)))}
    return {'cost: all messages': ratios(once, draw)['messages']}


# VmHWM: what getrusage says also counts the process that has started this one.
_PEAK = """
from plane_detector._runtime.process import use_one_thread
from plane_detector.evaluation.scores.cost import peak_scene
use_one_thread()
detector, scene, depth_m = peak_scene()
for _ in range(3):
    detector.detect(scene.rgb, scene.intrinsics, depth_m, scene.gravity_camera)
line, = [line for line in open('/proc/self/status') if line.startswith('VmHWM')]
print(float(line.split()[1]) / 1024)
"""


def peak_scene() -> tuple[PlaneDetector, object, np.ndarray]:
    """Return the input for measuring the peak of memory."""
    scene = room(9000)
    return PlaneDetector(seeded(0)), scene, noisy_depth(scene, 0.002, 9000)


def memory(draw: Draw) -> Values:
    """Return the peak of memory of a process that has found planes in three images."""
    run = subprocess.run([sys.executable, '-c', _PEAK], capture_output=True, text=True, check=True,
                         cwd=PACKAGE.parent)
    return {'peak memory (MB)': float(run.stdout)}


def loops(draw: Draw) -> Values:
    """Return the number of compiled loops."""
    import plane_detector.pipeline
    import plane_detector.ros.outputs.topics  # noqa: F401 - these bring the loops
    return {'compiled loops': float(len(compilation._KERNELS))}


def compile_time(draw: Draw) -> Values:
    """Return the seconds of all cores that it takes to compile them, over those of fixed work."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, '-c', (
            'import plane_detector.pipeline, plane_detector.mapping.plane_map\n'
            'from plane_detector._runtime.compilation import _KERNELS, compile_kernels\n'
            'compile_kernels({one.subject for one in _KERNELS})')], check=True,
            cwd=PACKAGE.parent, capture_output=True, env={
                **os.environ, 'XDG_CACHE_HOME': folder, 'NUMBA_CACHE_DIR': folder})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {'CPU to compile the loops (s)':
            after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime}


class Reading:
    """The functions of the package that run in a block, and the loops that they call."""

    def __init__(self) -> None:
        self.codes: set = set()

    def __enter__(self) -> Reading:
        sys.setprofile(self._called)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _called(self, frame, event: str, _: object) -> None:
        if event == 'call':
            self.codes.add(frame.f_code)
            kernel = frame.f_locals.get('self')
            if isinstance(kernel, compilation.Kernel):
                self._loop(kernel)

    def _loop(self, kernel: compilation.Kernel) -> None:
        function = kernel._function
        if function.__code__ not in self.codes:
            self.codes.add(function.__code__)
            for name in function.__code__.co_names:
                if isinstance(called := function.__globals__.get(name), compilation.Kernel):
                    self._loop(called)

    @property
    def numbers(self) -> tuple[int, int]:
        """Number of files of the package, and of functions in them."""
        # By their places: a loop that Python calls may show a code object of numba too.
        own = {(code.co_filename, code.co_firstlineno) for code in self.codes
               if code.co_filename.startswith(str(PACKAGE))
               and not code.co_filename.startswith(str(PACKAGE / 'evaluation'))
               and not code.co_name.startswith('<')}
        return len({file for file, _ in own}), len(own)


def reading(draw: Draw) -> Values:
    """Return how many files and functions one image passes through."""
    scene = textured(rooms.random_room, draw.seed)
    depth_m = noisy_depth(scene, 0.002, draw.seed)
    values = {}
    for title, make, depth, down in (
            ('one measured image', lambda: PlaneDetector(seeded(0)), depth_m,
             scene.gravity_camera),
            ('one image by a network', lambda: PlaneDetector(seeded(0, 'model'), _network(
                scene, draw.seed)), None, None)):
        make().detect(scene.rgb, scene.intrinsics, depth, down)  # loads what is loaded once
        detector = make()
        with Reading() as read:
            detector.detect(scene.rgb, scene.intrinsics, depth, down)
        values |= _read(title, read)
    return values


def replayed(draw: Draw) -> Values:
    """Return the same of an image that is replayed: its messages, planes, all messages made."""
    from sensor_msgs.msg import CameraInfo, Image

    from plane_detector.ros.frame_processor import FrameProcessor
    from plane_detector.ros.inputs.synchronizer import Frame
    scene = room(draw.seed)
    depth_m, camera = noisy_depth(scene, 0.002, draw.seed), scene.intrinsics
    size = {'height': camera.height, 'width': camera.width}
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    info = CameraInfo(**size, k=k, p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
                      distortion_model='plumb_bob', d=[0.0] * 5,
                      r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    frame = Frame(Image(**size, encoding='rgb8', step=3 * camera.width, data=scene.rgb.tobytes()),
                  info, Image(**size, encoding='32FC1', step=4 * camera.width,
                              data=np.ascontiguousarray(depth_m).tobytes()),
                  scene.gravity_camera, 0)
    for _ in range(2):  # the second time nothing is loaded
        processor = FrameProcessor(PlaneDetector(seeded(0)), NodeConfig(), '/camera/image_rect')
        with Reading() as read:
            processor.process(frame)
    return _read(_REPLAYED, read)


def _read(title: str, read: Reading) -> dict[str, float]:
    files, functions = read.numbers
    return {f'{title}: files': files, f'{title}: functions': functions}


_READ, _REPLAYED = ('one measured image', 'one image by a network'), 'one replayed image'


def _reading(function: Callable[[Draw], Values], titles: tuple[str, ...]) -> Measurement:
    return Measurement('reading', function, {f'{title}: {what}': LOWER for title in titles
                                             for what in ('files', 'functions')},
                       least_share=GROWTH_SHARE)


MEASUREMENTS = (
    Measurement('cost', of_measured, dict.fromkeys((
        'cost, measured: segment_planes', 'cost, measured: detect',
        *(f'cost, measured: stage {stage}' for stage in MEASURED_STAGES)), LOWER),
        least_share=BUSY_SHARE),
    Measurement('cost', of_network, dict.fromkeys((
        'cost, network: detect', *(f'cost, network: stage {stage}' for stage in NETWORK_STAGES)),
        LOWER),
        least_share=BUSY_SHARE),
    Measurement('cost', of_messages, {'cost: all messages': LOWER}, least_share=BUSY_SHARE),
    Measurement('cost', memory, {'peak memory (MB)': LOWER}, least_share=0.1),
    Measurement('cost', loops, {'compiled loops': LOWER}, least_share=GROWTH_SHARE),
    Measurement('compile', compile_time, {'CPU to compile the loops (s)': LOWER},
                least_share=BUSY_SHARE),
    _reading(reading, _READ), _reading(replayed, (_REPLAYED,)))

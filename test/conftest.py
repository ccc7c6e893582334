# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What several files of tests share: scenes, rendered once, real images, a robot, a bag.

What needs ROS is imported where it is used: the core is tested without.
"""

import os
import signal
from contextlib import nullcontext
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from plane_detector._runtime.compilation import _KERNELS, compile_kernels
from plane_detector.evaluation.scenes.rooms import box, camera_rotation, random_room, render

pytest.register_assert_rewrite('node_helpers', 'replay_helpers')
REPOSITORY = Path(__file__).resolve().parents[1]
# A shell lets what it starts in the background ignore SIGINT, and so would the tests' processes.
signal.signal(signal.SIGINT, signal.default_int_handler)


# These read sources and documents, for which no loop need be compiled.
READERS = {'test_architecture.py', 'test_compilation.py', 'test_defaults.py',
           'test_dependencies.py', 'test_docs.py', 'test_shipping.py'}


@pytest.fixture(scope='session', autouse=True)
def compiled(request):
    """Compile all kernels once, into a cache shared by the processes of the tests."""
    if {item.path.name for item in request.session.items} <= READERS:
        return
    import plane_detector.mapping.plane_map
    import plane_detector.pipeline
    if find_spec('rclpy'):
        import plane_detector.ros.outputs.topics  # noqa: F401
    compile_kernels({one.subject for one in _KERNELS})


@lru_cache(maxsize=16)
def cached_room(seed):
    return random_room(np.random.default_rng(seed))


@pytest.fixture
def room():
    """Return a function: seed -> random room at 640 x 480."""
    return cached_room


@pytest.fixture
def data_folder():
    """Return the folder of real images; the test is skipped where there is none."""
    folder = Path(os.environ.get('PLANE_DETECTOR_DATA', REPOSITORY.parent / 'shared' / 'data'))
    if not folder.is_dir():
        pytest.skip(f'no real images in {folder}; PLANE_DETECTOR_DATA may name their folder')
    return folder


@pytest.fixture
def server(monkeypatch):
    """Return a server on this machine that offers a network, whole or not."""
    from zoo_helpers import serving
    monkeypatch.setenv('no_proxy', '*')
    with serving() as server:
        yield server


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Return a camera and subscribers on a ROS domain of their own; diagnostics come often."""
    from ros_helpers import Robot
    monkeypatch.setattr('plane_detector.ros.diagnostics._PERIOD_S', 0.25)
    robot = Robot(log_file=tmp_path / 'log')
    yield robot
    robot.shutdown()


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_call(item):
    """Let the robot read the log; not in its fixture, as pytest takes it over before each call."""
    robot = item.funcargs.get('robot')
    with robot.log_in_file() if robot and robot.log_file else nullcontext():
        return (yield)


@pytest.fixture(scope='session')
def scenes():
    """Four steps through a room with a box in it."""
    from replay_helpers import CAMERA
    size = np.array([4.0, 5.0, 2.5])
    rectangles = box(size / 2, size)
    rectangles += box(np.array([2.8, 3.5, 0.5]), np.array([1.0, 0.8, 1.0]), 20)
    return [render(rectangles, camera_rotation(5 * step, -15, 0),
                   np.array([2.0, 0.5 + 0.05 * step, 1.4]), CAMERA, np.random.default_rng(0))
            for step in range(4)]


@pytest.fixture
def bag(tmp_path, scenes):
    """Return the walk through that room as a bag."""
    from bags import write_bag
    from replay_helpers import camera_messages
    return write_bag(tmp_path / 'walk', camera_messages(scenes))


@pytest.fixture
def replay(tmp_path, capsys):
    """Return a function: run the program; return exit code, new bag, what it printed."""
    from replay_helpers import DEPTH

    from plane_detector.tools.replay.__main__ import main

    def run(source, *options, depth=DEPTH):
        target = tmp_path / 'planes'
        depth_option = ['--depth', depth] if depth else []
        code = main([str(source), str(target), *depth_option, *map(str, options)])
        printed = capsys.readouterr()
        return code, target, printed.out + printed.err
    return run

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Signals at random moments: the process ends within 3 s, whatever runs."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
from common import MOST_ENDING_S, FedNode, Row, fed_node, network_arguments, room_network, rooms
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from slow_networks import HEIGHT, WIDTH, write_slow_network

from plane_detector.types import CameraIntrinsics

MOMENTS = 50
SIGNALS = (signal.SIGINT, signal.SIGTERM)
SLOW_CAMERA = CameraIntrinsics(60.0, 60.0, 31.5, 23.5, WIDTH, HEIGHT)
BRIGHT = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
QUICK = ['-p', 'depth.source:=topic']


def endings(folder: Path) -> list[Row]:
    """Return a row for each kind of moment."""
    rng = np.random.default_rng(0)
    kinds = {'start': _start, 'warm-up': _warm_up, 'frame': _frame, 'shutdown': _shutdown}
    rows = []
    for kind, (name, begin) in enumerate(kinds.items()):
        count = len(range(kind, MOMENTS, len(kinds)))
        ends = [_one(folder, begin, rng, SIGNALS[k % 2]) for k in range(count)]
        codes, logs = {code for _, code, _ in ends}, [log for *_, log in ends]
        wrong = {code for code in codes if code not in _right_codes(name)}
        slowest_s = max(seconds for seconds, *_ in ends)
        rows.append(Row(
            f'signal at {count} random moments of {name}', 'ends within 3 s, no traceback',
            f'slowest {slowest_s:.2f} s, exit codes {", ".join(map(str, sorted(codes)))}',
            slowest_s <= MOST_ENDING_S and not wrong
            and not any('Traceback' in log for log in logs)))
    return [*rows, *deactivating(folder)]


def _right_codes(name: str) -> tuple[int | None, ...]:
    """Return them: the imports are ended by the signal itself, a shutdown by a second signal."""
    killed = tuple(-number for number in SIGNALS)
    forced = tuple(128 + number for number in SIGNALS)
    return {'start': (0, *killed), 'shutdown': (0, *forced)}.get(name, (0,))


def _one(folder: Path, begin, rng: np.random.Generator,
         number: int) -> tuple[float, int | None, str]:
    """Bring a node to a moment and end it; return the time, the exit code and the log."""
    with begin(folder, rng, number) as node:
        seconds, code = node.seconds_to_end(number)
        return seconds, code, node.node.log()


def _start(folder: Path, rng: np.random.Generator, _number: int) -> _Begun:
    pause_s = rng.uniform(0, 6)
    return _begun(folder, QUICK, '', lambda node: time.sleep(pause_s))


def _begun(folder: Path, arguments: list[str], state: str, feed=lambda node: None) -> _Begun:
    return _Begun(folder, arguments, state, feed)


class _Begun:
    """A node in a state; the context of `fed_node` with what is done before."""

    def __init__(self, folder: Path, arguments: list[str], state: str, feed):
        self._context, self._state, self._feed = fed_node(folder, arguments), state, feed

    def __enter__(self) -> FedNode:
        node = self._context.__enter__()
        assert not self._state or node.wait_for_state(self._state), node.node.log()
        self._feed(node)
        return node

    def __exit__(self, *error: object) -> None:
        self._context.__exit__(*error)


def _warm_up(folder: Path, rng: np.random.Generator, _number: int) -> _Begun:
    network = write_slow_network(folder / 'slow.onnx', deaf=bool(rng.integers(2)), always=True)
    pause_s = rng.uniform(0, 1)
    return _begun(folder, network_arguments(network), 'configuring',
                  lambda node: time.sleep(pause_s))


def _frame(folder: Path, rng: np.random.Generator, _number: int) -> _Begun:
    """Quick frames, an endless one, or one that hears nothing."""
    kind, pause_s = rng.integers(3), rng.uniform(0, 0.5)
    if kind == 0:
        arguments, image, camera = room_network(folder), rooms(1)[0], None
    else:
        network = write_slow_network(folder / 'slow.onnx', deaf=bool(kind == 2))
        arguments, image, camera = network_arguments(network), BRIGHT, SLOW_CAMERA

    def feed(node: FedNode) -> None:
        for _ in range(10):
            node.feed(image, *([camera] if camera else []))
            node.robot.spin(timeout_s=0.1)
        time.sleep(pause_s)
    return _begun(folder, arguments, 'active', feed)


def _shutdown(folder: Path, rng: np.random.Generator, number: int) -> _Begun:
    """A second signal some time after the first one."""
    network = write_slow_network(folder / 'slow.onnx', deaf=True)
    pause_s = rng.uniform(0, 0.3)

    def feed(node: FedNode) -> None:
        for _ in range(5):
            node.feed(BRIGHT, SLOW_CAMERA)
            node.robot.spin(timeout_s=0.1)
        node.node.process.send_signal(number)
        time.sleep(pause_s)
    return _begun(folder, network_arguments(network), 'active', feed)


def deactivating(folder: Path) -> list[Row]:
    """Return how long a transition and a service wait for a frame that never ends."""
    rows = []
    for deaf in (False, True):
        network = write_slow_network(folder / 'slow.onnx', deaf=deaf)
        with fed_node(folder, network_arguments(network)) as node:
            assert node.wait_for_state('active'), node.node.log()
            for _ in range(5):
                node.feed(BRIGHT, SLOW_CAMERA)
                node.robot.spin(timeout_s=0.2)
            start_s = time.monotonic()
            request = ChangeState.Request(
                transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
            done = node.robot.call(ChangeState, 'plane_detector/change_state', request).success
            seconds = time.monotonic() - start_s
        rows.append(Row(f'deactivate in a frame that {"hears nothing" if deaf else "never ends"}',
                        'returns at once', f'{seconds:.2f} s', done and seconds < 1))
    network = write_slow_network(folder / 'slow.onnx', always=True)
    with fed_node(folder, network_arguments(network)) as node:
        assert node.wait_for_state('configuring'), node.node.log()
        start_s = time.monotonic()
        state = node.robot.call(GetState, 'plane_detector/get_state').current_state.label
        seconds = time.monotonic() - start_s
    return [*rows, Row('get_state in an endless warm-up', 'answered', f'{state}, {seconds:.2f} s',
                       state == 'configuring')]

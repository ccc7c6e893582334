# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compressed bombs, damaged messages, random parameters and transitions: the node continues."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from common import CAMERA, FedNode, Row, fed_node, room_network, rooms, usage
from compressed_bombs import jpeg_bomb, jpeg_of_many_scans, png_bomb
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_helpers import image_msg

from plane_detector.config import Config
from plane_detector.settings import parameters_of

# Time and memory of a decoder alone: imports do not count.
DECODING = """
import resource, sys, time
from sensor_msgs.msg import CompressedImage
from plane_detector.ros.inputs.image_decoding import rgb_from_compressed_msg
msg = CompressedImage(data=open(sys.argv[1], 'rb').read())
before_kb, start_s = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
try:
    rgb_from_compressed_msg(msg, (0, 0), 50_000_000)
    outcome = 'decoded'
except ValueError:
    outcome = 'refused'
taken_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb
print(outcome, time.process_time() - start_s, taken_kb / 1024)
"""
FRAMES, CHANGES, TRANSITIONS = 300, 200, 100


def bombs(folder: Path) -> list[Row]:
    """Return time and memory of each compressed bomb."""
    files = {'PNG that declares 30000 x 30000': png_bomb(30000, 30000),
             'JPEG that declares 30000 x 30000': jpeg_bomb(30000, 30000),
             'JPEG of 1000 scans, 4000 x 3000': jpeg_of_many_scans(4000, 3000, 1000)}
    chunk = bytearray(png_bomb(16, 16))
    chunk[33] = 0x7f
    files['PNG with a chunk of 2 GB that is not there'] = bytes(chunk)
    rows = []
    for name, data in files.items():
        (path := folder / 'bomb').write_bytes(data)
        done = subprocess.run([sys.executable, '-c', DECODING, str(path)], capture_output=True,
                              text=True, check=False)
        outcome, seconds, memory_mb = done.stdout.split() or ('crashed', 'inf', 'inf')
        rows.append(Row(f'{name}, {len(data)} bytes', 'refused, under 0.1 s and 20 MB',
                        f'{outcome}, {float(seconds):.2f} s, {float(memory_mb):.0f} MB',
                        outcome == 'refused' and float(seconds) < 0.1 and float(memory_mb) < 20))
    return rows


def random_messages(folder: Path) -> list[Row]:
    """Return the behaviour of a node under damaged images, parameters and transitions."""
    rng = np.random.default_rng(0)
    with fed_node(folder, room_network(folder), ('planes', 'points', 'overlay')) as node:
        assert node.wait_for_state('active'), node.node.log()
        image = rooms(1)[0]
        rows = [_still_works(node, image, 'nothing')]
        before = usage(node.pid)
        for _ in range(FRAMES):
            _damaged(node, image, rng)
        rows.append(_still_works(node, image, f'{FRAMES} damaged images'))
        refused = sum(_random_parameter(node, image, rng) for _ in range(CHANGES))
        set_parameters(node, {name: value for name, _, value in parameters_of(Config())})
        rows.append(_still_works(node, image, f'{CHANGES} random parameters under load, '
                                 f'{refused} refused'))
        slowest_s = max(_random_transition(node, image, rng) for _ in range(TRANSITIONS))
        for wanted in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            _transit(node, wanted)
        rows.append(_still_works(node, image, f'{TRANSITIONS} random transitions under load, '
                                 f'the slowest {slowest_s:.2f} s'))
        after = usage(node.pid)
    grown_mb = after.memory_mb - before.memory_mb
    return [*rows, Row('all of these', 'threads and descriptors as before',
                       f'{before.threads} to {after.threads} threads, {before.descriptors} to '
                       f'{after.descriptors} descriptors, {grown_mb:+.0f} MB',
                       after.threads <= before.threads + 2
                       and after.descriptors <= before.descriptors + 4)]


def _still_works(node: FedNode, image: np.ndarray, after: str) -> Row:
    """Feed the node until planes come."""
    heard, end_s = node.heard['planes'], time.monotonic() + 20
    while node.heard['planes'] == heard and time.monotonic() < end_s:
        node.feed(image)
        node.robot.spin(timeout_s=0.2)
    alive = node.node.process.poll() is None
    traces = node.node.log().count('Traceback')
    return Row(after, 'the node answers with planes', f'{"planes" if alive else "it ended"}'
               f'{f", {traces} tracebacks" if traces else ""}',
               alive and node.heard['planes'] > heard and not traces)


def _damaged(node: FedNode, image: np.ndarray, rng: np.random.Generator) -> None:
    """Publish an image one of whose fields is random."""
    node.feed(image)
    msg = image_msg(image, 'rgb8', 1000.0)
    field = rng.choice(['height', 'width', 'step', 'encoding', 'data', 'is_bigendian'])
    if field == 'encoding':
        msg.encoding = ''.join(map(chr, rng.integers(1, 0xD000, rng.integers(1, 5000))))
    elif field == 'data':
        msg.data = msg.data[:rng.integers(len(msg.data))]
    else:
        setattr(msg, field, int(rng.integers(2 if field == 'is_bigendian' else 2**31)))
    node.robot.publish('image', msg)
    node.robot.spin(timeout_s=0.02)


def _random_parameter(node: FedNode, image: np.ndarray, rng: np.random.Generator) -> bool:
    """Set a random parameter to anything; return whether it was refused."""
    names = {name: value for name, _, value in parameters_of(Config())}
    name = str(rng.choice(list(names)))
    numbers = [0, -1, 1, 2**31, 10**12]
    reals = [0.0, -1.0, 1e-9, 0.5, 1e300, float('nan'), float('inf')]
    value = [numbers, reals, [True, False], ['', 'auto', 'x' * 10**4]][rng.integers(4)]
    if isinstance(names[name], float):
        value = reals
    elif type(names[name]) is int:
        value = numbers
    node.feed(image)
    return not set_parameters(node, {name: value[rng.integers(len(value))]})[0]


def set_parameters(node: FedNode, values: dict) -> list[bool]:
    """Set parameters; return which were accepted."""
    plain = {name: list(value) if isinstance(value, tuple) else value
             for name, value in values.items()}
    parameters = [Parameter(name, value=value).to_parameter_msg()
                  for name, value in plain.items()]
    answer = node.robot.call(SetParameters, 'plane_detector/set_parameters',
                             SetParameters.Request(parameters=parameters))
    return [result.successful for result in answer.results]


def _random_transition(node: FedNode, image: np.ndarray, rng: np.random.Generator) -> float:
    """Ask for a random transition under load; return how long the answer took."""
    node.feed(image, CAMERA)
    return _transit(node, int(rng.choice([1, 2, 3, 4, 99])))


def _transit(node: FedNode, number: int) -> float:
    start_s = time.monotonic()
    node.robot.call(ChangeState, 'plane_detector/change_state',
                    ChangeState.Request(transition=Transition(id=number)))
    return time.monotonic() - start_s

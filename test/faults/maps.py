# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Odd files of a map, between good ones, while the node maps: the service and images go on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
from common import ROOT, FedNode, Row, fed_node, usage
from fields import Camera
from map_file_faults import hostile, odd_bytes, odd_fields
from rclpy.client import Client
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_helpers import FRAME_ID, transform_msg
from std_srvs.srv import Trigger

STAND_IN = ROOT / 'test' / 'helpers' / 'tf_stand_in'
WITHIN_S, GIVEN_UP_S = 5.0, 20.0
MOST_MB = 200
# Every fifth of the odd fields, to take minutes only; test_map_file.py has all of them.
EVERY, CHANGED_BYTES = 5, 200


def maps(folder: Path) -> list[Row]:
    """Return what becomes of the node while odd files are loaded."""
    path = folder / 'map.json'
    os.environ['PYTHONPATH'] = os.pathsep.join([str(STAND_IN), os.environ.get('PYTHONPATH', '')])
    arguments = [word for name, value in (
        ('depth.source', 'topic'), ('use_imu', 'true'), ('map.enabled', 'true'),
        ('target_frame', 'odom'), ('map.file', path)) for word in ('-p', f'{name}:={value}')]
    with fed_node(folder, arguments) as node:
        assert node.wait_for_state('active'), node.node.log()
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.robot.publish('/tf_static', transform_msg('odom', FRAME_ID), latched)
        camera = Camera(node)
        for _ in range(20):
            camera.seconds_to_answer()
        clients = {name: node.robot.node.create_client(Trigger, f'/plane_detector/map/{name}')
                   for name in ('load', 'save')}
        assert node.robot.spin(lambda: all(one.service_is_ready() for one in clients.values()))
        assert _called(node, clients['save'])[1], node.node.log()
        good = path.read_text()
        content = json.loads(good)
        fields = islice(odd_fields(content), 0, None, EVERY)
        return [_row(node, camera, path, good, clients['load'], name, cases) for name, cases in (
            ('files with one odd field', fields),
            ('files with odd bytes', odd_bytes(good, np.random.default_rng(0), CHANGED_BYTES)),
            ('files that cost much', hostile().items()))]


def _called(node: FedNode, client: Client) -> tuple[float, bool]:
    """Call a service; return the time until it is answered, infinite if never, and success."""
    start_s = time.monotonic()
    future = client.call_async(Trigger.Request())
    node.robot.spin(future.done, GIVEN_UP_S)
    if not future.done():
        return float('inf'), False
    return time.monotonic() - start_s, future.result().success


def _row(node: FedNode, camera: Camera, path: Path, good: str, load: Client, name: str,
         cases: Iterable[tuple[str, str | bytes]]) -> Row:
    before_mb, most_mb, count, accepted = usage(node.pid).memory_mb, 0.0, 0, 0
    slowest, bad_loads = (0.0, ''), 0
    for case, data in cases:
        count += 1
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        load_s, is_accepted = _called(node, load)
        accepted += is_accepted
        path.write_text(good)
        good_s, is_loaded = _called(node, load)
        bad_loads += not is_loaded
        slowest = max(slowest, (max(load_s, good_s, camera.seconds_to_answer()), case))
        if node.node.process.poll() is not None or slowest[0] == float('inf'):
            break
        most_mb = max(most_mb, usage(node.pid).memory_mb - before_mb)
    node.robot.spin(timeout_s=1.5)
    values, log = node.values(), node.node.log()
    skipped, traces = values.get('frames_skipped', '?'), log.count('Traceback')
    return Row(f'{count} {name}, each before a good one',
               f'both loads and an image are answered within {WITHIN_S:.0f} s, no image is '
               f'skipped, at most {MOST_MB} MB more, the good one is loaded',
               f'slowest {slowest[0]:.2f} s, {slowest[1]}; {skipped} skipped, {most_mb:.0f} MB, '
               f'{bad_loads} good ones refused, {accepted} odd ones accepted, {traces} tracebacks',
               slowest[0] <= WITHIN_S and skipped == '0' and not traces and not bad_loads
               and most_mb <= MOST_MB)

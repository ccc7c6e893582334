# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A long run at 30 Hz with all outputs: memory, threads and descriptors stay constant."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
from common import FedNode, Row, Usage, fed_node, room_network, rooms, usage

from plane_detector.evaluation.scenes.rooms import VGA
from plane_detector.ros.outputs.topics import OUTPUTS

RATE_HZ = 30.0
SETTLED_MIN = 2
MOST_GROWTH = 0.05


def soak(folder: Path, minutes: int) -> list[Row]:
    """Run for so many minutes, print what the node takes every minute, and judge it."""
    images = rooms(8, VGA)
    arguments = [*room_network(folder, VGA), '-p', 'scale.gravity:=[0.0, 1.0, 0.0]',
                 '-p', 'scale.gravity_tolerance:=30.0']
    with fed_node(folder, arguments, tuple(OUTPUTS)) as node:
        if not node.wait_for_state('active'):
            return [Row('soak', 'the node starts', node.node.log()[-500:], False)]
        print('| Minute | Memory MB | Threads | Descriptors | Published | Processed | Outputs |\n'
              '|---|---|---|---|---|---|---|', flush=True)
        taken = [_minute(node, images, minute) for minute in range(1, minutes + 1)]
        values, (end_s, code) = node.values(), node.seconds_to_end(signal.SIGTERM)
    settled = taken[SETTLED_MIN - 1:]
    memory = [each.memory_mb for each in settled]
    growth = (max(memory) - min(memory)) / min(memory)
    counts = {(each.threads, each.descriptors) for each in settled}
    return [
        Row(f'{minutes} minutes at {RATE_HZ:g} Hz, all outputs', f'memory within '
            f'{MOST_GROWTH:.0%} after minute {SETTLED_MIN}',
            f'{min(memory):.0f} to {max(memory):.0f} MB, {growth:.1%}', growth <= MOST_GROWTH),
        Row('the same', 'threads and descriptors stay',
            '; '.join(f'{threads} and {files}' for threads, files in sorted(counts)),
            max(files for _, files in counts) - min(files for _, files in counts) <= 2
            and max(threads for threads, _ in counts) - min(t for t, _ in counts) <= 2),
        Row('the same', 'no frame skipped', f'{values["frames_processed"]} processed, '
            f'{values["frames_skipped"]} skipped', values['frames_skipped'] == '0'),
        Row('SIGTERM after it', 'exit code 0 within 3 s', f'{end_s:.1f} s, exit code {code}',
            code == 0 and end_s <= 3)]


def _minute(node: FedNode, images: list[np.ndarray], minute: int) -> Usage:
    """Feed the node for a minute and print what it takes then."""
    start_s, published = time.monotonic(), 0
    while (elapsed_s := time.monotonic() - start_s) < 60:
        if elapsed_s * RATE_HZ >= published:
            node.feed(images[(30 * minute + published // 15) % len(images)], VGA)
            published += 1
        node.robot.executor.spin_once(timeout_sec=0.002)
    taken, values = usage(node.pid), node.values()
    print(f'| {minute} | {taken.memory_mb:.1f} | {taken.threads} | {taken.descriptors} | '
          f'{published} | {values.get("frames_processed")} | {sum(node.heard.values())} |',
          flush=True)
    return taken

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Print the planes of a running node as a table, live.

    ros2 run plane_detector show
    ros2 run plane_detector show --json --once
    ros2 run plane_detector show --map
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Mapping
from typing import TextIO

from plane_detector import PAGES
from plane_detector._runtime.dependencies import explained_imports
from plane_detector._runtime.ending import quiet_interrupt

with quiet_interrupt(), explained_imports():
    import numpy as np
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from sensor_msgs.msg import PointCloud2

    from plane_detector._runtime.plain_text import plain
    from plane_detector.ros.inputs.synchronizer import stamp_text
    from plane_detector.ros.inputs.topic_watch import GRACE_S
    from plane_detector.ros.node import not_of_ros
    from plane_detector.ros.outputs.messages import read_cloud
    from plane_detector.ros.outputs.plane_json import planes_to_json
    from plane_detector.ros.qos import output_profile
    from plane_detector.types import RELATIVE, PlaneClass

_CLASS_NAMES = {int(one): one.readable for one in PlaneClass}
_CLEAR = '\x1b[2J\x1b[H'
# Head, field, width and format of each column between the class and the normal.
_SIZES = (('width', 'rect_width', 7, '.2f'), ('height', 'rect_height', 7, '.2f'),
          ('area', 'area', 8, '.2f'))
_COLUMNS = (('distance', 'd', 8, '.2f'), *_SIZES, ('rms', 'rms', 7, '.3f'),
            ('conf.', 'confidence', 5, '.0%'))
_MAP_COLUMNS = (*((axis, axis, 7, '.2f') for axis in 'xyz'), *_SIZES, ('views', 'views', 5, 'd'),
                ('sigma', 'sigma_d', 7, '.3f'))


def table_of(msg: PointCloud2, is_metric: bool = True, camera: str = '',
             warning: str = '') -> str:
    """
    Return the planes of ``~/planes``, largest first, or of ``~/map/planes`` as lines of text.

    ``camera`` is the line of the diagnostics about its height, tilt and drops, ``warning`` their
    message about what is missing.
    """
    unit = 'metres' if is_metric else 'lengths in an unknown unit'
    rows = read_cloud(msg).ravel() if msg.height else ()
    if is_map := any(field.name == 'subsumed_by' for field in msg.fields):
        rows = [row for row in rows if not row['subsumed_by']]
    frame_id = plain(msg.header.frame_id)
    return '\n'.join([f'{len(rows)} planes at {stamp_text(msg)} in {frame_id}, {unit}',
                      *filter(None, [camera, warning]), *table_lines(rows, is_map)])


def table_lines(rows: Iterable[np.void], is_map: bool = False) -> list[str]:
    """Return the header and a line for each row of ``~/planes``, or of ``~/map/planes``."""
    columns = _MAP_COLUMNS if is_map else _COLUMNS
    heads = ' '.join(f'{head:>{width}}' for head, _, width, _ in columns)
    lines = [f'{"label":>5}  {"class":<16} {heads}  normal']
    for row in rows:
        name = _CLASS_NAMES.get(int(row['class']), f'class {row["class"]}')
        values = ' '.join(f'{row[field]:>{width}{form}}' for _, field, width, form in columns)
        normal = ' '.join(f'{row[f"normal_{axis}"]:+.2f}' for axis in 'xyz')
        lines.append(f'{row["label"]:>5}  {name:<16} {values}  {normal}')
    return lines


def camera_line(facts: Mapping[str, str]) -> str:
    """Return height and tilt of the camera, and the drops, from the facts of the diagnostics."""
    texts = {'camera_height_m': 'camera {} m above the floor',
             'camera_tilt_deg': 'tilted {} degrees down', 'drops': 'drops: {}'}
    return ', '.join(text.format(plain(facts[name])) for name, text in texts.items()
                     if name in facts)


class PlanePrinter(Node):
    """
    Prints every message of ``~/planes``, clearing the terminal before each. Logs why none arrives.

    ``detector`` is the name of the node, with its namespace; ``as_json`` prints a line of JSON
    for each message instead, ``of_map`` prints the planes of the map.
    """

    def __init__(self, detector: str, stream: TextIO, as_json: bool = False,
                 of_map: bool = False, **node_options: object):
        super().__init__('plane_printer', **node_options)
        self._as_json = as_json
        self._name, self._stream, self.has_printed = detector.strip('/'), stream, False
        self._is_metric, self._camera, self._warned, self._message = True, '', '', ''
        self.topic = f'/{self._name}/{"map/planes" if of_map else "planes"}'
        self.create_subscription(PointCloud2, self.topic, self._print, output_profile(of_map))
        self.create_subscription(DiagnosticArray, '/diagnostics', self._note_facts, 10)
        self._silence = self.create_timer(GRACE_S, self._warn_of_silence)

    def _note_facts(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name.strip('/') == self._name:
                self._message = '' if status.level == status.OK else plain(status.message)
                facts = {value.key: value.value for value in status.values}
                self._is_metric = facts.get('scale') != RELATIVE
                self._camera = camera_line(facts)

    def _warn_of_silence(self) -> None:
        problem = self.why_nothing()
        if problem != self._warned:
            self.get_logger().warning(problem)
        self._warned = problem

    def why_nothing(self) -> str:
        """Return why no planes arrive, and what to do."""
        own = self.topic
        if self.count_publishers(own):
            return (f'no planes on {own} yet: '
                    + (self._message or 'the log of the node says what is missing'))
        if own.endswith('/map/planes') and self.count_publishers(f'/{self._name}/planes'):
            return (f'nobody publishes {own}: /{self._name} keeps no map; set its parameters '
                    'map.enabled to true, and target_frame')
        others = [name.removesuffix('/planes') for name, _ in self.get_topic_names_and_types()
                  if name.endswith('/planes') and self.count_publishers(name)]
        there = f'there is: --node {" or --node ".join(others)}' if others else 'is it running?'
        return f'nobody publishes {own}; {there}'

    def _print(self, msg: PointCloud2) -> None:
        self._silence.cancel()
        if self._as_json:
            text = planes_to_json(msg, self._is_metric)
        else:
            clear = _CLEAR if self._stream.isatty() else ''
            text = clear + table_of(msg, self._is_metric, self._camera, self._message)
        print(text, file=self._stream, flush=True)
        self.has_printed = True


def main(args: list[str] | None = None) -> int:
    """Print until Ctrl-C; return the exit code."""
    arguments = sys.argv[1:] if args is None else args
    parser = argparse.ArgumentParser(prog='ros2 run plane_detector show',
                                     description=__doc__.strip().splitlines()[0],
                                     epilog=f'More: {PAGES}/topics.md')
    parser.add_argument('--node', default='/plane_detector', metavar='NAME',
                        help='of the detector, with its namespace (default: %(default)s)')
    parser.add_argument('--once', action='store_true', help='end after the first table')
    parser.add_argument('--json', action='store_true', help='a line of JSON for each image')
    parser.add_argument('--map', action='store_true',
                        help='the planes of the map, with map.enabled')
    options = parser.parse_args(not_of_ros(arguments))
    rclpy.init(args=arguments)
    node = PlanePrinter(options.node, sys.stdout, options.json, options.map)
    print(f'waiting for {node.topic}', file=sys.stderr)
    try:
        while rclpy.ok() and not (options.once and node.has_printed):
            rclpy.spin_once(node, timeout_sec=0.2)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except BrokenPipeError:  # as with `show | head`; the interpreter's last flush goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())

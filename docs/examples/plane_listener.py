#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Print the planes of each image and how many points each has. Copy it, and change what it prints.

    python3 $(ros2 pkg prefix --share plane_detector)/examples/plane_listener.py

Planes and points have the same stamp, and `label` joins them.
"""

from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from sensor_msgs_py.point_cloud2 import read_points

CLASSES = ('unknown', 'floor', 'ceiling', 'wall', 'other horizontal', 'other', 'ramp', 'step')


class PlaneListener(Node):
    """Joins the planes to their points."""

    def __init__(self):
        super().__init__('plane_listener')
        self.points = None
        self.create_subscription(PointCloud2, '/plane_detector/points', self.on_points, 1)
        self.create_subscription(PointCloud2, '/plane_detector/planes', self.on_planes, 1)

    def on_points(self, msg):
        """Keep the cloud until the planes of the same image arrive."""
        self.points = msg

    def on_planes(self, msg):
        """Print a line for each plane."""
        if self.points is None or self.points.header.stamp != msg.header.stamp:
            return
        points = read_points(self.points)
        for plane in read_points(msg):
            own = points[points['label'] == plane['label']]
            print(plane['label'], CLASSES[plane['class']], f'{plane["d"]:.2f} m away,',
                  f'{plane["rect_width"]:.2f} x {plane["rect_height"]:.2f} m,', len(own), 'points')


def main():
    """Print until Ctrl-C."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(PlaneListener())


if __name__ == '__main__':
    main()

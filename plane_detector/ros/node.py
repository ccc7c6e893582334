# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program `node`, also `python3 -m plane_detector.ros.node`; handles signals at once."""

from __future__ import annotations

import sys

from plane_detector import PAGES
from plane_detector._runtime.dependencies import explained_imports
from plane_detector._runtime.ending import quiet_interrupt

USAGE = f"""\
usage: ros2 run plane_detector node [--ros-args [-r FROM:=TO] [-p NAME:=VALUE]
                                     [--params-file FILE] [--log-level LEVEL]]

Finds planes in the images of an ordinary camera.

  ros2 run plane_detector node --ros-args -r image:=/camera/color/image_raw
  ros2 launch plane_detector plane_detector.launch.py --show-args

inputs       image (or image/compressed), camera_info, depth, imu, clicked_point
outputs      ros2 topic list | grep plane_detector
parameters   ros2 param describe /plane_detector depth.model
pages        {PAGES}: topics.md, parameters.md, ...
"""


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    own = not_of_ros(sys.argv[1:] if args is None else args)
    if own:
        is_asked = {'-h', '--help'} & set(own)
        stream = sys.stdout if is_asked else sys.stderr
        print(USAGE, end='' if is_asked else f'\nnot understood: {" ".join(own)}\n', file=stream)
        return 0 if is_asked else 2
    with quiet_interrupt(), explained_imports('numba', 'scipy'):
        from plane_detector.ros.detector_node import PlaneDetectorNode
        from plane_detector.ros.spinning import run
    return run(PlaneDetectorNode, args)


def not_of_ros(args: list[str]) -> list[str]:
    """Return the arguments outside ``--ros-args ... --``."""
    own, is_of_ros = [], False
    for argument in args:
        if argument == '--ros-args':
            is_of_ros = True
        elif is_of_ros and argument == '--':
            is_of_ros = False
        elif not is_of_ros:
            own.append(argument)
    return own


if __name__ == '__main__':
    sys.exit(main())

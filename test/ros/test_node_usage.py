# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Command line of the node program."""

import pytest

from plane_detector.ros.node import main, not_of_ros


@pytest.mark.parametrize('arguments', [['--help'], ['-h'], ['-h', '--ros-args', '-p', 'a:=1']])
def test_help_is_printed(arguments, capsys):
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith('usage: ros2 run plane_detector node')
    assert printed.err == ''


@pytest.mark.parametrize('arguments', [['image:=/camera'], ['--ros-args', '--', '--fast']])
def test_arguments_that_are_not_of_ros_are_refused(arguments, capsys):
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ''
    assert printed.err.startswith('usage:')
    assert printed.err.endswith(f'not understood: {arguments[-1]}\n')


def test_arguments_between_ros_args_and_dashes_belong_to_ros():
    assert not_of_ros(['--ros-args', '-r', 'image:=/a', '--', 'x', '--ros-args', '-h']) == ['x']

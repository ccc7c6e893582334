# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of launch/plane_detector.launch.py and their use. Does not import launch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

LAUNCH_FILE = 'plane_detector.launch.py'
# By name: default, description. An empty default keeps the value of params_file.
ARGUMENTS = {
    'params_file': ('', 'yaml file of the parameters; empty: the one that is installed'),
    'node_name': ('plane_detector', 'name of the node, and first part of its topics'),
    'namespace': ('', 'namespace of the node'),
    'image': ('image', 'topic of the colour image; the compressed one follows it'),
    'camera_info': ('', 'topic of its CameraInfo; empty: camera_info beside image'),
    'depth': ('depth', 'topic of measured depth, registered to the image'),
    'imu': ('imu', 'topic of the IMU, for use_imu'),
    'depth_source': ('', 'model or topic'),
    'model': ('', 'depth network: a name of the zoo, an .onnx file or auto'),
    'image_transport': ('', 'raw or compressed'),
    'use_imu': ('', 'true: gravity from the IMU'),
    'base_frame': ('', 'frame of the robot on the floor, for gravity and camera height from TF'),
    'target_frame': ('', 'frame of the outputs'),
    'mode': ('', 'continuous or on_demand'),
    'autostart': ('', 'false: a lifecycle manager configures and activates'),
    'respawn': ('false', 'true: start the node again when it ends; with exit_on_failure'),
    'use_sim_time': ('', 'true: take the time from /clock'),
    'rviz': ('false', 'true: start RViz with the frame of the camera'),
    'log_level': ('info', 'debug, info, warn, error or fatal'),
}
_BOOLEANS = ('use_imu', 'autostart', 'use_sim_time', 'respawn', 'rviz')
_PARAMETERS = {'depth_source': 'depth.source', 'model': 'depth.model',
               'image_transport': 'image_transport', 'use_imu': 'use_imu',
               'base_frame': 'base_frame', 'target_frame': 'target_frame', 'mode': 'mode',
               'autostart': 'autostart', 'use_sim_time': 'use_sim_time'}


class NodeArguments(NamedTuple):
    """
    Arguments for launch_ros's Node.

    Attributes
    ----------
    parameters : list
        A file, then the values that override it.
    remappings : list of (str, str)
    respawn, rviz : bool

    """

    parameters: list[Any]
    remappings: list[tuple[str, str]]
    respawn: bool
    rviz: bool


def node_arguments(values: Mapping[str, str], installed_file: str) -> NodeArguments:
    """
    Return the arguments that the node is started with.

    Parameters
    ----------
    values : mapping of str to str
        Of all `ARGUMENTS`.
    installed_file : str
        The yaml file that is used if none is given.

    Raises
    ------
    ValueError
        A value that must be true or false is neither.
    FileNotFoundError
        The parameter file does not exist.

    """
    file = Path(values['params_file'] or installed_file).expanduser()
    if not file.is_file():
        raise FileNotFoundError(f'params_file: there is no file {file}')
    switches = {name: _to_bool(name, values[name]) for name in _BOOLEANS if values[name]}
    overrides = {parameter: switches.get(name, values[name])
                 for name, parameter in _PARAMETERS.items() if values[name]}
    if switches.get('respawn'):
        overrides['exit_on_failure'] = True
    remappings = [(name, values[name]) for name in ('image', 'camera_info', 'depth', 'imu')
                  if values[name] not in ('', name)]
    return NodeArguments([str(file), overrides], remappings, switches.get('respawn', False),
                         switches.get('rviz', False))


def check_command_line(argv: Iterable[str], program: Iterable[str]) -> None:
    """
    Reject unknown arguments, which launch ignores silently.

    Parameters
    ----------
    argv : iterable of str
        Arguments of the launch, ``name:=value``.
    program : iterable of str
        Command line of the process. If it does not name this launch file, another one includes it,
        and the arguments may belong to that one.

    Raises
    ------
    ValueError
        An argument is unknown; the message has the most similar one.

    """
    if not any(word.endswith(LAUNCH_FILE) for word in program):
        return
    for word in argv:
        name, separator, _ = word.partition(':=')
        if separator and name not in ARGUMENTS:
            nearest = get_close_matches(name, ARGUMENTS, 1)
            meant = f' (meant: {nearest[0]}?)' if nearest else ''
            raise ValueError(f'there is no argument {name}{meant}; there are '
                             f'{", ".join(ARGUMENTS)}')


def _to_bool(name: str, text: str) -> bool:
    if text.lower() not in ('true', 'false'):
        raise ValueError(f'{name} must be true or false, not {text!r}')
    return text.lower() == 'true'

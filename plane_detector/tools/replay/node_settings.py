# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node for programs that are not nodes: a yaml file and NAME:=VALUE."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import yaml
from rclpy.parameter import Parameter, get_parameter_value, parameter_dict_from_yaml_file
from rclpy.parameter import parameter_value_to_python as value_to_python

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.parameters import no_such_parameter, updated
from plane_detector.settings import parameters_of

_NODE_NAME = 'plane_detector'
_OF_ROS = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


def load_settings(params_file: Path | None, assignments: Sequence[str]
                  ) -> tuple[Config, NodeConfig]:
    """
    Return the settings that the node would start with.

    Parameters
    ----------
    params_file : Path, optional
        As for ``ros2 run`` after ``--params-file``.
    assignments : sequence of str
        As for ``ros2 run`` after ``-p``: ``depth.source:=topic``. They override the file.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    ValueError
        A parameter is not known, or a value is invalid.

    """
    values = [*_from_file(params_file), *map(_from_assignment, assignments)]
    known = {name for settings in (Config(), NodeConfig())
             for name, _, _ in parameters_of(settings)}
    unknown = {parameter.name for parameter in values} - known
    unknown = sorted(name for name in unknown if not name.startswith(_OF_ROS))
    if unknown:
        raise ValueError(no_such_parameter(unknown, known))
    return updated(Config(), values), updated(NodeConfig(), values)


def _from_file(path: Path | None) -> Iterable[Parameter]:
    """Read the parameters of a file for this node, in any namespace, and for all nodes."""
    if path is None:
        return []
    if not path.is_file():
        raise FileNotFoundError(f'there is no parameter file {path}')
    try:
        sections = yaml.safe_load(path.read_text(encoding='utf-8'))
        own = [name for name in sorted(sections)
               if name.rpartition('/')[2] in (_NODE_NAME, '**', '*')]
        messages = parameter_dict_from_yaml_file(str(path), target_nodes=own) if own else {}
    except (yaml.YAMLError, RuntimeError, TypeError, AttributeError) as error:
        raise ValueError(f'{path} is not a ROS parameter file: {error}') from error
    return [Parameter.from_parameter_msg(message) for message in messages.values()]


def _from_assignment(text: str) -> Parameter:
    name, separator, value = text.partition(':=')
    if not (name and separator):
        raise ValueError(f'a parameter must be NAME:=VALUE, not {text!r}')
    return Parameter(name, value=value_to_python(get_parameter_value(value)))

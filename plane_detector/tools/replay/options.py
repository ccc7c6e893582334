# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Options of a replay, and the parameters of the node that it takes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import yaml
from rclpy.parameter import Parameter, get_parameter_value, parameter_dict_from_yaml_file
from rclpy.parameter import parameter_value_to_python as value_to_python

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.diagnostics import POINTS_WITHOUT_FLOOR
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.ros.parameters import no_such_parameter, updated
from plane_detector.settings import parameters_of

NODE_NAME = 'plane_detector'
# The obstacles would take a quarter of a bag, and their points are in ~/points too; the others
# repeat ~/planes, and programs that read bags may not know the type of detections.
DEFAULT_OUTPUTS = tuple(name for name in OUTPUTS
                        if name not in (POINTS_WITHOUT_FLOOR, 'planes_json', 'detections'))
# Paths do not affect the content of the new bag.
_PATHS = ('source', 'target', 'figures', 'ply', 'table', 'map_file')
_OF_ROS = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


@dataclass(frozen=True)
class ReplayOptions:
    """
    What to replay, and how.

    Examples
    --------
    >>> options = ReplayOptions(Path('walk'), Path('planes/walk'), depth_by_bag=True, every=2)
    >>> options.target.as_posix(), options.storage
    ('planes/walk', 'mcap')

    """

    source: Path  # the input bag
    target: Path  # the new bag
    config: Config = field(default_factory=Config)
    settings: NodeConfig = field(default_factory=NodeConfig)
    topics: Mapping[str, str] = field(default_factory=dict)  # requested, see find_camera
    depth_by_bag: bool = False  # measured depth if the bag has it, whatever config.depth.source is
    start_s: float = 0.0  # start of the part to replay, after the first message
    duration_s: float = float('inf')
    every: int = 1  # one frame in this many, starting with the first
    outputs: tuple[str, ...] = DEFAULT_OUTPUTS
    copied: tuple[str, ...] | None = None  # topics; empty: the inputs; None: nothing
    storage: str = 'mcap'  # or sqlite3
    compressed: bool = False
    figures: Path | None = None  # these three: see ReplayFiles
    ply: Path | None = None
    table: Path | None = None
    map_file: Path | None = None  # to write, with config.map.enabled
    load_map: Path | None = None  # file of a map to continue

    @property
    def fingerprint(self) -> str:
        """Return a hash of the settings that determine the content of the new bag."""
        content = [(f.name, repr(getattr(self, f.name))) for f in fields(self)
                   if f.name not in _PATHS]
        return hashlib.sha256(repr(content).encode()).hexdigest()[:16]


def load_settings(params_file: Path | None, assignments: Sequence[str],
                  node: NodeConfig | None = None) -> tuple[Config, NodeConfig]:
    """
    Return the settings that the node would start with.

    File and assignments are as for ``ros2 run`` after ``--params-file`` and ``-p``; the latter
    (``depth.source:=topic``) override the file. ``node`` has the values of settings not given.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    ValueError
        A parameter is unknown, a value is invalid, or the file has no section for this node.

    """
    values = [*_from_file(params_file), *map(_from_assignment, assignments)]
    known = {name for settings in (Config(), NodeConfig())
             for name, _, _ in parameters_of(settings)}
    unknown = {parameter.name for parameter in values} - known
    unknown = sorted(name for name in unknown if not name.startswith(_OF_ROS))
    if unknown:
        raise ValueError(no_such_parameter(unknown, known))
    return updated(Config(), values), updated(node or NodeConfig(), values)


def _from_file(path: Path | None) -> Iterable[Parameter]:
    """Read the parameters of a file for this node, in any namespace, and for all nodes."""
    if path is None:
        return []
    if not path.is_file():
        raise FileNotFoundError(f'there is no parameter file {path}')
    try:
        sections = sorted(yaml.safe_load(path.read_text(encoding='utf-8')))
        own = [name for name in sections if name.rpartition('/')[2] in (NODE_NAME, '**', '*')]
        messages = parameter_dict_from_yaml_file(str(path), target_nodes=own) if own else {}
    except (yaml.YAMLError, RuntimeError, TypeError, AttributeError) as error:
        raise ValueError(f'{path} is not a ROS parameter file: {error}') from error
    if not own:
        raise ValueError(f'{path} has no section for /{NODE_NAME}; it has: {", ".join(sections)}')
    return [Parameter.from_parameter_msg(message) for message in messages.values()]


def _from_assignment(text: str) -> Parameter:
    name, separator, value = text.partition(':=')
    if not (name and separator):
        raise ValueError(f'a parameter must be NAME:=VALUE, not {text!r}')
    return Parameter(name, value=value_to_python(get_parameter_value(value)))

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings as ROS parameters: one parameter per field, declared and checked in a loop.

A nested dataclass becomes a prefix: ``depth.model``. Name, type, default, range and description
are taken from the fields.
"""

from __future__ import annotations

import array
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import Field, fields, replace
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from plane_detector import PAGES
from plane_detector.settings import Settings, parameters_of

AnySettings = TypeVar('AnySettings', bound=Settings)
_LARGEST = 1.7e308


def declare(node: Node, defaults: AnySettings) -> AnySettings:
    """
    Declare every field as a parameter, and return the settings with their initial values.

    Raises ValueError if a value is out of range or has the wrong type.
    """
    return updated(defaults, [_declare_one(node, name, field, value)
                              for name, field, value in parameters_of(defaults)])


def warn_of_unknown(node: Node) -> None:
    """
    Warn of initial values for undeclared parameters, each with the most similar declared name.

    A warning, not an error: ROS 2 ignores such values, and a file may set one for many nodes.
    Values for qos_overrides are not checked: they are declared later, with their topics.
    """
    declared = node.list_parameters([], 0).names
    given = node._parameter_overrides  # rclpy has no public name for these
    unknown = sorted(name for name in given
                     if name not in declared and not name.startswith('qos_overrides.'))
    if unknown:
        node.get_logger().warning(f'ignored: {no_such_parameter(unknown, declared)}')


def warn_of_other_sections(node: Node, arguments: Sequence[str]) -> None:
    """
    Warn of parameter files on a command line that have no section for this node.

    ROS 2 ignores such a file. Sections are names of nodes, also with wildcards, or namespaces that
    contain them.
    """
    name = node.get_fully_qualified_name()
    for option, file in pairwise(arguments):
        if option != '--params-file':
            continue
        with open(file, encoding='utf-8') as opened:
            sections = list(_sections(yaml.safe_load(opened) or {}))
        if not any(_matches(section, name) for section in sections):
            node.get_logger().warning(
                f'{file} has no section for {name}; it has: {", ".join(sections) or "none"}')


def _sections(content: Any, above: str = '') -> Iterator[str]:
    """Yield the full names of the nodes for which a parameter file has values."""
    for key, value in content.items() if isinstance(content, dict) else ():
        if key == 'ros__parameters':
            yield above or '/'
        else:
            yield from _sections(value, f'{above}/{str(key).strip("/")}')


def _matches(section: str, name: str) -> bool:
    """Return whether a name of a section, in which ** stands for any namespace, is that name."""
    pattern = re.escape(section).replace(r'/\*\*', '(/[^/]+)*').replace(r'\*', '[^/]+')
    return re.fullmatch(pattern, name) is not None


def no_such_parameter(unknown: Iterable[str], known: Iterable[str]) -> str:
    """Return the message about unknown names, each with the most similar known one, if any."""
    known = sorted(known)
    names = ', '.join(
        name + ''.join(f' (meant: {near}?)' for near in get_close_matches(name, known, 1))
        for name in unknown)
    return f'no parameter has this name (see {PAGES}/parameters.md): {names}'


def updated(settings: AnySettings, parameters: Iterable[Parameter]) -> AnySettings:
    """
    Return the settings with the values of those parameters that belong to them.

    Raises ValueError if a value is out of range, or inconsistent with another one.
    """
    values = {parameter.name: parameter.value for parameter in parameters}
    return _replaced(settings, values, '')


def with_floats(settings: Settings, parameters: Iterable[Parameter]) -> list[Parameter]:
    """Return the parameters, with integers as floats if the setting is a float."""
    defaults = {name: value for name, _, value in parameters_of(settings)}
    return [Parameter(parameter.name, value=_as_float(defaults[parameter.name], parameter.value))
            if parameter.name in defaults else parameter for parameter in parameters]


def fixed_changes(old: AnySettings, new: AnySettings) -> list[str]:
    """Return the names of the settings that differ and are fixed while the node is configured."""
    return [name for (name, field, before), (_, _, after)
            in zip(parameters_of(old), parameters_of(new), strict=True)
            if field.metadata['read_only'] and before != after]


def descriptor(field: Field, default: Any) -> ParameterDescriptor:
    """
    Return the descriptor for `ros2 param describe`: description, unit, range, choices.

    No parameter is read-only for ROS, because rclpy would then reject even its current value,
    which `ros2 param load` of a dump sets. The node rejects changes while it is active.
    """
    meta = field.metadata
    unit = f' [{meta["unit"]}]' if meta['unit'] else ''
    when = '; read when the node is configured' if meta['read_only'] else ''
    result = ParameterDescriptor(description=meta['doc'] + unit + when)
    result.additional_constraints = _constraints(meta)
    result.dynamic_typing = _is_switch(meta)
    low, high = meta['low'], meta['high']
    if low is None and high is None:
        return result
    if isinstance(default, float):
        result.floating_point_range = [FloatingPointRange(
            from_value=float(-_LARGEST if low is None else low),
            to_value=float(_LARGEST if high is None else high))]
    elif isinstance(default, int):
        result.integer_range = [IntegerRange(
            from_value=int(-2**63 if low is None else low),
            to_value=int(2**63 - 1 if high is None else high))]
    return result


def _declare_one(node: Node, name: str, field: Field, default: Any) -> Parameter:
    """Declare a parameter; accepts an integer for a float, which rclpy rejects."""
    given = node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(name)
    value = _as_float(default, given)
    is_converted = value is not given
    if not is_converted:
        value = list(default) if isinstance(default, tuple) else default
    try:
        return node.declare_parameter(name, value, descriptor(field, default),
                                      ignore_override=is_converted)
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        wanted = ', '.join(filter(None, (_kind(default), _constraints(field.metadata))))
        raise ValueError(f'{name} must be {wanted}, not {given!r}') from error


def _kind(default: Any) -> str:
    """Return the type of the values of a parameter, in words."""
    kind = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}[
        type(_first(default))]
    return f'a list, each {kind}' if isinstance(default, tuple) else kind


def _first(value: Any) -> Any:
    return next(iter(value), None) if isinstance(value, (tuple, list, array.array)) else value


def _as_float(default: Any, value: Any) -> Any:
    """Return an integer, or an array of integers, as floats if the default is a float."""
    if not isinstance(_first(default), float) or type(_first(value)) is not int:
        return value
    if isinstance(default, tuple) != isinstance(value, (list, tuple, array.array)):
        return value
    return [float(v) for v in value] if isinstance(default, tuple) else float(value)


def _constraints(meta: Any) -> str:
    """Return the limits that the range of a descriptor cannot express: choices, arrays."""
    if meta['choices']:
        return 'one of ' + ', '.join(meta['choices'])
    limits = [f'at least {meta["low"]:g}' if meta['low'] is not None else '',
              f'at most {meta["high"]:g}' if meta['high'] is not None else '']
    return ', '.join(limit for limit in limits if limit)


def _is_switch(meta: Any) -> bool:
    """Whether true and false are among the choices, which yaml files give as bool."""
    return 'true' in meta['choices']


def _field_value(field: Field, value: Any) -> Any:
    if isinstance(value, bool) and _is_switch(field.metadata):
        return str(value).lower()
    return tuple(value) if isinstance(value, (list, array.array)) else value


def _replaced(settings: AnySettings, values: dict[str, Any], prefix: str) -> AnySettings:
    """Return the settings with some values by their names; the same object without any of them."""
    changes = {}
    for field in fields(settings):
        name, old = prefix + field.name, getattr(settings, field.name)
        if isinstance(old, Settings):
            new = _replaced(old, values, f'{name}.')
            changes |= {} if new is old else {field.name: new}
        elif name in values:
            changes[field.name] = _field_value(field, _as_float(old, values[name]))
    return replace(settings, **changes) if changes else settings

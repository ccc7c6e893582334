# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Declared, range-checked settings, for :mod:`plane_detector.config`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, field, fields
from typing import Any


def setting(default: Any, doc: str, unit: str = '', low: float | None = None,
            high: float | None = None, choices: tuple[str, ...] = (),
            python_only: bool = False) -> Any:
    """
    Declare a field with its description, unit, range and choices.

    A ``python_only`` setting is for programs and studies; the node has no parameter for it.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Speed(Settings, section='speed'):
    ...     limit: float = setting(1.5, 'highest speed of the camera', 'm/s', 0.0, 10.0)
    >>> Speed().limit
    1.5
    >>> Speed(limit=-1.0)
    Traceback (most recent call last):
    ValueError: speed.limit must be in [0.0, 10.0], not -1.0

    """
    return field(default=default, metadata={
        'doc': doc, 'unit': unit, 'low': low, 'high': high, 'choices': choices,
        'read_only': False, 'python_only': python_only})


def fixed_setting(*args: Any, **kwargs: Any) -> Any:
    """Declare a setting that is fixed while the node is configured."""
    declared = setting(*args, **kwargs)
    return field(default=declared.default, metadata={**declared.metadata, 'read_only': True})


class Settings:
    """Base class of all settings; a wrong value raises ValueError with the parameter's name."""

    def __init_subclass__(cls, section: str = '') -> None:
        cls._prefix = f'{section}.' if section else ''

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not isinstance(value, Settings):
                check_value(self._prefix + f.name, value, f.default, f.metadata)


def check_value(name: str, value: Any, default: Any, metadata: Any) -> None:
    """
    Check one value against the type of its default and its metadata.

    Raises
    ------
    ValueError
        The value has the wrong type, is out of range or is not one of the choices.

    """
    if not _same_type(value, default):
        raise ValueError(f'{name} must be of type {type(default).__name__}, not {value!r}')
    if metadata['choices'] and value not in metadata['choices']:
        raise ValueError(f'{name} must be one of {", ".join(metadata["choices"])}, not {value!r}')
    low, high = metadata['low'], metadata['high']
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if (low is not None and not number >= low) or (high is not None and not number <= high):
            raise ValueError(f'{name} must be in [{low}, {high}], not {value!r}')


def _same_type(value: Any, default: Any) -> bool:
    if isinstance(default, tuple):
        return isinstance(value, tuple) and all(_same_type(v, default[0]) for v in value)
    if isinstance(default, float):
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    return type(value) is type(default)


def parameters_of(settings: Settings, prefix: str = '') -> Iterator[tuple[str, Field, Any]]:
    """Yield name (nested: ``depth.model``), field and value of each setting that the node has."""
    for f in fields(settings):
        value = getattr(settings, f.name)
        if isinstance(value, Settings):
            yield from parameters_of(value, f'{prefix}{f.name}.')
        elif not f.metadata['python_only']:
            yield prefix + f.name, f, value

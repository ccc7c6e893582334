# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the settings and the zoo together say about a network: file, outputs, input, views."""

from __future__ import annotations

from pathlib import Path

from plane_detector.config import DepthConfig
from plane_detector.depth.model_zoo import choose, fetch
from plane_detector.depth.networks import NETWORKS, Network
from plane_detector.depth.onnx_session import Interface
from plane_detector.depth.readers import DepthImageReader, Reader


def resolve(config: DepthConfig) -> tuple[Network | None, Path, str]:
    """Return the network of the zoo (None for a path), its file and the reason."""
    if config.model == 'auto':
        return choose(config.cache_dir, config.output)
    if config.model in NETWORKS:
        path = fetch(config.model, config.cache_dir)
        return NETWORKS[config.model], path, f'{config.model} as requested'
    path = Path(config.model).expanduser()
    if not path.is_file():
        raise ValueError(f'depth.model {config.model!r} is neither a file nor one of auto, '
                         f'{", ".join(NETWORKS)}')
    return None, path, f'{path} as requested'


def reader_of(config: DepthConfig, network: Network | None) -> Reader:
    """Return the reader of the outputs, from the zoo or, for a path, from the settings."""
    if network is None and config.output == 'auto':
        raise ValueError(f'depth.output must state the output of {config.model}: metric_depth, '
                         'disparity or relative_disparity')
    if network and config.output not in ('auto', network.output):
        raise ValueError(f'depth.output is {config.output}, but {network.name} gives '
                         f'{network.output}: leave it at auto')
    return network.reader if network else DepthImageReader(config.output)


def view_count(config: DepthConfig, network: Network | None) -> int:
    """Return the number of views to average, from the settings or the zoo."""
    count = config.views or (network.views if network else 1)
    if count > 1 and not (network and network.focal_per_height):
        raise ValueError(f'depth.views {count} needs a metric network whose lens in training the '
                         f'zoo states; use 1 with {network.name if network else config.model}')
    return count


def interface_of(config: DepthConfig, network: Network | None, reader: Reader) -> Interface:
    """Return the required interface of the file; size settings override those of the zoo."""
    wanted = (config.input_width, config.input_height)
    if network is None:
        return Interface(reader.outputs, {}, wanted, config.short_side, config.side_multiple)
    return Interface(reader.outputs, network.scalars,
                     wanted if any(wanted) else network.input_size,
                     config.short_side or network.short_side, network.side_multiple)

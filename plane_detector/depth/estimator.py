# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""RGB picture to depth or disparity by a network."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from plane_detector.config import DepthConfig
from plane_detector.depth.model_zoo import NETWORKS, Network, choose, fetch
from plane_detector.depth.onnx_file import check_external_data
from plane_detector.depth.onnx_session import OnnxSession, ProviderError, available_providers
from plane_detector.depth.preprocessing import (
    InputRecipe,
    finish_output,
    prepare_input,
)

_WARM_UP_SIZE = (640, 480)




class DepthEstimator:
    """
    A depth network, ready to run: it has run once when the constructor returns.

    The same picture gives the same output. Calls must not overlap.

    Parameters
    ----------
    config : DepthConfig
        Which network and how it is run.

    Attributes
    ----------
    output : str
        What calls return: ``metric_depth``, ``disparity`` or ``relative_disparity``.
    name : str
        Of the network: a name of the zoo or a path.
    reason : str
        Why this network and this execution provider were taken.
    disparity_noise : float
        Typical error of 1/depth per metre, for relative networks as a share of the picture's
        disparity range; 0 where it is not known.
    focal_per_height : float
        Focal length over picture height that the network assumes, 0 where it is not known.
    provider : str
        The execution provider that runs.
    max_depth_m : float
        Farther is invalid; may be set between two calls.

    Raises
    ------
    FileNotFoundError
        The network is not there and cannot be fetched.
    ValueError
        The settings do not fit the network, or it is no depth network, or no execution provider
        runs it.

    """

    def __init__(self, config: DepthConfig) -> None:
        network, path, reason = _resolve(config)
        self.name = network.name if network else str(path)
        self.output = _output(config, network)
        self.disparity_noise = network.disparity_noise if network else 0.0
        self.focal_per_height = network.focal_per_height if network else 0.0
        self.max_depth_m = config.max_depth
        self._recipe = _recipe(config, network)
        short_side = config.short_side or (network.short_side if network else 0)
        multiple = network.side_multiple if network else config.side_multiple
        check_external_data(path)
        self._session, self.provider, passed_over = _first_that_runs(
            path, config, short_side, multiple)
        self.reason = '; '.join([reason, *passed_over, f'runs on {self.provider}'])

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """
        Estimate the depth of a picture.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            The picture.

        Returns
        -------
        (H, W) float32
            Depth in metres or disparity, as `output` says; NaN where it is invalid.

        Raises
        ------
        ValueError
            It is no such picture, or the network fails on it.

        """
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or rgb.size == 0:
            raise ValueError(f'the picture must be (H, W, 3) uint8, not {rgb.shape} {rgb.dtype}')
        size = (rgb.shape[1], rgb.shape[0])
        planes = prepare_input(rgb, self._session.input_size(*size), self._recipe)
        return finish_output(self._session.run(planes), size, self.output, self.max_depth_m)

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the width and height of the network's input for a picture of this size."""
        return self._session.input_size(width, height)


def _first_that_runs(path: Path, config: DepthConfig, short_side: int,
                     multiple: int) -> tuple[OnnxSession, str, list[str]]:
    """Return the warm session of the first provider that runs, and why others do not."""
    passed_over: list[str] = []
    for provider in config.providers:
        try:
            session = OnnxSession(path, provider, config, short_side, multiple)
            width, height = session.input_size(*_WARM_UP_SIZE)
            session.run(np.zeros((3, height, width), np.float32))
        except ProviderError as error:
            passed_over.append(f'{provider} does not run: {error}')
        else:
            return session, provider, passed_over
    raise ValueError(f'no execution provider runs {path}. {"; ".join(passed_over)}. Providers '
                     f'here: {", ".join(available_providers())}')


def _resolve(config: DepthConfig) -> tuple[Network | None, Path, str]:
    """Return the network of the zoo (None for a path), its file and why it was taken."""
    if config.model == 'auto':
        return choose(config.cache_dir, config.output)
    if config.model in NETWORKS:
        path = fetch(config.model, config.cache_dir)
        return NETWORKS[config.model], path, f'{config.model} as asked for'
    path = Path(config.model).expanduser()
    if not path.is_file():
        raise FileNotFoundError(f'depth.model {config.model!r} is neither a file nor one of auto, '
                                f'{", ".join(NETWORKS)}')
    return None, path, f'{path} as asked for'


def _output(config: DepthConfig, network: Network | None) -> str:
    """Return what the network gives, by the zoo or, for a path, by the settings."""
    if network is None and config.output == 'auto':
        raise ValueError(f'depth.output must say what {config.model} gives: metric_depth, '
                         'disparity or relative_disparity')
    if network and config.output not in ('auto', network.output):
        raise ValueError(f'depth.output is {config.output}, but {network.name} gives '
                         f'{network.output}: leave it at auto')
    return network.output if network else config.output


def _recipe(config: DepthConfig, network: Network | None) -> InputRecipe:
    if network is None:
        return InputRecipe(config.input_scale, config.mean, config.std)
    return InputRecipe(1 / 255, network.mean, network.std, network.shrink)









# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth or disparity of an RGB image by a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from plane_detector.config import DepthConfig
from plane_detector.depth import plausibility
from plane_detector.depth.input_rate import (
    LOAD,
    beside,
    largest_within,
    median_seconds,
    side_for,
)
from plane_detector.depth.model_zoo import choose, fetch
from plane_detector.depth.networks import NETWORKS, Network
from plane_detector.depth.onnx_file import check_external_data
from plane_detector.depth.onnx_session import (
    Interface,
    OnnxSession,
    ProviderError,
    available_providers,
)
from plane_detector.depth.plausibility import ImplausibleDepthError
from plane_detector.depth.preprocessing import InputRecipe, prepare_input
from plane_detector.depth.readers import DepthImageReader, OutputError, Reader
from plane_detector.types import CameraIntrinsics, Prediction

# Largest error of depth edges, in pixels of the network input.
BLUR_INPUT_PX = 3.5


class DepthEstimator:
    """
    A depth network, ready to run: the constructor has already run it once.

    The same image gives the same output. Calls must not overlap.

    Parameters
    ----------
    config : DepthConfig
        Selects the network and how it is run.

    Attributes
    ----------
    output : str
        Kind of the returned values: ``metric_depth``, ``disparity`` or ``relative_disparity``.
    needs_lens : bool
        Whether it needs the intrinsics of the image.
    name : str
        Name in the zoo, or path.
    reason : str
        Why this network and this execution provider were chosen.
    noise_share : float
        Typical error of its disparity as a share of the disparities of the image; 0: unknown.
    focal_per_height : float
        Focal length over image height that the network assumes; 0: unknown.
    provider : str
        Execution provider in use.

    Raises
    ------
    FileNotFoundError
        The network is not available and cannot be downloaded.
    ValueError
        The settings do not fit the network, the file is not a depth network, no execution
        provider runs it, or its output cannot be depth.

    """

    def __init__(self, config: DepthConfig) -> None:
        network, self._path, reason = _resolve(config)
        self.name = network.name if network else str(self._path)
        self._reader = _reader(config, network)
        self.output, self.needs_lens = self._reader.kind, self._reader.needs_lens
        self.noise_share = network.noise_share if network else config.noise_share
        self.focal_per_height = network.focal_per_height if network else 0.0
        self._recipe = network.recipe if network else InputRecipe(
            config.input_scale, config.mean, config.std)
        self._input_reason, self._target_rate_hz = '', 0.0
        check_external_data(self._path)
        self._session, self.provider, passed_over, arrays = _first_that_runs(
            self._path, config, _interface(config, network, self._reader), self._recipe)
        self._check_on_corridor(arrays)
        self.reason = '; '.join([reason, *passed_over, f'runs on {self.provider}'])

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """
        Return the values (H, W) float32 of :meth:`predict` for an image with an unknown lens.

        Only for networks that do not need the lens.
        """
        return self.predict(rgb).values

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics | None = None) -> Prediction:
        """
        Estimate depth, and normals if the network provides them.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            The image.
        intrinsics : CameraIntrinsics, optional
            Of the image; required if `needs_lens`.

        Returns
        -------
        Prediction
            With the size of the image.

        Raises
        ------
        ValueError
            The image has another shape or type, the network fails on it, or its output cannot be
            depth.

        """
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or rgb.size == 0:
            raise ValueError(f'the image must be (H, W, 3) uint8, not {rgb.shape} {rgb.dtype}')
        if self.needs_lens and intrinsics is None:
            raise ValueError(f'{self.name} needs the intrinsics of the image')
        input_size = self._session.input_size(rgb.shape[1], rgb.shape[0])
        arrays = self._session.run(prepare_input(rgb, input_size, self._recipe))
        return self._read(arrays, rgb, intrinsics)

    def fit_to_rate(self, rate_hz: float, plane_stage: Callable[[], object]) -> None:
        """
        Choose the largest input that keeps a rate beside the plane stage, if its size is free.

        Parameters
        ----------
        rate_hz : float
            0: the input size does not change.
        plane_stage : callable
            The rest of the work on a frame; runs once per period while the network is timed.

        """
        session, width_height = self._session, plausibility.CORRIDOR_SIZE
        self._target_rate_hz = rate_hz
        if rate_hz == 0:
            return
        if not session.short_sides:
            self._input_reason = f'depth.target_rate {rate_hz:g} Hz: its input has a fixed size'
            return
        rgb, lens = plausibility.corridor()[0], plausibility.CORRIDOR_LENS

        def seconds_of(short_side: int) -> float:
            self._session = session.resized(short_side)
            return median_seconds(lambda: self.predict(rgb, lens))
        plane_stage()  # compiles what is compiled on the first call
        with beside(plane_stage, 1 / rate_hz):
            side, seconds = largest_within(session.short_sides, seconds_of, LOAD / rate_hz)
        self._session = session.resized(side)
        measured = ', '.join('{} x {} {:.0f} ms'.format(
            *session.resized(one).input_size(*width_height), 1e3 * seconds[one])
            for one in sorted(seconds))
        kept = 'kept' if seconds[side] <= LOAD / rate_hz else 'not kept by the smallest input'
        self._input_reason = (f'depth.target_rate {rate_hz:g} Hz is {kept}; beside the plane '
                              f'stage: {measured}')

    def advise(self, share: float) -> str:
        """Return the setting that would reduce the time of the network to a given share."""
        sides = self._session.short_sides
        if not sides:
            return 'its input has a fixed size: use a smaller network or a GPU'
        side = side_for(self._session.short_side, share, sides)
        if side is None:
            return 'it has no input size that is small enough: use a smaller network or a GPU'
        taken = (f', taken for depth.target_rate {self._target_rate_hz:g} Hz'
                 if self._target_rate_hz else '')
        return (f'depth.short_side {side} (now {self._session.short_side}{taken}) would keep up, '
                "or depth.target_rate at the camera's rate")

    @property
    def facts(self) -> Mapping[str, str]:
        """Description for the log and the diagnostics."""
        width, height = self.input_size(*plausibility.CORRIDOR_SIZE)
        facts = {'depth_model': self.name, 'depth_model_reason': self.reason,
                 'execution_provider': self.provider, 'network_input': f'{width} x {height}'}
        if self._input_reason:
            facts['network_input_reason'] = self._input_reason
        return facts

    def edge_blur_px(self, width: int, height: int) -> float:
        """Return the largest error of depth edges, in pixels of an image of this size."""
        return BLUR_INPUT_PX * width / self.input_size(width, height)[0]

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the width and height of the network's input for an image of this size."""
        return self._session.input_size(width, height)

    def _read(self, arrays: Sequence[np.ndarray], rgb: np.ndarray,
              intrinsics: CameraIntrinsics | None) -> Prediction:
        """Convert the network's output for an image to a prediction."""
        size = (rgb.shape[1], rgb.shape[0])
        framing = self._recipe.framing(size, self._session.input_size(*size))
        try:
            plausibility.check_values(self._reader.values(arrays), self.output, rgb)
            return self._reader.read(arrays, framing, intrinsics)
        except ImplausibleDepthError as error:
            raise ImplausibleDepthError(f'{self._path}: {error}') from None
        except OutputError as error:
            raise self._session.misfit(str(error)) from error

    def _check_on_corridor(self, arrays: Sequence[np.ndarray]) -> None:
        """Reject a network whose output contradicts its kind where the depth is known."""
        rgb, depth_m = plausibility.corridor()
        prediction = self._read(arrays, rgb, plausibility.CORRIDOR_LENS)
        if plausibility.shows_corridor(self.input_size(*plausibility.CORRIDOR_SIZE)):
            try:
                plausibility.check_kind(prediction, depth_m)
            except ImplausibleDepthError as error:
                raise ImplausibleDepthError(f'{self._path}: {error}') from None


def _first_that_runs(path: Path, config: DepthConfig, interface: Interface, recipe: InputRecipe
                     ) -> tuple[OnnxSession, str, list[str], list[np.ndarray]]:
    """Return the session of the first provider that runs, and its output for a test image."""
    passed_over: list[str] = []
    for provider in config.providers:
        try:
            session = OnnxSession(path, provider, config.threads, interface)
            size = session.input_size(*plausibility.CORRIDOR_SIZE)
            arrays = session.run(prepare_input(plausibility.corridor()[0], size, recipe))
        except ProviderError as error:
            passed_over.append(f'{provider} does not run: {error}')
        else:
            return session, provider, passed_over, arrays
    raise ValueError(f'no execution provider runs {path}. {"; ".join(passed_over)}. Providers '
                     f'here: {", ".join(available_providers())}')


def _resolve(config: DepthConfig) -> tuple[Network | None, Path, str]:
    """Return the network of the zoo (None for a path), its file and the reason."""
    if config.model == 'auto':
        return choose(config.cache_dir, config.output)
    if config.model in NETWORKS:
        path = fetch(config.model, config.cache_dir)
        return NETWORKS[config.model], path, f'{config.model} as requested'
    path = Path(config.model).expanduser()
    if not path.is_file():
        raise FileNotFoundError(f'depth.model {config.model!r} is neither a file nor one of auto, '
                                f'{", ".join(NETWORKS)}')
    return None, path, f'{path} as requested'


def _reader(config: DepthConfig, network: Network | None) -> Reader:
    """Return the reader of the outputs, from the zoo or, for a path, from the settings."""
    if network is None and config.output == 'auto':
        raise ValueError(f'depth.output must state the output of {config.model}: metric_depth, '
                         'disparity or relative_disparity')
    if network and config.output not in ('auto', network.output):
        raise ValueError(f'depth.output is {config.output}, but {network.name} gives '
                         f'{network.output}: leave it at auto')
    return network.reader if network else DepthImageReader(config.output)


def _interface(config: DepthConfig, network: Network | None, reader: Reader) -> Interface:
    """Return the required interface of the file; size settings override those of the zoo."""
    wanted = (config.input_width, config.input_height)
    if network is None:
        return Interface(reader.outputs, {}, wanted, config.short_side, config.side_multiple)
    return Interface(reader.outputs, network.scalars,
                     wanted if any(wanted) else network.input_size,
                     config.short_side or network.short_side, network.side_multiple)

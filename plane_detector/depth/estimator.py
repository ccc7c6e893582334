# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth or disparity of an RGB image by a network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from plane_detector.config import DepthConfig
from plane_detector.depth import plausibility
from plane_detector.depth.networks import resolve
from plane_detector.depth.onnx_file import check_file
from plane_detector.depth.onnx_session import (
    MIN_SIDE_PX,
    ON_CUDA,
    OnnxSession,
    ProviderError,
    available_providers,
    check_provider,
)
from plane_detector.depth.plausibility import ImplausibleDepthError
from plane_detector.depth.preprocessing import prepare_input
from plane_detector.depth.readers import OWN_FOCAL, OutputError, lens_factor
from plane_detector.depth.views import average_views, choose_views
from plane_detector.types import CameraIntrinsics, Prediction

# Largest error of depth edges, in pixels of the network input.
BLUR_INPUT_PX = 3.5


class DepthEstimator:
    """
    A depth network, ready to run: the constructor has already run it once.

    A :class:`~plane_detector.types.DepthModel`. The same image gives the same output. Calls must
    not overlap. Attributes are ``name`` in the zoo, or path, the execution ``provider`` in use,
    the ``reason`` why they were chosen, and whether it ``needs_lens``, the intrinsics.

    Raises
    ------
    FileNotFoundError
        The network is not available and cannot be downloaded.
    ValueError
        The settings do not fit the network, the file is not a depth network, no execution
        provider runs it, or its output cannot be depth.

    """

    def __init__(self, config: DepthConfig) -> None:
        rgb, depth_m = plausibility.corridor()
        passed_over: list[str] = []
        for self.provider in config.providers:
            try:
                check_provider(self.provider)
                self._network, self._path, reason, content = resolve(
                    config, self.provider == ON_CUDA)
                if content is None:
                    check_file(self._path)
                self._session = OnnxSession(self._path, content, self.provider, config,
                                            self._network)
                arrays = self._run(rgb)
                break
            except ProviderError as error:
                passed_over.append(f'{self.provider} does not run: {error}')
        else:
            raise ValueError(f'no execution provider runs depth.model {config.model}. '
                             f'{"; ".join(passed_over)}. '
                             f'Providers here: {", ".join(available_providers())}')
        self.name, self.noise_share = self._network.name, self._network.noise_share
        self.output, self.needs_lens = self._network.output, self._network.outputs.needs_lens
        self.focal_per_height = self._network.focal_per_height
        self._views = self._network.views
        on_gpu = f'; depth.providers may name {ON_CUDA}, which is installed'
        self.reason = '; '.join([reason, *passed_over, f'runs on {self.provider}']) + (
            on_gpu if ON_CUDA in set(available_providers()) - set(config.providers) else '')
        prediction = self._read(arrays, rgb, plausibility.CORRIDOR_LENS)
        # In a smaller input, a network cannot recognise the checkerboard.
        if min(self.input_size(*plausibility.CORRIDOR_SIZE)) >= MIN_SIDE_PX:
            with self._named():
                plausibility.check_kind(prediction, depth_m)

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """Return the values (H, W) float32 of :meth:`predict` without the lens, if possible."""
        return self.predict(rgb).values

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics | None = None) -> Prediction:
        """
        Return the depth of an image (H, W, 3) uint8, and normals if the network provides them.

        The intrinsics are required if `needs_lens`.

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
        ratio = lens_factor(intrinsics, OWN_FOCAL, self.focal_per_height) if intrinsics else 1.0
        views = choose_views(ratio, self._views)
        if len(views) == 1:
            return self._predict_view(rgb, intrinsics)
        return average_views(views, (self._predict_view(view.of(rgb), None) for view in views))

    @property
    def facts(self) -> Mapping[str, str]:
        """Description for the log and the diagnostics."""
        width, height = self.input_size(*plausibility.CORRIDOR_SIZE)
        views = f', up to {self._views} views' if self._views > 1 else ''
        return {'depth_model': self.name, 'depth_model_reason': self.reason,
                 'execution_provider': self.provider,
                 'network_input': f'{width} x {height}{views}'}

    def edge_blur_px(self, width: int, height: int) -> float:
        """Return the largest error of depth edges, in pixels of an image of this size."""
        return BLUR_INPUT_PX * width / self.input_size(width, height)[0]

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the width and height of the network's input for an image of this size."""
        return self._session.input_size(width, height)

    def _predict_view(self, rgb: np.ndarray, intrinsics: CameraIntrinsics | None) -> Prediction:
        return self._read(self._run(rgb), rgb, intrinsics)

    def _run(self, rgb: np.ndarray) -> list[np.ndarray]:
        """Return the outputs of the network for an image."""
        input_size = self._session.input_size(rgb.shape[1], rgb.shape[0])
        return self._session.run(prepare_input(rgb, input_size, self._network.recipe))

    def _read(self, arrays: Sequence[np.ndarray], rgb: np.ndarray,
              intrinsics: CameraIntrinsics | None) -> Prediction:
        """Convert the network's outputs for an image to a prediction."""
        size = (rgb.shape[1], rgb.shape[0])
        framing = self._network.recipe.framing(size, self._session.input_size(*size))
        with self._named():
            plausibility.check_values(self._network.outputs.raw(arrays), self.output, rgb)
            return self._network.outputs.read(arrays, framing, intrinsics)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Name the file in an error about its outputs."""
        try:
            yield
        except ImplausibleDepthError as error:
            raise ImplausibleDepthError(f'{self._path}: {error}') from None
        except OutputError as error:
            raise self._session.misfit(str(error)) from error

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One session of ONNX Runtime; the only module that imports onnxruntime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime as ort

from plane_detector.config import DepthConfig
from plane_detector.depth.preprocessing import (
    lower_bound_size,
)
from plane_detector.stopping import current_stop, raise_if_stopped

_INPUT_TYPES = {'tensor(float)': np.float32, 'tensor(float16)': np.float16}
# Where the tensors of an accelerator live. A provider that is not named here takes them from the
# memory of the host and leaves them there.
_DEVICES = {'CUDAExecutionProvider': 'cuda', 'TensorrtExecutionProvider': 'cuda'}
RUNTIME = f'ONNX Runtime {ort.__version__}'


def available_providers() -> tuple[str, ...]:
    """Return the execution providers of this ONNX Runtime that run on this machine."""
    return tuple(p for p in ort.get_available_providers() if p != 'AzureExecutionProvider')


class ProviderError(ValueError):
    """An execution provider is not there or cannot run the network."""


class OnnxSession:
    """
    One ONNX Runtime session that takes (3, H, W) float32 and gives (h, w).

    Raises
    ------
    ValueError
        The network does not take one picture and give one image, or not of the size asked for.
    ProviderError
        The execution provider cannot run it.

    """

    def __init__(self, path: Path, provider: str, config: DepthConfig, short_side: int,
                 multiple: int) -> None:
        self._session = _load(path, provider, config.threads)
        self._path = path
        self._device = _DEVICES.get(provider)
        self._input_on_device: ort.OrtValue | None = None
        self._input, self._output = self._ends()
        self._channels_last, self._fixed_size = self._layout()
        self._wanted_size = (config.input_width, config.input_height)
        self._short_side, self._multiple = short_side, multiple
        self._check_wanted_size()

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the width and height of the input for a picture of this size."""
        if all(self._wanted_size):
            return self._wanted_size
        if all(self._fixed_size):
            return self._fixed_size
        free = lower_bound_size(width, height, self._short_side, self._multiple)
        return self._fixed_size[0] or free[0], self._fixed_size[1] or free[1]

    def run(self, planes: np.ndarray) -> np.ndarray:
        """Run on (3, H, W) float32; return the output (h, w) as the network's own type."""
        tensor = planes[None].astype(_INPUT_TYPES[self._input.type], copy=False)
        if self._channels_last:
            tensor = np.ascontiguousarray(tensor.transpose(0, 2, 3, 1))
        try:
            raw = self._run_stoppably(tensor)
        except Exception as error:  # those of onnxruntime have no base class of their own
            raise_if_stopped()
            raise ProviderError(f'an input of shape {tensor.shape} fails, {_short(error)}. '
                                 f'The network has {self._ends_text()}') from error
        image = raw.squeeze()
        if image.ndim != 2:
            raise self._misfit(f'its output is {raw.shape}, which is not one image')
        return image

    def _run_stoppably(self, tensor: np.ndarray) -> np.ndarray:
        """Run until the end or the stop that applies; ONNX Runtime heeds it between operators."""
        options = ort.RunOptions()
        options.log_severity_level = 4  # what fails is told by the exception
        with current_stop().calling(lambda: setattr(options, 'terminate', True)):
            if self._device:
                return self._run_bound(tensor, options)
            return self._session.run([self._output.name], {self._input.name: tensor}, options)[0]

    def _run_bound(self, tensor: np.ndarray, options: ort.RunOptions) -> np.ndarray:
        """Run with input and output in the accelerator's memory, the input's kept for the next."""
        kept = self._input_on_device
        if kept is not None and tuple(kept.shape()) == tensor.shape:
            kept.update_inplace(tensor)
        else:
            kept = ort.OrtValue.ortvalue_from_numpy(tensor, self._device, 0)
            self._input_on_device = kept
        binding = self._session.io_binding()
        binding.bind_ortvalue_input(self._input.name, kept)
        binding.bind_output(self._output.name, self._device, 0)
        self._session.run_with_iobinding(binding, options)
        return binding.copy_outputs_to_cpu()[0]

    def _ends(self) -> tuple[ort.NodeArg, ort.NodeArg]:
        """Return the input that takes the picture and the output that is the depth."""
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if len(inputs) != 1 or inputs[0].type not in _INPUT_TYPES:
            raise self._misfit('it must have one input, of float32 or float16')
        if len(outputs) > 1:
            outputs = [o for o in outputs if any(k in o.name.lower() for k in ('depth', 'disp'))]
        if len(outputs) != 1:
            raise self._misfit('it must have one output, or one with depth or disp in its name')
        return inputs[0], outputs[0]

    def _layout(self) -> tuple[bool, tuple[int, int]]:
        """Return whether channels come last, and the fixed width and height, 0 where free."""
        shape = [side if isinstance(side, int) and side > 0 else 0 for side in self._input.shape]
        if len(shape) == 4 and shape[0] in (0, 1):
            if shape[1] != 3 and shape[3] == 3:
                return True, (shape[2], shape[1])
            if shape[1] in (0, 3):
                return False, (shape[3], shape[2])
        raise self._misfit('its input must be one RGB picture, [1, 3, H, W] or [1, H, W, 3]')

    def _check_wanted_size(self) -> None:
        if any(self._wanted_size):
            if any(fixed not in (0, wanted) for fixed, wanted in
                   zip(self._fixed_size, self._wanted_size, strict=True)):
                raise self._misfit('its input has another fixed size than depth.input_width x '
                                   f'depth.input_height, {self._wanted_size}')
            if any(wanted % self._multiple for fixed, wanted in
                   zip(self._fixed_size, self._wanted_size, strict=True) if not fixed):
                raise ValueError(f'depth.input_width and depth.input_height, {self._wanted_size},'
                                 f' must be multiples of depth.side_multiple, {self._multiple}')
        elif not all(self._fixed_size) and not self._short_side:
            raise self._misfit('the size of its input is free: set depth.short_side, or '
                               'depth.input_width and depth.input_height')

    def _misfit(self, what: str) -> ValueError:
        return ValueError(f'{self._path} does not fit: {what}. It has {self._ends_text()}')

    def _ends_text(self) -> str:
        def text(ends: list[ort.NodeArg]) -> str:
            return ', '.join(f'{end.name} {end.type} {end.shape}' for end in ends)
        return (f'inputs: {text(self._session.get_inputs())}; '
                f'outputs: {text(self._session.get_outputs())}')


def _load(path: Path, provider: str, threads: int) -> ort.InferenceSession:
    """Load a network for one provider; the CPU does what the provider has no kernels for."""
    if provider not in ort.get_available_providers():
        raise ProviderError('not in this build of ONNX Runtime')
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.use_deterministic_compute = True
    # Else the threads look for work long after each picture, on the cores of the stages to come.
    options.add_session_config_entry('session.force_spinning_stop', '1')
    options.log_severity_level = 3  # exported networks are full of harmless warnings
    providers = list(dict.fromkeys([provider, 'CPUExecutionProvider']))
    try:
        with current_stop().calling(lambda: options.set_load_cancellation_flag(True)):
            session = ort.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # those of onnxruntime have no base class of their own
        raise_if_stopped()
        raise ProviderError(_short(error)) from error
    # ONNX Runtime leaves a provider out without an error when its libraries are missing.
    if session.get_providers()[0] != provider:
        raise ProviderError('its libraries or its device are missing')
    session.disable_fallback()
    return session


def _short(error: Exception) -> str:
    return str(error).strip().split('\n')[0][:300]

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One session of ONNX Runtime; the only module that imports onnxruntime."""

from __future__ import annotations

import ctypes
from contextlib import redirect_stdout
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from io import StringIO
from pathlib import Path

import numpy as np
import onnxruntime as ort

from plane_detector._runtime.stopping import current_stop, raise_if_stopped
from plane_detector.config import DepthConfig
from plane_detector.depth.networks import Network
from plane_detector.depth.preprocessing import lower_bound_size

_NUMBERS = {f'tensor({name})' for name in (
    'float16', 'float', 'double', 'bool', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32',
    'int64', 'uint64')}
_INPUT_TYPES = {'tensor(float)': np.float32, 'tensor(float16)': np.float16,
                'tensor(uint8)': np.uint8}
# In smaller inputs a network cannot recognise anything, nor the checkerboard of the corridor.
MIN_SIDE_PX = 64
RUNTIME = f'ONNX Runtime {ort.__version__}'
ON_CUDA = 'CUDAExecutionProvider'
# By default CUDA tries every algorithm for each convolution, which stops the stream for up to a
# second whenever the input has a new size; the one that cuDNN predicts is about as fast. Memory
# grows by the required amount instead of by powers of two.
_CUDA_SETTINGS = {'cudnn_conv_algo_search': 'HEURISTIC',
                  'arena_extend_strategy': 'kSameAsRequested'}
# Parts of the messages of ONNX Runtime, CUDA and cuDNN if the GPU has not enough memory.
_NO_MEMORY = ('allocate memory', 'smaller than requested', 'out of memory', 'ALLOC_FAILED')
_LIBRARIES = {ON_CUDA: 'cuda', 'TensorrtExecutionProvider': 'tensorrt'}
_GPU_PACKAGE = "pip install 'onnxruntime-gpu[cuda,cudnn]'"


def available_providers() -> tuple[str, ...]:
    """Return the execution providers of this ONNX Runtime that run on this machine."""
    return tuple(p for p in ort.get_available_providers() if p != 'AzureExecutionProvider')


class ProviderError(ValueError):
    """An execution provider is missing or cannot run the network."""


def check_provider(provider: str) -> None:
    """Raise ProviderError, with the remedy, unless this ONNX Runtime can load the provider."""
    if provider not in ort.get_all_providers():
        raise ProviderError('ONNX Runtime knows no provider of this name; it has '
                            f'{" and ".join(available_providers())}')
    if provider not in ort.get_available_providers():
        if _is_installed('onnxruntime') and _is_installed('onnxruntime-gpu'):
            raise ProviderError(
                'onnxruntime and onnxruntime-gpu are both installed and share their files: pip '
                f'uninstall onnxruntime onnxruntime-gpu, then {_GPU_PACKAGE}')
        remedy = (f'pip uninstall onnxruntime, then {_GPU_PACKAGE}'
                  if provider in _LIBRARIES else 'install the package that has it')
        raise ProviderError(f'not in this build of ONNX Runtime: {remedy}')
    if reason := _missing_library(provider):
        raise ProviderError(reason)


@cache
def _missing_library(provider: str) -> str:
    """Load the libraries of a provider; return which one is missing, or nothing."""
    if provider not in _LIBRARIES:
        return ''
    # NVIDIA's wheels are in site-packages, where the loader does not search by itself.
    if hasattr(ort, 'preload_dlls'):
        with redirect_stdout(StringIO()):  # it prints what is missing; so does our message
            ort.preload_dlls()
    folder = Path(ort.__file__).parent / 'capi'
    try:
        for name in ('shared', _LIBRARIES[provider]):
            library = folder / f'libonnxruntime_providers_{name}.so'
            if library.is_file():  # else it is linked into ONNX Runtime
                ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    except OSError as error:
        said = _short(error)
        if said.startswith('libcuda.'):
            return f'{said}: install the driver of the GPU (nvidia-smi shows it)'
        package = 'pip install tensorrt' if said.startswith('libnvinfer') else _GPU_PACKAGE
        return f'{said}: {package}, or put its folder on LD_LIBRARY_PATH'
    return ''


def _is_installed(package: str) -> bool:
    """Return whether pip has installed a package."""
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


class OnnxSession:
    """
    One ONNX Runtime session that takes (3, H, W) float32 and returns arrays.

    It loads the content if given, else the file. The network states what the file does not: other
    inputs, required outputs, the input size. The settings give the threads and the memory.

    Raises
    ------
    ValueError
        The network's inputs or outputs, or their sizes, differ from those required.
    ProviderError
        The execution provider cannot run the network.

    """

    def __init__(self, path: Path, content: bytes | None, provider: str, config: DepthConfig,
                 network: Network) -> None:
        self._session = _load(str(path) if content is None else content, provider, config)
        self._path, self._config = path, config
        self._network = network
        self._input = self._image_input()
        self._scalars = self._scalar_inputs()
        self._outputs = self._wanted_outputs()
        self._channels_last, self._fixed_size = self._layout()
        if not (all(network.input_size) or all(self._fixed_size) or network.short_side):
            raise self.misfit('its input may have any size: set depth.short_side')

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the width and height of the input for an image of this size."""
        if all(self._network.input_size):
            return self._network.input_size
        if all(self._fixed_size):
            return self._fixed_size
        free = lower_bound_size(width, height, self._network.short_side,
                                self._network.side_multiple)
        return self._fixed_size[0] or free[0], self._fixed_size[1] or free[1]

    def run(self, planes: np.ndarray) -> list[np.ndarray]:
        """Run on (3, H, W) float32, to the end or to a stop; return the required outputs."""
        dtype = _INPUT_TYPES[self._input.type]
        if dtype == np.uint8:  # cubic interpolation overshoots
            planes = np.clip(np.rint(planes), 0, 255)
        tensor = planes[None].astype(dtype, copy=False)
        if self._channels_last:
            tensor = np.ascontiguousarray(tensor.transpose(0, 2, 3, 1))
        if len(self._input.shape) == 5:
            tensor = tensor[None]
        options = ort.RunOptions()
        options.log_severity_level = 4  # the exception reports errors
        try:
            # ONNX Runtime looks at this flag between two operators.
            with current_stop().calling(lambda: setattr(options, 'terminate', True)):
                arrays = self._run({self._input.name: tensor, **self._scalars}, options)
        except Exception as error:  # onnxruntime's exceptions have no common base class
            raise_if_stopped()
            if said := _lack_of_memory(error, self._config):
                raise ProviderError(f'an input of shape {tensor.shape} needs more memory: '
                                    f'{said}') from error
            raise ProviderError(f'an input of shape {tensor.shape} fails, {_short(error)}. '
                                f'The network has {self._ends_text()}') from error
        for name, array in zip(self._outputs, arrays, strict=True):
            if array.size == 0:
                raise self.misfit(f'its output {name} is {array.shape}, which is empty')
        return arrays

    def _run(self, inputs: dict[str, np.ndarray], options: ort.RunOptions) -> list[np.ndarray]:
        """Run with outputs kept on the device until all are computed: .5 ms less on an H100."""
        if self._session.get_providers()[0] != ON_CUDA:
            return self._session.run(self._outputs, inputs, options)
        binding = self._session.io_binding()
        for name, array in inputs.items():
            binding.bind_cpu_input(name, array)
        for name in self._outputs:
            binding.bind_output(name, 'cuda')
        self._session.run_with_iobinding(binding, options)
        return binding.copy_outputs_to_cpu()

    def _image_input(self) -> ort.NodeArg:
        """Return the input for the image."""
        images = [end for end in self._session.get_inputs()
                  if end.name not in self._network.scalars]
        if len(images) != 1 or images[0].type not in _INPUT_TYPES:
            beside = ' and '.join(['', *self._network.scalars])
            raise self.misfit(f'it must have one input{beside}, of float32, float16 '
                              'or uint8')
        recipe = self._network.recipe
        if images[0].type == 'tensor(uint8)' and (
                recipe.scale, *recipe.mean, *recipe.std) != (1, 0, 0, 0, 1, 1, 1):
            raise self.misfit('it takes bytes as they are: set depth.input_scale 1, depth.mean '
                              '[0, 0, 0] and depth.std [1, 1, 1]')
        return images[0]

    def _scalar_inputs(self) -> dict[str, np.ndarray]:
        """Return the arrays of the inputs besides the image."""
        found = {end.name: end for end in self._session.get_inputs()}
        arrays = {}
        for name, value in self._network.scalars.items():
            if name not in found or found[name].type != 'tensor(int64)':
                raise self.misfit(f'it must have an input {name} of int64')
            arrays[name] = np.full([1] * len(found[name].shape), value, np.int64)
        return arrays

    def _wanted_outputs(self) -> list[str]:
        """Return the names of the required outputs, or of the one that is the depth."""
        outputs = {end.name: end for end in self._session.get_outputs()}
        names = list(self._network.outputs.names)
        if missing := [name for name in names if name not in outputs]:
            raise self.misfit(f'it must have an output {" and ".join(missing)}')
        if not names:
            names = list(outputs) if len(outputs) == 1 else [
                name for name in outputs if 'depth' in name.lower() or 'disp' in name.lower()]
            if len(names) != 1:
                raise self.misfit('it must have one output, or one with depth or disp in its name')
        for name in names:
            if outputs[name].type not in _NUMBERS:
                raise self.misfit(f'its output {name} must be a tensor of numbers')
            if 0 in outputs[name].shape:
                raise self.misfit(f'its output {name} is empty')
        return names

    def _layout(self) -> tuple[bool, tuple[int, int]]:
        """Return whether channels come last, and the fixed width and height, 0 if free."""
        shape = [side if isinstance(side, int) and side > 0 else 0 for side in self._input.shape]
        if len(shape) == 5 and shape[0] in (0, 1):  # one scene of any number of images
            shape = shape[1:]
        if len(shape) == 4 and shape[0] in (0, 1):
            if shape[1] != 3 and shape[3] == 3:
                return True, (shape[2], shape[1])
            if shape[1] in (0, 3):
                return False, (shape[3], shape[2])
        raise self.misfit('its input must be one RGB image, [1, 3, H, W], [1, H, W, 3] or '
                          '[1, 1, 3, H, W]')

    def misfit(self, what: str) -> ValueError:
        """Return an error with the file, the mismatch, and the interface of the file."""
        return ValueError(f'{self._path} does not fit: {what}. It has {self._ends_text()}')

    def _ends_text(self) -> str:
        def text(ends: list[ort.NodeArg]) -> str:
            return ', '.join(f'{end.name} {end.type} {end.shape}' for end in ends)
        return (f'inputs: {text(self._session.get_inputs())}; '
                f'outputs: {text(self._session.get_outputs())}')


def _load(file: str | bytes, provider: str, config: DepthConfig) -> ort.InferenceSession:
    """Load a network for one provider; operators that it lacks run on the CPU."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = config.threads
    options.use_deterministic_compute = True
    # Otherwise threads spin while they wait for each other or for the next image, and take cores
    # from the other stages: 15 ms of core time for fastdepth instead of 8.
    options.add_session_config_entry('session.intra_op.allow_spinning', '0')
    options.log_severity_level = 3  # exported networks cause many harmless warnings
    providers = list(dict.fromkeys([provider, 'CPUExecutionProvider']))
    try:
        with current_stop().calling(lambda: options.set_load_cancellation_flag(True)):
            session = ort.InferenceSession(
                file, options, providers=providers, enable_fallback=0,
                provider_options=[_settings(name, config) for name in providers])
    except Exception as error:  # onnxruntime's exceptions have no common base class
        raise_if_stopped()
        raise ProviderError(_lack_of_memory(error, config) or _short(error)) from error
    # ONNX Runtime silently skips a provider that it cannot set up.
    if session.get_providers()[0] != provider:
        raise ProviderError('its libraries are there, but ONNX Runtime cannot set it up: is the '
                            'device there (nvidia-smi), and new enough its driver?')
    session.disable_fallback()
    session._model_bytes = None  # else it keeps the file in memory; no public name for it
    return session


def _settings(provider: str, config: DepthConfig) -> dict[str, str]:
    """Return the settings of a provider; by default CUDA may use all memory."""
    if provider != ON_CUDA:
        return {}
    return {**_CUDA_SETTINGS, 'gpu_mem_limit': str(round(config.gpu_memory * 2**30))}


def _lack_of_memory(error: Exception, config: DepthConfig) -> str:
    """Return what to do if an error says that the GPU has not enough memory, else nothing."""
    if not any(sign in str(error) for sign in _NO_MEMORY):
        return ''
    return (f'the GPU has none left (nvidia-smi shows it), or depth.gpu_memory, now '
            f'{config.gpu_memory:g} GiB, is too small: increase it, or reduce depth.short_side')


def _short(error: Exception) -> str:
    return str(error).strip().split('\n')[0][:300]

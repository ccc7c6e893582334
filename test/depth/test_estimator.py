# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_models import (
    PLAIN,
    constant,
    millimetres_as_rgb,
    write_depth_network,
    write_network,
)
from slow_networks import HEIGHT, WIDTH, write_slow_network

from plane_detector._runtime.stopping import Background, Stopped
from plane_detector.config import DepthConfig
from plane_detector.depth import estimator, onnx_session
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.networks import NETWORKS, default_cache_dir
from plane_detector.depth.onnx_session import ProviderError, check_provider
from plane_detector.evaluation.datasets import frames

onnx = pytest.importorskip('onnx', reason='onnx, of the extra "test", is not installed')
helper, FLOAT = onnx.helper, onnx.TensorProto.FLOAT


def config_for(path, **changes):
    return DepthConfig(**{'model': str(path), 'output': 'metric_depth', **PLAIN, **changes})


def wavy_depth(height=48, width=64):
    row, column = np.mgrid[:height, :width]
    return np.round(2.0 + 0.02 * column + 0.5 * np.sin(row / 7), 3).astype(np.float32)


@pytest.mark.parametrize('channels_last', [False, True])
@pytest.mark.parametrize('dtype', [np.float32, np.float16])
@pytest.mark.parametrize('fixed', [False, True])
def test_every_layout_and_type_gives_the_depth(tmp_path, channels_last, dtype, fixed):
    depth_m = wavy_depth()
    sides = {'height': 48, 'width': 64} if fixed else {}
    path = write_depth_network(tmp_path / 'n.onnx', channels_last=channels_last, dtype=dtype,
                               **sides)
    changes = {} if fixed else {'short_side': 48, 'side_multiple': 16}
    estimate = DepthEstimator(config_for(path, **changes))
    assert estimate.input_size(64, 48) == (64, 48)
    found = estimate(millimetres_as_rgb(depth_m))
    assert found.shape == (48, 64)
    assert found.dtype == np.float32
    tolerance = 1e-5 if dtype == np.float32 else 2e-3
    np.testing.assert_allclose(found, depth_m, rtol=tolerance)
    assert estimate(millimetres_as_rgb(np.full((90, 120), 2.56))).shape == (90, 120)


def test_scale_mean_and_std_are_applied(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=4, width=4, weights=(1, 10, 100))
    estimate = DepthEstimator(config_for(path, input_scale=0.5, mean=(1.0, 2.0, 3.0),
                                         std=(2.0, 4.0, 5.0), max_depth=1000.0))
    found = estimate(np.full((4, 4, 3), (10, 20, 30), np.uint8))
    np.testing.assert_allclose(found, (5 - 1) / 2 + 10 * (10 - 2) / 4 + 100 * (15 - 3) / 5)


def test_a_free_size_follows_the_short_side(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx')
    assert DepthEstimator(config_for(path, short_side=252)).input_size(640, 480) == (336, 252)
    half_free = write_depth_network(tmp_path / 'h.onnx', height=28)
    assert DepthEstimator(config_for(half_free, short_side=28)).input_size(64, 48) == (42, 28)


def test_providers_are_tried_in_order_and_the_one_in_use_is_reported(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=4, width=4)
    estimate = DepthEstimator(config_for(
        path, providers=('NoSuchExecutionProvider', 'CPUExecutionProvider'), threads=1))
    assert estimate.provider == 'CPUExecutionProvider'
    assert 'NoSuchExecutionProvider does not run: ONNX Runtime knows no' in estimate.reason
    assert 'runs on CPUExecutionProvider' in estimate.reason
    with pytest.raises(ValueError, match='no execution provider.*NoSuch.*CPUExecutionProvider'):
        DepthEstimator(config_for(path, providers=('NoSuchExecutionProvider',)))
    assert (estimate.name, estimate.noise_share, estimate.focal_per_height) == (
        str(path), 0.0, 0.0)
    with pytest.raises(ValueError, match=r'depth\.output must state'):
        DepthEstimator(config_for(path, output='auto'))


def test_an_installed_gpu_provider_that_is_not_used_is_named(tmp_path, monkeypatch):
    path = write_depth_network(tmp_path / 'n.onnx', height=4, width=4)
    assert 'depth.providers' not in DepthEstimator(config_for(path)).reason
    monkeypatch.setattr(onnx_session.ort, 'get_available_providers',
                        lambda: ['CUDAExecutionProvider', 'CPUExecutionProvider'])
    assert DepthEstimator(config_for(path)).reason.endswith(
        'depth.providers may name CUDAExecutionProvider, which is installed')


def test_what_a_provider_lacks_is_named(tmp_path, monkeypatch):
    with pytest.raises(ProviderError, match=r'not in this build.*onnxruntime-gpu\[cuda,cudnn\]'):
        check_provider('CUDAExecutionProvider')
    monkeypatch.setattr(onnx_session, '_is_installed', lambda package: True)
    with pytest.raises(ProviderError, match='both installed.*uninstall onnxruntime onnxr'):
        check_provider('CUDAExecutionProvider')
    # A build for a GPU whose library needs another one that is not there.
    monkeypatch.setattr(onnx_session.ort, 'get_available_providers',
                        lambda: ['CUDAExecutionProvider', 'TensorrtExecutionProvider'])
    monkeypatch.setattr(onnx_session.ort, '__file__', str(tmp_path / '__init__.py'))
    (tmp_path / 'capi').mkdir()
    for name in ('cuda', 'tensorrt'):
        (tmp_path / 'capi' / f'libonnxruntime_providers_{name}.so').touch()
    for missing, provider, remedy in (
            ('libcublasLt.so.13', 'CUDA', r'pip install .onnxruntime-gpu\['),
            ('libcuda.so.1', 'CUDA', 'driver'),
            ('libnvinfer.so.10', 'Tensorrt', 'pip install tensorrt')):
        def load(path, mode, missing=missing):
            raise OSError(f'{missing}: cannot open shared object file: No such file or directory')
        monkeypatch.setattr(onnx_session.ctypes, 'CDLL', load)
        onnx_session._missing_library.cache_clear()
        with pytest.raises(ProviderError, match=f'{missing}: cannot open.*{remedy}'):
            check_provider(f'{provider}ExecutionProvider')
    onnx_session._missing_library.cache_clear()


class OnGpu:
    """A session on the CPU that says that it is on a GPU, and fails if it is told to."""

    def __init__(self, make, error):
        self.make, self.error, self.settings, self.on_device = make, error, {}, []

    def __call__(self, file, options, *, providers, provider_options, enable_fallback):
        self.settings = dict(zip(providers, provider_options, strict=True))
        self.session = self.make(file, options, providers=['CPUExecutionProvider'])
        return self

    def __getattr__(self, name):
        return getattr(self.session, name)

    def get_providers(self):
        return ['CUDAExecutionProvider', 'CPUExecutionProvider']

    def io_binding(self):
        binding = self.session.io_binding()
        bind_output = binding.bind_output

        def bind_to_device(name, device):
            self.on_device.append(device)
            bind_output(name)
        binding.bind_output = bind_to_device
        return binding

    def run_with_iobinding(self, binding, options):
        if self.error:
            raise RuntimeError(self.error)
        self.session.run_with_iobinding(binding, options)


@pytest.fixture
def on_gpu(monkeypatch):
    session = OnGpu(onnx_session.ort.InferenceSession, '')
    monkeypatch.setattr(estimator, 'check_provider', lambda provider: None)
    monkeypatch.setattr(onnx_session.ort, 'InferenceSession', session)
    return session


def test_a_gpu_gives_the_depth_and_its_memory_is_limited(tmp_path, on_gpu):
    path, depth_m = write_depth_network(tmp_path / 'n.onnx', height=48, width=64), wavy_depth()
    estimate = DepthEstimator(config_for(path, providers=('CUDAExecutionProvider',),
                                         gpu_memory=1.5))
    assert estimate.provider == 'CUDAExecutionProvider'
    np.testing.assert_allclose(estimate(millimetres_as_rgb(depth_m)), depth_m, rtol=1e-5)
    assert set(on_gpu.on_device) == {'cuda'}
    assert on_gpu.settings['CUDAExecutionProvider']['gpu_mem_limit'] == str(3 << 29)
    assert not on_gpu.settings['CPUExecutionProvider']


@pytest.mark.parametrize('said', [
    '[ONNXRuntimeError] : 6 : RUNTIME_EXCEPTION : Non-zero status code returned while running Mul '
    'node. Name:"Mul_8702" Status Message: ' + '/onnxruntime/core/framework/' * 9 + 'bfc_arena.cc:'
    '368 Failed to allocate memory for requested buffer of size 2830172160',
    'Available memory of 0 is smaller than requested bytes of 2830172160',
    'CUDA failure 2: out of memory ; GPU=0 ; hostname=robot',
    'CUDNN failure 4: CUDNN_STATUS_ALLOC_FAILED'])
def test_a_gpu_without_memory_is_named_with_what_to_do(tmp_path, on_gpu, said):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64)
    wanted = r'needs more memory.*nvidia-smi.*depth\.gpu_memory, now 4 GiB.*depth\.short_side'
    estimate = DepthEstimator(config_for(path, providers=('CUDAExecutionProvider',)))
    on_gpu.error = said
    with pytest.raises(ValueError, match=wanted):
        estimate(millimetres_as_rgb(wavy_depth()))
    # When the node is configured, the next provider takes over, and the reason is stated.
    with pytest.raises(ValueError, match=f'CUDAExecutionProvider does not run: .*{wanted}'):
        DepthEstimator(config_for(path, providers=('CUDAExecutionProvider',)))
    on_gpu.error = 'CUDA failure 700: an illegal memory access was encountered'
    with pytest.raises(ValueError, match='fails, CUDA failure 700'):
        estimate(millimetres_as_rgb(wavy_depth()))


def test_a_file_that_is_not_a_network_is_refused(tmp_path):
    damaged = np.frombuffer(write_depth_network(tmp_path / 'n.onnx').read_bytes(), np.uint8).copy()
    damaged[np.random.default_rng(0).integers(len(damaged), size=20)] ^= 0x55
    for content, said in ((b'not a network', r'n\.onnx is not a complete ONNX file'),
                          (b'\x08\x08', r'no execution provider runs .*n\.onnx'),
                          (damaged.tobytes(), r'n\.onnx')):
        (tmp_path / 'n.onnx').write_bytes(content)
        with pytest.raises(ValueError, match=said):
            DepthEstimator(config_for(tmp_path / 'n.onnx'))


def test_a_free_size_must_be_chosen(tmp_path):
    free = write_depth_network(tmp_path / 'f.onnx')
    with pytest.raises(ValueError, match=r'may have any size: set depth\.short_side'):
        DepthEstimator(config_for(free))


def identity(path, shape, element=FLOAT, extra_input=False):
    nodes = [helper.make_node('Identity', ['a'], ['b'])]
    inputs = [('a', element, shape)] + ([('a2', element, shape)] if extra_input else [])
    return write_network(path, nodes, inputs, [('b', element, shape)])


@pytest.mark.parametrize(('shape', 'changes', 'said'), [
    ([1, 3, 8, 8], {'extra_input': True}, 'must have one input'),
    ([1, 3, 8, 8], {'element': onnx.TensorProto.INT8}, 'must have one input, of float32'),
    ([1, 3, 8, 8], {'element': onnx.TensorProto.UINT8}, 'takes bytes as they are'),
    ([1, 1, 8, 8], {}, 'must be one RGB image'),
    ([2, 3, 8, 8], {}, 'must be one RGB image'),
    ([3, 8, 8], {}, 'must be one RGB image'),
    ([1, 3, 8, 8], {}, r'\(1, 3, 8, 8\), which is not one image')])
def test_a_misfit_is_reported_with_inputs_and_outputs(tmp_path, shape, changes, said):
    path = identity(tmp_path / 'n.onnx', shape, **changes)
    with pytest.raises(ValueError, match=f'does not fit: .*{said}.*inputs: a .*outputs: b '):
        DepthEstimator(config_for(path))


def test_an_empty_output_is_refused(tmp_path):
    path = write_network(
        tmp_path / 'n.onnx', [helper.make_node('Slice', ['image', 'no', 'no', 'axis'], ['depth'])],
        [('image', FLOAT, [1, 3, 8, 8])], [('depth', FLOAT, [1, 0, 8, 8])],
        [constant('no', [0], np.int64), constant('axis', [1], np.int64)])
    with pytest.raises(ValueError, match='its output depth is empty'):
        DepthEstimator(config_for(path))


def test_of_several_outputs_the_one_named_depth_is_taken(tmp_path):
    def network(names):
        nodes = [helper.make_node('ReduceMean', ['image'], [name], axes=[1], keepdims=k)
                 for k, name in enumerate(names)]
        return write_network(tmp_path / 'n.onnx', nodes, [('image', FLOAT, [1, 3, 4, 4])],
                             [(names[0], FLOAT, [1, 4, 4]), (names[1], FLOAT, [1, 1, 4, 4])])

    estimate = DepthEstimator(config_for(network(['confidence', 'predicted_depth'])))
    np.testing.assert_allclose(estimate(np.full((4, 4, 3), 255, np.uint8)), 1.0)
    with pytest.raises(ValueError, match='one output.*outputs: first .*second'):
        DepthEstimator(config_for(network(['first', 'second'])))


@pytest.mark.parametrize('rgb', [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8),
                                 np.zeros((4, 4, 3), np.float32), np.zeros((0, 4, 3), np.uint8)])
def test_invalid_images_are_refused(tmp_path, rgb):
    path = write_depth_network(tmp_path / 'n.onnx', height=4, width=4)
    with pytest.raises(ValueError, match=r'must be \(H, W, 3\) uint8'):
        DepthEstimator(config_for(path))(rgb)


def test_fastdepth_is_right_to_a_fifth_on_real_images(data_folder):
    if not (default_cache_dir() / NETWORKS['fastdepth'].file_name).is_file():
        pytest.skip('fastdepth is not in the cache')
    estimate = DepthEstimator(DepthConfig(model='fastdepth'))
    for frame in frames(data_folder, ('nyu',)):
        truth = frame.depth_m[24:-24, 32:-32]
        found = estimate(frame.rgb)[24:-24, 32:-32]
        assert np.mean(np.abs(found - truth)[truth > 0.3] / truth[truth > 0.3]) < 0.2


def test_inference_and_the_warm_up_end_between_two_operators(tmp_path):
    bright = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    estimator = DepthEstimator(config_for(write_slow_network(tmp_path / 'slow.onnx')))
    always = write_slow_network(tmp_path / 'always.onnx', always=True)
    for work in (lambda: estimator(bright), lambda: DepthEstimator(config_for(always))):
        call = Background(work, 'network')
        assert not call.wait(0.5)
        call.stop.set()
        assert call.wait(20.0)
        with pytest.raises(Stopped):
            call.result()
    assert np.isfinite(estimator(bright // 4)).all(), 'it can be used again'

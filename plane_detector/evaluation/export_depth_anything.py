# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Export of the architecture of Depth Anything V2 Small with random weights.

Used if the original weights are not available: it shows that their shapes work with the package
and measures their time. Its depth is meaningless. Needs the development extra ``export``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from unittest import mock

import numpy as np

_TRACED_SIZE = (252, 336)
_CHECKED_SIZES = ((252, 336), (392, 518), (518, 518))


def build(seed: int):
    """
    Return a torch module from (1, 3, H, W) to (1, H, W) with random weights.

    The sizes are those of the published Small model: a DINOv2 ViT-S/14 backbone, tapped after
    blocks 3, 6, 9 and 12, and a DPT head of width 64; 24.8 million parameters.
    """
    import torch
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, Dinov2Config

    backbone = Dinov2Config(
        hidden_size=384, num_attention_heads=6, num_hidden_layers=12, image_size=518,
        patch_size=14, out_features=['stage3', 'stage6', 'stage9', 'stage12'],
        apply_layernorm=True, reshape_hidden_states=False)
    config = DepthAnythingConfig(
        backbone_config=backbone, patch_size=14, reassemble_hidden_size=384,
        neck_hidden_sizes=[48, 96, 192, 384], fusion_hidden_size=64, head_hidden_size=32)

    class DepthOnly(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = DepthAnythingForDepthEstimation(config)

        def forward(self, image):
            return self.model(image).predicted_depth

    torch.manual_seed(seed)
    return DepthOnly().eval()


def export(model, path: Path) -> None:
    """Write the module as one ONNX file for inputs of any size, like the files of the zoo."""
    import torch
    from transformers.models.depth_anything import modeling_depth_anything

    # The head calls int() on the size of its output, which would fix it to that of the trace.
    with mock.patch.object(modeling_depth_anything, 'int', lambda side: side, create=True):
        torch.onnx.export(
            model, (torch.zeros(1, 3, *_TRACED_SIZE),), str(path),
            input_names=['image'], output_names=['depth'], opset_version=17,
            dynamic_axes={'image': {2: 'height', 3: 'width'}, 'depth': {1: 'height', 2: 'width'}},
            dynamo=False)  # by tracing, a fifth faster at run time than torch.export


def largest_difference(model, path: Path, size: tuple[int, int]) -> float:
    """
    Return the largest difference between torch and ONNX at (height, width), relative to the
    maximum.

    The image is processed by `plane_detector.depth.estimator.DepthEstimator`.
    """
    import torch

    from plane_detector.config import DepthConfig
    from plane_detector.depth.estimator import DepthEstimator
    from plane_detector.depth.preprocessing import InputRecipe, prepare_input

    config = DepthConfig(model=str(path), output='relative_disparity', short_side=min(size))
    rgb = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    recipe = InputRecipe(config.input_scale, config.mean, config.std)
    with torch.no_grad():
        planes = torch.from_numpy(prepare_input(rgb, size[::-1], recipe))
        expected = model(planes[None])[0].numpy()
    found = np.nan_to_num(DepthEstimator(config)(rgb))  # the network's zeros are invalid
    return float(np.abs(found - expected).max() / expected.max())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('path', type=Path, help='the .onnx file to write')
    parser.add_argument('--seed', type=int, default=0, help='of the random weights')


def run(options: argparse.Namespace) -> None:
    """Export the network, then compare it with torch at several sizes."""
    try:
        model = build(options.seed)
    except ImportError as error:
        raise ImportError(f'{error}: install the extra, plane_detector[export]') from error
    parameters = sum(parameter.numel() for parameter in model.parameters())
    print(f'Depth Anything V2 Small, {parameters / 1e6:.2f} million random weights')
    export(model, options.path)
    print(f'{options.path}: {options.path.stat().st_size} bytes')
    for size in _CHECKED_SIZES:
        difference = largest_difference(model, options.path, size)
        print(f'{size[1]} x {size[0]}: largest difference from torch {difference:.1e}')

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Noise for the exact depth of rendered scenes."""

from __future__ import annotations

import cv2
import numpy as np


def with_disparity_noise(depth_m: np.ndarray, sigma: float, rng: np.random.Generator,
                         smooth_share: float = 0.5, correlation_px: float = 12.0) -> np.ndarray:
    """
    Add noise of constant standard deviation to 1/depth, as in stereo and depth networks.

    A share of the variance is smooth over the image, with a Gaussian blur of this many pixels; the
    rest is independent from pixel to pixel. The result is float32, NaN where the disparity would
    not be positive, and read-only, like all arrays of a scene.
    """
    grain, smooth = rng.standard_normal((2, *depth_m.shape)).astype(np.float32)
    smooth = cv2.GaussianBlur(smooth, (0, 0), correlation_px)
    smooth /= max(float(smooth.std()), 1e-12)
    disparity = 1.0 / depth_m + sigma * (
        np.sqrt(1.0 - smooth_share) * grain + np.sqrt(smooth_share) * smooth)
    with np.errstate(divide='ignore'):
        noisy_m = np.where(disparity > 0, 1.0 / disparity, np.nan).astype(np.float32)
    noisy_m.flags.writeable = False
    return noisy_m

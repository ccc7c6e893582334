# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Depth sensors, simulated on the exact depth of rendered scenes.

Each function takes depth in metres, the camera and a generator and returns what the sensor would
measure. The errors of the structured light were set so that residuals of its planes agree, octave
by octave, with those of real Kinect frames (docs/results.md); they are of the same size in
disparity from 0.8 to 3.8 m.

References
----------
K. Khoshelham, S. O. Elberink: Accuracy and Resolution of Kinect Depth Data for Indoor Mapping
Applications, Sensors 2012. C. V. Nguyen, S. Izadi, D. Lovell: Modeling Kinect Sensor Noise for
Improved 3D Reconstruction and Tracking, 3DIMPVT 2012. S. Choi, Q.-Y. Zhou, V. Koltun: Robust
Reconstruction of Indoor Scenes, CVPR 2015 (distortion fixed to the lens). J. T. Barron, J. Malik:
Intrinsic Scene Properties from a Single RGB-D Image, CVPR 2013 (shifted pixels). L. Keselman et
al.: Intel RealSense Stereoscopic Depth Cameras, CVPRW 2017. S. Foix, G. Alenya, C. Torras:
Lock-in Time-of-Flight Cameras: A Survey, IEEE Sensors 2011.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from plane_detector.types import CameraIntrinsics

KINECT_BASELINE_M, STEREO_BASELINE_M = 0.075, 0.05
_LENS_SEED = 7  # the distortion belongs to the lens: it is the same in all images

Sensor = Callable[[np.ndarray, CameraIntrinsics, np.random.Generator], np.ndarray]


def structured_light(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                     rng: np.random.Generator) -> np.ndarray:
    """Return depth of a Kinect: 1/8 px of disparity, shadows, ragged borders, a bent lens."""
    focal_baseline = intrinsics.fx * KINECT_BASELINE_M
    shadow = shadowed(depth_m, focal_baseline)
    shift_v, shift_u = np.rint(rng.normal(0, 0.7, (2, *depth_m.shape))).astype(int)
    v, u = np.indices(depth_m.shape)
    rows = np.clip(v + shift_v, 0, depth_m.shape[0] - 1)
    columns = np.clip(u + shift_u, 0, depth_m.shape[1] - 1)
    disparity = 1 / depth_m[rows, columns].astype(np.float64)
    disparity += lens_error(depth_m.shape, 0.0024)
    for blur_px, sigma in ((1.5, 0.0007), (5.0, 0.0011), (18.0, 0.0014)):
        disparity += sigma * smooth_field(depth_m.shape, blur_px, rng)
    step = 1 / (8 * focal_baseline)
    disparity = np.rint(disparity / step) * step
    return _depth(disparity, shadow | (depth_m > 8.0) | (depth_m < 0.4))


def active_stereo(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                  rng: np.random.Generator) -> np.ndarray:
    """Return depth of a D4xx: correlated errors of 0.08 px, fat borders, 1/32 px, millimetres."""
    focal_baseline = intrinsics.fx * STEREO_BASELINE_M
    shadow = shadowed(depth_m, focal_baseline)
    pixel = 1 / focal_baseline
    # A window behind a border matches the foreground. On a slope the sum is zero.
    exact = np.nan_to_num(1 / depth_m.astype(np.float64))
    nearest, farthest = (change(exact, np.ones((7, 7))) for change in (cv2.dilate, cv2.erode))
    disparity = np.where(nearest + farthest - 2 * exact > 0.5 * pixel, nearest, exact)
    disparity[np.isnan(depth_m)] = np.nan
    disparity += lens_error(depth_m.shape, 0.04 * pixel)
    for blur_px, sigma_px in ((2.0, 0.05), (6.0, 0.05), (20.0, 0.04)):
        disparity += sigma_px * pixel * smooth_field(depth_m.shape, blur_px, rng)
    disparity = np.rint(disparity * 32 / pixel) / 32 * pixel
    return rounded(_depth(disparity, shadow | (depth_m > 8.0)), 1e3)


def time_of_flight(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                   rng: np.random.Generator) -> np.ndarray:
    """Return depth of a lock-in camera: flying pixels, bulged corners, wiggling."""
    seen = np.isfinite(depth_m)
    exact_m = np.where(seen, depth_m, 0).astype(np.float64)
    nearest, farthest = (change(exact_m, np.ones((3, 3))) for change in (cv2.erode, cv2.dilate))
    at_border = farthest - nearest > 0.05 * exact_m
    # A pixel on a border mixes both surfaces, in any proportion.
    share = rng.random(depth_m.shape)
    is_flying = at_border & (rng.random(depth_m.shape) < 0.4)
    measured_m = np.where(is_flying, nearest + share * (farthest - nearest), exact_m)
    # Light also arrives via the other wall: near a concave corner both seem farther, by
    # centimetres.
    disparity = np.where(seen, 1 / np.maximum(exact_m, 1e-3), 0)
    bend = cv2.Laplacian(cv2.GaussianBlur(disparity, (0, 0), 2), cv2.CV_64F)
    concave = np.clip(np.where(at_border, 0, bend), 0, 0.002)
    concave[cv2.dilate(at_border.astype(np.uint8), np.ones((13, 13))) > 0] = 0
    measured_m += np.minimum(150 * cv2.GaussianBlur(concave, (0, 0), 25) * exact_m**2, 0.02)
    measured_m += 0.004 * np.sin(4 * np.pi * exact_m / 1.5)
    measured_m += lens_error(depth_m.shape, 0.002)
    # Noise is inversely proportional to the amplitude: it grows with distance, and toward the
    # border.
    v, u = np.indices(depth_m.shape)
    off_axis = np.hypot((u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy)
    sigma_m = 0.0007 * (1 + 0.4 * exact_m**2) * (1 + off_axis**2) ** 2
    noise = 0.8 * rng.standard_normal(depth_m.shape) + 0.6 * smooth_field(depth_m.shape, 2.0, rng)
    measured_m += sigma_m * noise
    return np.where(seen & (exact_m < 6.0), measured_m, np.nan).astype(np.float32)


def filled_eight_bit(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                     rng: np.random.Generator) -> np.ndarray:
    """Return depth of a Kinect with filled holes and invented borders, in steps of 6 to 14 mm."""
    raw_m = structured_light(depth_m, intrinsics, rng)
    filled_m = np.nan_to_num(raw_m)
    # Registration to the colour image loses the borders; they are filled as the holes are.
    low, high = (change(filled_m, np.ones((5, 5))) for change in (cv2.erode, cv2.dilate))
    seen = np.isfinite(raw_m) & (high - low < 0.06 * filled_m)
    filled_m = fill(np.where(seen, filled_m, 0), seen)
    step_m = np.clip((filled_m.max() - filled_m.min()) / 255, 0.006, 0.014)
    filled_m = step_m * np.rint(filled_m / step_m)
    return np.where(np.isfinite(depth_m), filled_m, np.nan).astype(np.float32)


def rounded(depth_m: np.ndarray, steps_per_m: float) -> np.ndarray:
    """Return depth in whole steps."""
    return (np.rint(depth_m * steps_per_m) / steps_per_m).astype(np.float32)


SENSORS: dict[str, Sensor] = {
    'structured light': structured_light, 'active stereo': active_stereo,
    'time of flight': time_of_flight, 'filled, 8 bit': filled_eight_bit,
    'whole mm': lambda depth_m, *_: rounded(depth_m, 1e3),
    'whole cm': lambda depth_m, *_: rounded(depth_m, 1e2)}


def smooth_field(shape: tuple[int, int], blur_px: float, rng: np.random.Generator) -> np.ndarray:
    """Return Gaussian noise (H, W) of deviation 1 and zero mean, blurred."""
    # Blurring at lower resolution is the same and quicker.
    factor = max(1, int(blur_px / 4))
    small = [-(-size // factor) + 8 for size in shape]
    field = cv2.GaussianBlur(rng.standard_normal(small), (0, 0), blur_px / factor)
    field = cv2.resize(field, (small[1] * factor, small[0] * factor),
                       interpolation=cv2.INTER_CUBIC)[:shape[0], :shape[1]]
    return (field - field.mean()) / field.std()


def lens_error(shape: tuple[int, int], sigma: float) -> np.ndarray:
    """Return the error of a lens (H, W): smooth over an eighth of the image."""
    return sigma * smooth_field(shape, shape[1] / 8, np.random.default_rng(_LENS_SEED))


def shadowed(depth_m: np.ndarray, focal_baseline: float) -> np.ndarray:
    """Return where the second eye or the projector, to the right, does not see, (H, W) bool."""
    column = np.arange(depth_m.shape[1]) - focal_baseline / np.nan_to_num(depth_m, nan=1e3)
    nearest = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    return column > nearest + 0.5


def fill(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return values (H, W) float32 with hidden pixels interpolated, coarse to fine."""
    if seen.all() or min(seen.shape) < 2:
        return values
    weight = cv2.resize(seen.astype(np.float32), None, fx=0.5, fy=0.5,
                        interpolation=cv2.INTER_AREA)
    coarse = cv2.resize(np.where(seen, values, 0).astype(np.float32), None, fx=0.5, fy=0.5,
                        interpolation=cv2.INTER_AREA)
    coarse = fill(coarse / np.maximum(weight, 1e-6), weight > 0)
    return np.where(seen, values, cv2.resize(coarse, seen.shape[::-1]))


def _depth(disparity: np.ndarray, is_hole: np.ndarray) -> np.ndarray:
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where((disparity > 0) & ~is_hole, 1 / disparity, np.nan).astype(np.float32)

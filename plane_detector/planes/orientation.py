# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Orientation of planes in a network's depth, from the depth, the axes of the scene and its lines.

The normal of a network is the true one plus an error of unknown size sigma, smooth over the image
and much larger than the noise of the fit; for a few pieces it is unrelated to the true one. The
prior of the true normal is a mixture: vertical (a horizontal plane); along a horizontal axis;
horizontal with any azimuth (a vertical plane); perpendicular to a horizontal axis (a roof); or
free.

1. Each hypothesis of each plane has a marginal likelihood: a density on the sphere for a point,
   of a circle for one degree of freedom, and a uniform density for two.
2. Lines that cannot lie in a plane of that normal reduce the likelihood, and so does a change of
   depth, at the best distance of such a plane, beyond the error of networks.
3. sigma is the value that maximises the likelihood of all planes of the image (empirical Bayes),
   so that an accurate network has more weight than an inaccurate one. A region that is flat in the
   depth has an accurate normal: smooth errors that tilt a region also bend it.
4. The most likely hypothesis is fused with the network's normal, weighted by their variances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.directions.vanishing import SceneDirections
from plane_detector.planes.line_evidence import MAIN_AXES, LineEvidence
from plane_detector.planes.region_samples import RegionSamples
from plane_detector.types import Plane

# tuned: python -m plane_detector.evaluation.benchmark orientation: the results stay within one
# degree when any of these is doubled or halved.
LEVEL_PRIOR, AXIS_PRIOR, UPRIGHT_PRIOR, ROOF_PRIOR, FREE_PRIOR = 0.25, 0.2, 0.2, 0.05, 0.1
# Log likelihood lost if all lines in a plane contradict it. tuned: as above, flat from 12 to 14;
# with half of it pictures on walls, which networks treat as windows, are rotated across the walls.
LINE_WEIGHT = 12.0
# Share of the pieces whose normal from the network is unrelated to the true one. It limits the
# weight of the angle, so that lines can outweigh it. tuned: as above, flat from 0.03 to 0.1.
OUTLIER_SHARE = 0.05
# Error of a network's normals: possible values, median and spread factor of their prior.
SIGMAS_RAD = np.radians([0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0])
EXPECTED_SIGMA_RAD, LOG_SIGMA_SPREAD = np.radians(12.0), 1.0
# Error of a region's normal relative to its bend, the rms distance from its plane over its size.
# tuned: pure regions of fastdepth on frames of a Kinect, NYU and a living room: the median of
# their errors is 4 times the bend, nine of ten are below this.
TILT_PER_BEND = 10.0
# derived: the mean relative error of fastdepth's depth on frames of other cameras.
DEPTH_ERROR_SHARE = 0.25
# Sine of the angle to an axis; a closer normal has no usable component perpendicular to it.
MIN_ACROSS = 0.2


@dataclass(frozen=True)
class Orientations:
    """
    The most likely normals.

    Attributes
    ----------
    normals : (K, 3) float64
        Unit normals, on the same side as those of the network.
    is_changed : (K,) bool
        False if the normal of the network is kept.
    sigmas_rad : (K,) float64
        Error of the network's normals.

    """

    normals: np.ndarray
    is_changed: np.ndarray
    sigmas_rad: np.ndarray


@dataclass(frozen=True)
class _Hypotheses:
    normals: np.ndarray     # (K, C, 3), on the side of the network's normals
    angle_rad: np.ndarray   # (K, C) from these
    freedoms: np.ndarray    # (C,) 0 a point, 1 a circle, 2 the sphere
    log_prior: np.ndarray   # (K, C), -inf where impossible


def orient_planes(planes: tuple[Plane, ...], directions: SceneDirections,
                  evidence: LineEvidence, samples: RegionSamples) -> Orientations:
    """
    Find the most likely normal of every plane.

    Parameters
    ----------
    planes : tuple of Plane
        At least one, as in the network's depth.
    directions : SceneDirections
        With gravity.
    evidence : LineEvidence
        Of these planes.
    samples : RegionSamples
        Of their pixels.

    """
    hypotheses = _hypotheses(np.stack([plane.normal for plane in planes]), directions, evidence)
    moved = samples.depth_change(hypotheses.normals)
    lost = (LINE_WEIGHT * evidence.contradiction(hypotheses.normals)
            + 0.5 * (moved / DEPTH_ERROR_SHARE) ** 2)
    variances = _variances(planes)
    scores = _log_likelihood(hypotheses, variances) - lost
    prior = -0.5 * (np.log(SIGMAS_RAD / EXPECTED_SIGMA_RAD) / LOG_SIGMA_SPREAD) ** 2
    best = int(np.argmax(np.logaddexp.reduce(scores, axis=2).sum(axis=1) + prior))
    chosen = scores[best].argmax(1)
    axis_variance = np.trace(directions.covariance) / 2
    share = axis_variance / (axis_variance + variances[best])
    normals = _unit(hypotheses.normals[np.arange(len(planes)), chosen] * (1 - share)[:, None]
                    + hypotheses.normals[:, -1] * share[:, None])
    return Orientations(normals, hypotheses.freedoms[chosen] < 2, np.sqrt(variances[best]))


def _variances(planes: tuple[Plane, ...]) -> np.ndarray:
    """Return the variance (S, K) of the network's normals, rad^2, for each of SIGMAS_RAD."""
    fit = np.array([np.trace(plane.covariance[:3, :3]) / 2 for plane in planes])
    bend = np.array([plane.rms_m / np.sqrt(plane.area_m2) for plane in planes])
    limit = np.maximum(TILT_PER_BEND * bend, 1e-6)
    return fit + 1 / (1 / SIGMAS_RAD[:, None] ** 2 + 1 / limit**2)


def _hypotheses(normals: np.ndarray, directions: SceneDirections,
                evidence: LineEvidence) -> _Hypotheses:
    """Return all hypotheses; the last one is the normal of the network."""
    down = directions.gravity_camera
    axes = np.concatenate([np.zeros((0, 3)), *(pair.axes for pair in directions.pairs)])
    points = np.vstack([down[None], axes])
    across = [normals - np.outer(normals @ axis, axis) for axis in points[:MAIN_AXES]]
    candidates = np.stack([*(np.broadcast_to(point, normals.shape) for point in points),
                           *across, normals], axis=1)
    length = np.linalg.norm(candidates, axis=2)
    candidates = _unit(candidates)
    cosine = (candidates * normals[:, None]).sum(2)
    candidates = candidates * np.where(cosine < 0, -1.0, 1.0)[..., None]
    prior = np.array([LEVEL_PRIOR, *[AXIS_PRIOR] * len(axes), UPRIGHT_PRIOR,
                      *[ROOF_PRIOR] * (len(across) - 1), FREE_PRIOR])
    freedoms = np.repeat([0, 1, 2], [len(points), len(across), 1])
    possible = length > MIN_ACROSS
    possible[:, :len(points)] &= evidence.allows()
    log_prior = np.where(possible, np.log(prior), -np.inf)
    return _Hypotheses(candidates, np.arccos(np.clip(np.abs(cosine), 0, 1)), freedoms, log_prior)


def _log_likelihood(hypotheses: _Hypotheses, variance: np.ndarray) -> np.ndarray:
    """Return the log of prior and marginal likelihood (S, K, C), of variances (S, K), rad^2."""
    variance = variance[..., None]
    misfit = np.log1p(-OUTLIER_SHARE) - 0.5 * hypotheses.angle_rad**2 / variance
    anywhere = -np.log(2 * np.pi)
    point = np.logaddexp(misfit - np.log(2 * np.pi * variance), np.log(OUTLIER_SHARE) + anywhere)
    circle = np.logaddexp(misfit - 0.5 * np.log(2 * np.pi * variance) - np.log(np.pi),
                          np.log(OUTLIER_SHARE) + anywhere)
    sphere = np.full_like(point, anywhere)
    return hypotheses.log_prior + np.choose(hypotheses.freedoms, [point, circle, sphere])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)

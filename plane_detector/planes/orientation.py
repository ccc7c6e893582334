# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Orientation of planes in a network's depth, from the depth, the axes of the scene and its lines.

The normal of a network is the true one plus an error of unknown size sigma, smooth over the image
and much larger than the noise of the fit; for some small pieces it is unrelated to the true one.
The true normal faces the camera, which the network's normal need not do. The prior of the true
normal is a mixture: vertical (a horizontal plane); along a horizontal axis; horizontal with any
azimuth (a vertical plane); perpendicular to a horizontal axis (a roof); or free. The axes are
those of the lines, or those of the planes themselves (plane_axes.py).

1. Each hypothesis of each plane has a marginal likelihood: a density on the sphere for a point, of
   a circle for one degree of freedom, and a uniform density for two.
2. Lines that cannot lie in a plane of that normal reduce the likelihood, and so does a change of
   depth, at the best distance of such a plane, beyond the error of networks.
3. sigma is the value that maximises the likelihood of all planes of the image (empirical Bayes),
   so an accurate network has more weight than an inaccurate one. A region that is flat in the
   depth has an accurate normal: smooth errors that tilt a region also bend it.
4. Pieces of one surface are likely: a hypothesis gains if a larger piece with this normal
   continues into the region at the depth of the network.
5. The most likely hypothesis is fused with the network's normal, weighted by their variances.
6. The probability that it is right is the sum over the hypotheses of this direction, reduced by
   the error of the network that remains along a circle or on the sphere.
7. The probability of its class is that of the hypotheses of that class, divided by one plus the
   odds that the region is not a plane of that direction: the network's depth is far from it, or
   bent although the region is small, or the region has many colours.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import erf

import numpy as np

from plane_detector.directions.vanishing import SceneDirections
from plane_detector.geometry.rigid_transform import unit_vectors
from plane_detector.planes.classification import LEAST_SIGMA_RAD, TOLERANCE_DEG
from plane_detector.planes.line_evidence import MAIN_AXES, LineEvidence
from plane_detector.planes.region_samples import MIN_COSINE, RegionSamples
from plane_detector.types import Planes

# tuned: python -m plane_detector.evaluation.benchmark orientation: the results stay within one
# degree when any of these is doubled or halved.
LEVEL_PRIOR, AXIS_PRIOR, UPRIGHT_PRIOR, ROOF_PRIOR, FREE_PRIOR = 0.25, 0.2, 0.2, 0.05, 0.1
# For the class, the odds that a piece is clutter or mixes several surfaces: the square of its
# misfit over MIXED_MISFIT, plus its bend over CLUTTER_BEND times the root of its share of the
# image; both times the root of the number of its colours. The misfit is how far the network's
# depth is from the oriented plane (log ratio of depths); that of a level plane is divided by the
# cosine between it and its rays, since what seems level near the horizon seldom is. fitted:
# maximum likelihood of the class of pixels, 5000 pieces of every second frame of three walks and
# rooms (Kinect, NYU, rendered) through fastdepth, and of sensors' depth with the errors of a
# network (docs/results.md). Free powers are 2.1, 4 (cosine) and 0.5, and no better on the other
# half. There what is stated as 0.55, 0.66, 0.76, 0.86 and 0.94 is right in 0.62, 0.68, 0.76, 0.86
# and 0.94.
MIXED_MISFIT, CLUTTER_BEND = 0.94, 4.5
# Log likelihood lost if all lines in a plane contradict it. tuned: as above, flat from 12 to 14;
# with half of it pictures on walls, which networks treat as windows, are rotated across the walls.
LINE_WEIGHT = 12.0
# Share of the pieces whose normal from the network is unrelated to the true one, times their share
# of the image, and the largest such share, where the error of the normal is large. tuned: as
# above, three seeds, flat from 0.005 to 0.008. Of the pure pieces below 0.03 of the image a fifth
# is more than 60 degrees off, of those above 0.06 none. The error is that of the network and of
# the fit: pieces cut out of a larger surface are where noise is largest.
OUTLIER_SIZE, MAX_OUTLIER_SHARE = 0.006, 0.6
# Odds that a piece belongs to a larger one with the same normal if that one continues exactly at
# its depth, and the spread of the log ratio of depths within such a surface by the error of the
# network's normals; the noise of the piece is added. It is at most that of a network with an error
# of 12 degrees: an object that a worse one shows as a slab is not a part of the floor.
# tuned: as above, flat from 3 to 8 and, for networks with an error of 12 degrees, from 0.12 to
# 0.2. In the tuned frames such a piece is found at the right hypotheses twice as often as at the
# wrong ones.
SAME_SURFACE_ODDS, MAX_SURFACE_DEPTH_SHARE = 4.0, 0.15
SURFACE_DEPTH_PER_RAD = MAX_SURFACE_DEPTH_SHARE / np.radians(12.0)
# Normals closer than this are equal; hypotheses of one kind differ only by rounding.
SAME_NORMAL_COSINE = np.cos(np.radians(6.0))
# A normal is right within this angle. tuned: benchmark orientation --only planes of commit
# dec5ee1, flat from 15 to 20 degrees; at 13 a tenth of the coverage on Kinect frames is lost.
CLOSE_RAD = np.radians(15.0)
# Error of a network's normals: possible values, median and spread factor of their prior.
SIGMAS_RAD = np.radians([0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0])
EXPECTED_SIGMA_RAD, LOG_SIGMA_SPREAD = np.radians(12.0), 1.0
# Error of a region's normal relative to its bend, the distance from its plane over its size.
# tuned: pure regions of fastdepth on frames of a Kinect, NYU and a living room: the median of
# their errors is 4 times the bend, nine of ten are below this; angles the same from 10 to 14.
TILT_PER_BEND = 12.0
# No plane is rotated by more than this multiple of its error. tuned: as above and misleading
# pictures, rooms from seed 300; the same from 10 on, up to where planes are rotated by 90 degrees.
MOST_TILTS = 10.0
# derived: the mean relative error of fastdepth's depth on frames of other cameras.
DEPTH_ERROR_SHARE = 0.25
# Sine of the angle to an axis; a closer normal has no usable component perpendicular to it.
MIN_ACROSS = 0.2


@dataclass(frozen=True)
class Orientations:
    """The most likely normals."""

    normals: np.ndarray  # (K, 3) float64: unit normals, facing the camera
    is_changed: np.ndarray  # (K,) bool: false if the normal of the network is kept
    sigmas_rad: np.ndarray  # (K,) float64: error of the network's normals
    # (K,) float64: that the true normal is within CLOSE_RAD of the chosen one
    probability: np.ndarray
    # (K,) float64: that the plane is horizontal, vertical or neither, as this normal indicates
    class_probability: np.ndarray

    def followed_by(self, others: Orientations, chosen: np.ndarray) -> Orientations:
        """Return these, and the chosen ones of others."""
        return Orientations(*(np.concatenate([getattr(self, one.name),
                                              getattr(others, one.name)[chosen]])
                              for one in fields(Orientations)))


@dataclass(frozen=True)
class _Hypotheses:
    normals: np.ndarray     # (K, C, 3), facing the camera
    angle_rad: np.ndarray   # (K, C) from these
    freedoms: np.ndarray    # (C,) 0 a point, 1 a circle, 2 the sphere
    can_rise: np.ndarray    # (C,) bool, whether the network's normal decides the inclination
    log_prior: np.ndarray   # (K, C), -inf where impossible


@dataclass(frozen=True)
class ScoredOrientations:
    """Hypotheses of all planes about the axes of a scene."""

    directions: SceneDirections  # with the axes
    hypotheses: _Hypotheses
    # (K, C) float64: log of prior times likelihood, at the most likely error of the network
    scores: np.ndarray
    sigma_rad: float  # that error
    variances: np.ndarray  # (K,) float64: of the network's normals for it, rad^2
    bends: np.ndarray  # (K,) float64: distance of regions from their planes over their size
    log_evidence: float  # log likelihood of these axes by all normals of the network


def score_orientations(planes: Planes, directions: SceneDirections,
                       evidence: LineEvidence, samples: RegionSamples,
                       shift_rad: float = 0.0, sigmas_rad: np.ndarray = SIGMAS_RAD
                       ) -> ScoredOrientations:
    """
    Score the hypotheses of every plane.

    Parameters
    ----------
    planes : Planes
        At least one, as in the network's depth.
    directions : SceneDirections
        With a main axis.
    evidence : LineEvidence
        Of these planes.
    samples : RegionSamples
        Of their pixels.
    shift_rad : float
        Error of normals due to an uncertain shift of the disparity.
    sigmas_rad : (S,) float64
        Errors that the normals of the network may have.

    """
    hypotheses = _hypotheses(planes.normals, directions, evidence, samples.middles)
    moved = samples.depth_change(hypotheses.normals)
    lost = (LINE_WEIGHT * evidence.contradiction(hypotheses.normals)
            + 0.5 * (moved / DEPTH_ERROR_SHARE) ** 2)
    variances = normal_variances(planes, samples, sigmas_rad[:, None], shift_rad)
    outliers = np.minimum(OUTLIER_SIZE / np.maximum(samples.image_shares, 1e-6), MAX_OUTLIER_SHARE
                          ) * variances / (variances + EXPECTED_SIGMA_RAD**2)
    scores = _log_likelihood(hypotheses, variances, outliers[..., None]) - lost
    # Whatever its lines, a region is rotated only within its error.
    scores[hypotheses.angle_rad > MOST_TILTS * np.sqrt(variances)[..., None]] = -np.inf
    prior = -0.5 * (np.log(sigmas_rad / EXPECTED_SIGMA_RAD) / LOG_SIGMA_SPREAD) ** 2
    evidence_of = np.logaddexp.reduce(scores, axis=2).sum(axis=1) + prior
    best = int(np.argmax(evidence_of))
    return ScoredOrientations(directions, hypotheses, scores[best], sigmas_rad[best],
                              variances[best], _bends(planes, samples), float(evidence_of[best]))


def most_likely(scored: ScoredOrientations, samples: RegionSamples,
                colours: np.ndarray) -> Orientations:
    """
    Return the most likely normal of every plane, and its probability.

    The numbers of colours (K,) in the regions show which of these mix several surfaces.
    """
    hypotheses, variances = scored.hypotheses, scored.variances
    every = np.arange(len(variances))
    alone = hypotheses.normals[every, scored.scores.argmax(1)]
    likely = scored.scores + _same_surface(hypotheses, alone, scored.sigma_rad, samples)
    chosen = likely.argmax(1)
    # The error of the network's normal is at least its distance from the chosen one.
    variance = np.maximum(variances, hypotheses.angle_rad[every, chosen] ** 2)
    axis_variance = np.trace(scored.directions.covariance) / 2
    share = axis_variance / (axis_variance + variance)
    normals = unit_vectors(hypotheses.normals[every, chosen] * (1 - share)[:, None]
                    + hypotheses.normals[:, -1] * share[:, None])
    posterior = np.exp(likely - likely.max(1, keepdims=True))
    posterior /= posterior.sum(1, keepdims=True)
    down, pairs = scored.directions.gravity_camera, scored.directions.pairs[:1].reshape(-1, 3)
    # Whichever axis is down, the class has at least the smallest of their probabilities.
    misfits = samples.distances_to_planes(normals, samples.offsets(normals)).diagonal()
    of_class = np.min([
        _class_probability(hypotheses, posterior, normals, axis, variances)
        / (1 + _mixed_odds(scored.bends, misfits, normals, axis, samples, colours))
        for axis in ([scored.directions.main_axis, *pairs] if down is None else [down])], axis=0)
    return Orientations(
        normals, hypotheses.freedoms[chosen] < 2, np.sqrt(variances),
        _probability(hypotheses, posterior, chosen, variances), of_class)


def _mixed_odds(bends: np.ndarray, misfits: np.ndarray, normals: np.ndarray, down: np.ndarray,
                samples: RegionSamples, colours: np.ndarray) -> np.ndarray:
    """Return the odds (K,) that pieces are clutter or mix several surfaces."""
    cosine = -(unit_vectors(samples.middles) * normals).sum(1)
    is_level = np.abs(normals @ down) >= np.cos(np.radians(TOLERANCE_DEG))
    misfits = misfits / np.where(is_level, np.maximum(cosine, MIN_COSINE), 1.0)
    clutter = bends / (CLUTTER_BEND * np.sqrt(np.maximum(samples.image_shares, 1e-6)))
    return ((misfits / MIXED_MISFIT) ** 2 + clutter) * np.sqrt(colours)


def _class_probability(hypotheses: _Hypotheses, posterior: np.ndarray, normals: np.ndarray,
                       down: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Return the probability (K,) that planes are as level or upright as normals (K, 3) seem."""
    level, upright, right = np.radians([90 - TOLERANCE_DEG, TOLERANCE_DEG, 90])
    rise = np.arcsin(np.minimum(np.abs(normals @ down), 1))
    low = np.select([rise >= level, rise <= upright], [level, -upright], upright)[:, None]
    high = np.select([rise >= level, rise <= upright], [2 * right - level, upright], level)
    rises = np.arcsin(np.minimum(np.abs(hypotheses.normals @ down), 1))
    sigmas = np.sqrt(2) * np.where(hypotheses.can_rise, np.sqrt(variances)[:, None],
                                   LEAST_SIGMA_RAD)
    inside = _erf((high[:, None] - rises) / sigmas) - _erf((low - rises) / sigmas)
    return (posterior * inside / 2).sum(1)


def _probability(hypotheses: _Hypotheses, posterior: np.ndarray, chosen: np.ndarray,
                 variances: np.ndarray) -> np.ndarray:
    """Return the probability (K,) that the true normal is close to the chosen hypothesis."""
    normals = hypotheses.normals[np.arange(len(chosen)), chosen]
    is_close = (hypotheses.normals * normals[:, None]).sum(2) > np.cos(CLOSE_RAD)
    # A circle or the sphere leaves one or two components of the network's error.
    reach = CLOSE_RAD / np.sqrt(2 * variances)
    near = np.stack([np.ones_like(reach), _erf(reach), 1 - np.exp(-reach**2)], 1)
    return (posterior * is_close * near[:, hypotheses.freedoms]).sum(1)


def normal_variances(planes: Planes, samples: RegionSamples,
                     sigmas_rad: np.ndarray | float, shift_rad: float) -> np.ndarray:
    """
    Return the variances (..., K) of normals, rad^2, by errors (..., 1) of the network.

    An error of the shift of the disparity rotates planes without bending them. Whatever noise is
    stated for the network, a flatter region has less: exact depth stays exact.
    """
    of_fit = np.trace(planes.covariances[:, :3, :3], axis1=1, axis2=2) / 2
    largest = np.maximum(TILT_PER_BEND * _bends(planes, samples), 1e-6) ** 2
    return np.minimum(of_fit, largest) + shift_rad**2 + 1 / (1 / sigmas_rad**2 + 1 / largest)


def _bends(planes: Planes, samples: RegionSamples) -> np.ndarray:
    """Return the distance (K,) of regions from their planes, as a share of their size."""
    return samples.roughness * (planes.offsets_m / np.sqrt(planes.areas_m2))


def _same_surface(hypotheses: _Hypotheses, normals: np.ndarray, sigma_rad: float,
                  samples: RegionSamples) -> np.ndarray:
    """Return the log odds (K, C) that a larger piece, with normals (K, 3), is the same surface."""
    distance = samples.distances_to_planes(normals, samples.offsets(normals))
    spread = np.hypot(SURFACE_DEPTH_PER_RAD * sigma_rad, samples.roughness[:, None])
    spread = np.minimum(spread, MAX_SURFACE_DEPTH_SHARE)
    odds = SAME_SURFACE_ODDS * np.exp(-0.5 * (distance / spread) ** 2)
    is_larger = samples.image_shares > samples.image_shares[:, None]
    same = (hypotheses.normals @ normals.T > SAME_NORMAL_COSINE) & is_larger[:, None]
    same &= (hypotheses.freedoms < 2)[:, None]
    return np.log1p((same * odds[:, None]).max(2))


def _hypotheses(normals: np.ndarray, directions: SceneDirections, evidence: LineEvidence,
                rays: np.ndarray) -> _Hypotheses:
    """Return all hypotheses, facing against the rays; the last one is the network's normal."""
    axes = directions.pairs.reshape(-1, 3)
    points = np.vstack([directions.main_axis[None], axes])
    across = [normals - np.outer(normals @ axis, axis) for axis in points[:MAIN_AXES]]
    candidates = np.stack([*(np.broadcast_to(point, normals.shape) for point in points),
                           *across, normals], axis=1)
    length = np.linalg.norm(candidates, axis=2)
    candidates = unit_vectors(candidates)
    faces_away = (candidates[:, :-1] * rays[:, None]).sum(2) > 0
    candidates[:, :-1] *= np.where(faces_away, -1.0, 1.0)[..., None]
    cosine = (candidates * normals[:, None]).sum(2)
    of_points = np.array([LEVEL_PRIOR, *[AXIS_PRIOR] * len(axes)])
    of_circles = np.array([UPRIGHT_PRIOR, *[ROOF_PRIOR] * (len(across) - 1)])
    if directions.gravity_camera is None:  # any of the first axes may be the vertical
        of_points[:MAIN_AXES] = of_points[:MAIN_AXES].mean()
        of_circles[:] = of_circles.mean()
    prior = np.array([*of_points, *of_circles, FREE_PRIOR])
    freedoms = np.repeat([0, 1, 2], [len(points), len(across), 1])
    can_rise = np.arange(len(freedoms)) > len(points)
    possible = length > MIN_ACROSS
    possible[:, :len(points)] &= evidence.allows()
    log_prior = np.where(possible, np.log(prior), -np.inf)
    return _Hypotheses(candidates, np.arccos(np.clip(cosine, -1, 1)), freedoms, can_rise,
                       log_prior)


def _log_likelihood(hypotheses: _Hypotheses, variance: np.ndarray,
                    outliers: np.ndarray) -> np.ndarray:
    """
    Return the log of prior and marginal likelihood (S, K, C).

    The variances (S, K) are in rad^2; a share (K, 1) of the normals are outliers.
    """
    variance = variance[..., None]
    misfit = np.log1p(-outliers) - 0.5 * hypotheses.angle_rad**2 / variance
    anywhere = -np.log(2 * np.pi)
    point = np.logaddexp(misfit - np.log(2 * np.pi * variance), np.log(outliers) + anywhere)
    circle = np.logaddexp(misfit - 0.5 * np.log(2 * np.pi * variance) - np.log(np.pi),
                          np.log(outliers) + anywhere)
    sphere = np.full_like(point, anywhere)
    return hypotheses.log_prior + np.choose(hypotheses.freedoms, [point, circle, sphere])


_erf = np.vectorize(erf, otypes=[float])

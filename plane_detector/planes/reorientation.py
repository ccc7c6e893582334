# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes in a network's depth with corrected orientation; coplanar pieces are merged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.finder import ImageDirections
from plane_detector.geometry.rigid_transform import unit_vectors
from plane_detector.planes.classification import MIN_ORIENTED_PROBABILITY, TOLERANCE_DEG
from plane_detector.planes.line_evidence import lines_in_regions
from plane_detector.planes.measurement import measure_planes, ray_plane_jacobian
from plane_detector.planes.orientation import (
    EXPECTED_SIGMA_RAD,
    Orientations,
    ScoredOrientations,
    most_likely,
    normal_variances,
    score_orientations,
)
from plane_detector.planes.patches import colours_in_regions, patches_in_regions
from plane_detector.planes.plane_axes import OWN_SIGMA_RAD, PLANE_VOTE, axes_of_planes
from plane_detector.planes.region_samples import MIN_COSINE, sample_regions
from plane_detector.segmentation.cells.model import PixelRegions, rename_labels
from plane_detector.types import CameraIntrinsics, Planes

# Pieces of one plane touch and have equal normals and distances: largest differences in degrees,
# as share of the distance per radian, and as share of the distance.
# tuned: python -m plane_detector.evaluation.benchmark orientation, flat from 0.1 to 0.15.
SAME_NORMAL_DEG, OFFSET_PER_RAD, MAX_OFFSET_SHARE, BORDER_REACH_PX = 5.0, 0.5, 0.1, 5
# derived: the orientation of a piece is more likely wrong than right below this.
MIN_PROBABILITY = 0.5
# Where pieces touch, depth may jump by this share per radian of error of the normals.
# tuned: as above, flat from 0.06 to 0.1; saved depth of a strong network (corridor wall), in which
# samples on a wall jump by 0.1 and more.
STEP_PER_RAD = 0.08
# Errors of the shift of 1/z that a network may have, as shares of the typical 1/z of the image: a
# shift turns walls by 15 degrees without bending them. Spread of their prior, and log odds against
# any. tuned: rendered corridors with errors of 0.1 to 0.3 and exact depth, seeds 300 to 303, the
# same for spreads from 0.14 to 0.28 and odds from 6 to 9 (docs/results.md); at 3 exact depth of a
# room, whose planes have axes of their own, is turned by 2.5 degrees.
SHIFT_SHARES = np.linspace(-0.6, 0.6, 61)
SHIFT_SPREAD, LOG_SHIFT_ODDS = 0.2, 8.0
# derived: what half a step between these shares turns a plane by that is as far as typical.
SHIFT_STEP_RAD = 0.5 * (SHIFT_SHARES[1] - SHIFT_SHARES[0])
# Smallest part of one colour, as a share of the image. tuned: classes in 150 frames of two
# kitchens, an office and a living room through fastdepth, flat from 0.005 to 0.02.
PART_SHARE = 0.01
# chosen: a hundred pixels in a part of a hundredth of a small image, enough to fit a plane.
FIT_STEP = 4


def measure_reoriented(regions: PixelRegions, intrinsics: CameraIntrinsics, min_pixels: float,
                       lines: ImageDirections, shift_rad: float = 0.0
                       ) -> tuple[Planes, np.ndarray]:
    """Measure planes, see :func:`measure_planes`, that are rotated first, see :func:`reorient`."""
    planes, labels = measure_planes(regions, intrinsics, min_pixels)
    if not len(planes):
        return planes, labels
    own = replace(regions, labels=labels, rotated_rad=_rotations(regions, labels, len(planes)))
    reoriented = reorient(own, planes, lines, intrinsics, shift_rad, min_pixels)
    return measure_planes(reoriented, intrinsics, min_pixels)


def _rotations(regions: PixelRegions, labels: np.ndarray, count: int) -> np.ndarray:
    """Return ``rotated_rad`` of the regions that other labels (H, W) of these pixels stand for."""
    rotated_rad = np.zeros(count)
    if np.any(regions.rotated_rad):
        seen = labels >= 0
        rotated_rad[labels[seen]] = regions.rotated_rad[regions.labels[seen]]
    return rotated_rad


def reorient(regions: PixelRegions, planes: Planes, lines: ImageDirections,
             intrinsics: CameraIntrinsics, shift_rad: float = 0.0, min_pixels: float = 0.0
             ) -> PixelRegions:
    """
    Rotate regions to their most likely orientation, and merge those that are then coplanar.

    The normals may have a common error, because the network's 1/z is shifted. Upright parts of
    regions that have no class become regions of their own.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in one unit, with true angles; labels index into ``planes``.
    planes : Planes
        Measured in these regions, at least one.
    lines : ImageDirections
        Of the image, with a main axis.
    intrinsics : CameraIntrinsics
    shift_rad : float
        Error of normals due to an uncertain shift of the disparity.
    min_pixels : float
        No part of a region has fewer pixels.

    Returns
    -------
    PixelRegions
        One region per plane and part, without pixels if merged into another or too uncertain.
        Pixels that see their rotated plane edge-on or from behind have no label.

    """
    samples = sample_regions(regions, planes, intrinsics)
    beside = lines_in_regions(lines.segments, regions.labels, len(planes))

    def scored(axes: ImageDirections, turned: Planes) -> ScoredOrientations:
        off_rad = shift_rad if turned is planes else np.hypot(shift_rad, SHIFT_STEP_RAD)
        return score_orientations(turned, axes.directions, beside.along(axes.all_axes), samples,
                                  off_rad)

    by_lines = scored(lines, planes)
    variances = normal_variances(planes, samples, OWN_SIGMA_RAD, shift_rad)
    shifted = _at_likely_shift(planes, variances + SHIFT_STEP_RAD**2, lines.all_axes,
                               np.median(samples.disparity))

    def with_own_axes(best: ScoredOrientations, turned: Planes) -> ScoredOrientations:
        own, log_prior = axes_of_planes(turned.normals, variances, lines.directions)
        if own is None:
            return best
        other = scored(replace(lines, directions=own), turned)
        return other if _outvotes(other, best, log_prior) else best

    best = with_own_axes(by_lines, planes)
    # Planes that are already at right angles have no shift.
    if best is by_lines and shifted is not None:
        other, log_odds = scored(lines, shifted[0]), shifted[1]
        if other.log_evidence - best.log_evidence + log_odds > 0:
            best = with_own_axes(other, shifted[0])
    found = most_likely(best, samples, colours_in_regions(regions.labels, regions.patches,
                                                          len(planes)))
    with_parts = _with_upright_parts(regions, planes, found, best, lines, intrinsics, shift_rad,
                                     min_pixels)
    if with_parts is not None:
        regions, planes, found = with_parts
        samples = sample_regions(regions, planes, intrinsics)
    normals, offsets = planes.normals.copy(), planes.offsets_m.copy()
    refitted = samples.offsets(found.normals)
    changed = found.is_changed & np.isfinite(refitted)
    normals[changed], offsets[changed] = found.normals[changed], refitted[changed]
    is_sure = found.probability > MIN_PROBABILITY
    # Regions rotated by normals have right angles, but their depth is as bent as before.
    off_rad = np.maximum(found.sigmas_rad, regions.rotated_rad)
    agree = _agreeing(normals, offsets, off_rad) & is_sure & is_sure[:, None]
    group = _groups(agree & _continuous(regions, planes, intrinsics, off_rad))
    joined = replace(regions, labels=rename_labels(regions.labels, np.where(is_sure, group, -1)))
    grown = np.bincount(group, minlength=len(group)) > 1
    if grown.any():
        again = samples.joined(group).offsets(normals)
        grown &= np.isfinite(again)
        offsets[grown] = again[grown]
    reoriented = _rotated(joined, normals, offsets, changed | grown, intrinsics)
    return replace(reoriented, certainty=found.probability,
                   class_certainty=found.class_probability)


def _with_upright_parts(regions: PixelRegions, planes: Planes, found: Orientations,
                        scored: ScoredOrientations, lines: ImageDirections,
                        intrinsics: CameraIntrinsics, shift_rad: float, min_pixels: float
                        ) -> tuple[PixelRegions, Planes, Orientations] | None:
    """
    Return the regions followed by upright parts of those that have no class; None: there are none.

    Networks show the front of a cupboard or a table as the floor that goes on. A part is of one
    colour; it is judged by the axes and the error of the network that the image has. Level parts
    stay where they are: those that seem level in a piece without a class seldom are.
    """
    down = scored.directions.gravity_camera
    is_refused = ((found.class_probability < MIN_ORIENTED_PROBABILITY)
                  | (found.probability <= MIN_PROBABILITY))
    if down is None or not regions.patches.size or not is_refused.any():
        return None
    labels, count = patches_in_regions(regions.labels, regions.patches, is_refused,
                                       max(PART_SHARE * regions.labels.size, min_pixels))
    if not count:
        return None
    parts = replace(regions, labels=labels, rotated_rad=0.0,
                    coefficients=_fitted_to_pixels(labels, regions, count))
    measured, labels = measure_planes(parts, intrinsics)
    samples = sample_regions(replace(parts, labels=labels), measured, intrinsics)
    axes = replace(lines, directions=scored.directions).all_axes
    oriented = most_likely(
        score_orientations(measured, scored.directions,
                           lines_in_regions(lines.segments, labels, len(measured)).along(axes),
                           samples, shift_rad, np.array([scored.sigma_rad])),
        samples, colours_in_regions(labels, regions.patches, len(measured)))
    taken = np.flatnonzero((np.abs(oriented.normals @ down) <= np.sin(np.radians(TOLERANCE_DEG)))
                           & (oriented.class_probability >= MIN_ORIENTED_PROBABILITY)
                           & (oriented.probability >= MIN_ORIENTED_PROBABILITY))
    if not taken.size:
        return None
    index = np.full(len(measured) + 1, -1, np.int32)
    index[taken] = len(planes) + np.arange(len(taken))
    moved = index[labels]
    labels = np.where(moved >= 0, moved, regions.labels)
    rotated_rad = np.append(np.broadcast_to(regions.rotated_rad, len(planes)),
                            np.zeros(len(taken)))
    return (replace(regions, labels=labels, rotated_rad=rotated_rad),
            planes.concatenated(measured[taken]), found.followed_by(oriented, taken))


def _fitted_to_pixels(labels: np.ndarray, regions: PixelRegions, count: int) -> np.ndarray:
    """Return the coefficients (K, 3) of planes through 1/z where labels (H, W) are, each."""
    row, column = FIT_STEP * np.array(np.nonzero(labels[::FIT_STEP, ::FIT_STEP] >= 0))
    part, disparity = labels[row, column], regions.disparity[row, column]
    (x, y), width_px = regions.grid.origin, regions.grid.width_px
    seen = (x + column / width_px, y + row / width_px, np.ones(len(row)))

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(part, values, count)
    squares = np.moveaxis([[total(one * other) for other in seen] for one in seen], 2, 0)
    products = np.transpose([total(one * disparity) for one in seen])
    return np.linalg.solve(squares, products[..., None])[..., 0]


def _outvotes(own: ScoredOrientations, by_lines: ScoredOrientations, log_prior: float) -> bool:
    """Return whether axes of planes, with a log prior, are used; a poor network has no vote."""
    votes = PLANE_VOTE * (own.log_evidence - by_lines.log_evidence) + log_prior
    return bool(votes > 0 and np.median(own.variances) < EXPECTED_SIGMA_RAD**2)


def _at_likely_shift(planes: Planes, variances: np.ndarray, axes: np.ndarray,
                     typical_disparity: float) -> tuple[Planes, float] | None:
    """
    Return planes corrected for the most likely shift of the network's 1/z, and its log prior.

    A shift rotates planes without bending them, all in one way: n / d changes along the optical
    axis. None if no shift is most likely, or if it is at the end of the range: a flat world.
    """
    change = SHIFT_SHARES[:, None, None] * [0.0, 0.0, typical_disparity]
    normals = unit_vectors(planes.normals / planes.offsets_m[:, None] - change)
    off_rad = np.arccos(np.clip(np.abs(normals @ axes.T), 0, 1)).min(2)
    log_prior = -0.5 * (SHIFT_SHARES / SHIFT_SPREAD) ** 2 - LOG_SHIFT_ODDS
    fit = np.log1p(np.exp(-0.5 * off_rad**2 / variances) / variances).sum(1)
    best = np.argmax(fit + log_prior)
    if best in (0, len(SHIFT_SHARES) // 2, len(SHIFT_SHARES) - 1):
        return None
    return replace(planes, normals=normals[best]), log_prior[best]


def _rotated(regions: PixelRegions, normals: np.ndarray, offsets: np.ndarray,
             changed: np.ndarray, intrinsics: CameraIntrinsics) -> PixelRegions:
    """Return regions with these planes, without pixels that cannot see a changed one."""
    planes = np.linalg.solve(ray_plane_jacobian(intrinsics), -(normals / offsets[:, None]).T).T
    planes = np.ascontiguousarray(planes)
    lowest = np.where(changed, MIN_COSINE / offsets, -np.inf)
    in_pixels = regions.grid.planes_in_pixels(planes)
    height, width = regions.labels.shape
    corners = [[u, v, 1.0] for v in (0, height - 1) for u in (0, width - 1)]
    labels = regions.labels  # unless a plane is too far away in a corner, and so may be elsewhere
    if (in_pixels @ np.transpose(corners) < lowest[:, None]).any():
        labels = _seen_from_front(labels, in_pixels, lowest)
    return replace(regions, labels=labels, coefficients=planes)


@kernel('int32[:, ::1](int32[:, ::1], float64[:, ::1], float64[::1])', subject='network')
def _seen_from_front(labels, planes, lowest):
    """Return labels without pixels where 1/z on their plane is below the lowest of the plane."""
    found = labels.copy()
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            k = labels[v, u]
            if k >= 0 and planes[k, 0] * u + planes[k, 1] * v + planes[k, 2] < lowest[k]:
                found[v, u] = -1
    return found


def _agreeing(normals: np.ndarray, offsets: np.ndarray, sigmas_rad: np.ndarray) -> np.ndarray:
    """Return which planes (K, K) are equal within the errors (K,) of the network."""
    sigma_rad = np.maximum(sigmas_rad[:, None], sigmas_rad)
    same_offset = np.minimum(MAX_OFFSET_SHARE, OFFSET_PER_RAD * sigma_rad)
    same_normal = np.minimum(np.radians(SAME_NORMAL_DEG), sigma_rad)
    same = normals @ normals.T > np.cos(same_normal)
    return same & (np.abs(np.log(offsets[:, None] / offsets)) < same_offset)


def _groups(joined: np.ndarray) -> np.ndarray:
    """Return the index of the first plane that each is merged with, (K,) int, by pairs (K, K)."""
    group = np.arange(len(joined))
    for a, b in np.argwhere(np.triu(joined, 1)):
        first, second = sorted((group[a], group[b]))
        group[group == second] = first
    return group


def _continuous(regions: PixelRegions, planes: Planes, intrinsics: CameraIntrinsics,
                sigmas_rad: np.ndarray) -> np.ndarray:
    """Return which regions (K, K) touch without a jump of the depth between them."""
    slopes = -planes.normals[:, :2] / planes.offsets_m[:, None]
    slopes /= [intrinsics.fx, intrinsics.fy]
    pairs, jumps = _border_jumps(regions.labels, np.ascontiguousarray(regions.disparity), slopes)
    jumps = np.abs(jumps - jumps.T) / np.maximum(pairs + pairs.T, 1)
    sigma_rad = np.maximum(sigmas_rad[:, None], sigmas_rad)
    return (pairs + pairs.T > 0) & (jumps < STEP_PER_RAD * sigma_rad)


@kernel('Tuple((float64[:, ::1], float64[:, ::1]))(int32[:, ::1], float32[:, ::1], '
        'float64[:, ::1])', subject='network')
def _border_jumps(labels, disparity, slopes):
    """
    Return pairs (K, K) of pixels across borders, and their relative jumps of 1/z, summed.

    Every fourth row is searched for borders to the right, every fourth column for those below.
    """
    count, reach = len(slopes), BORDER_REACH_PX
    pairs, jumps = np.zeros((count, count)), np.zeros((count, count))
    height, width = labels.shape
    for axis in range(2):
        right, below = (reach, 0) if axis == 0 else (0, reach)
        for v in range(0, height - below, 4 - 3 * axis):
            for u in range(0, width - right, 1 + 3 * axis):
                a, b = labels[v, u], labels[v + below, u + right]
                if a == b or a < 0 or b < 0:
                    continue
                here, there = disparity[v, u], disparity[v + below, u + right]
                if here <= 0 or there <= 0:
                    continue
                expected = 0.5 * reach * (slopes[a, axis] + slopes[b, axis])
                pairs[a, b] += 1
                jumps[a, b] += 2 * (there - here - expected) / (here + there)
    return pairs, jumps

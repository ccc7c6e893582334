# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Merging of regions that are one plane.

Two regions are merged if one surface fits both and, where the test requires it, if their planes
meet at the border without a step and at a small angle. Four tests differ in surface and limits:

- coplanar: a joint plane fits both within the noise;
- a bulge: the smaller region is near the plane of the larger;
- flat within the settings: a concrete floor that dips by a degree or two is several planes in
  exact depth; a joint plane fits it within a tolerance in metres and one in degrees. Unequal parts
  of one bow have a gap between their planes: there a joint quadric must fit as well as these;
- bowed: networks bend walls; a slightly bent quadric fits as well as the two planes.

Regions whose normals differ are two planes, however well one plane fits their depth. The depth of
a network bends around corners within its error: a region that has grown fits ever more, and chance
decides what it swallows. There large regions become one only if each is nearly parallel to each,
or if a quadric fits them within the noise.

Pieces that do not touch are one plane if a joint plane fits as well as their own planes and a
nearer object separates them: a floor continues behind a box, but two tables of the same height do
not continue over the floor between them. The depth between them decides: something nearer than
their plane hides its continuation, something farther shows that it ends.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.config import SegmentationConfig
from plane_detector.geometry.rigid_transform import unit_vectors
from plane_detector.segmentation.cells.grid import (
    XX,
    XY,
    YY,
    D,
    N,
    X,
    Y,
    fit_plane,
    normal_of,
    squared_error,
)
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    MAX_JOINT_VARIANCES,
    MEAN_WEIGHT,
    MIN_VARIANCE,
    WeightedCells,
    residual,
)
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.normal_slopes import MIN_NORMAL_ERROR_DEG
from plane_detector.segmentation.memory import CLEAR, Decision, Recall
from plane_detector.segmentation.regions.curved import MAX_RATIO, MIN_NOISE_SHARE, fit_quadric
from plane_detector.segmentation.regions.model_selection import MAX_CELLS, prefer_two_planes
from plane_detector.segmentation.regions.region_graph import (
    NORMAL_SQUARES,
    NORMAL_X,
    NORMAL_Y,
    NORMALS,
    NORMALS_D,
    PAIRS,
    PLANE_TERMS,
    VARIANCE,
    RegionGraph,
    fold,
    merge_pairs,
)
from plane_detector.segmentation.search.plane_search import MIN_CREASE_DEG

# What is fitted to a pair, and the unit of its misfit: a joint plane (to a bulge, that of the
# larger region), variances; a joint plane, metres; a quadric, errors of the regions' own planes.
PLANE, PLANE_M, QUADRIC = range(3)


class OnePlane(NamedTuple):
    """
    When two regions are one plane.

    Attributes
    ----------
    surface : int
        What is fitted to both.
    tolerance : float
        Largest misfit in either region.
    max_gap : float
        Largest rms gap between their planes along the border, in deviations.
    max_fold_deg : float
        Largest angle between them.
    min_pairs : int
        Pairs of cells along their border: 1 if they must touch, else 0.

    """

    surface: int
    tolerance: float
    max_gap: float = np.inf
    max_fold_deg: float = np.inf
    min_pairs: int = 1


# Largest mean square of the cells of a bulge about the plane, in variances: 3.5 deviations.
# tuned: benchmark sensitivity of bb08c3e; flat to 1.4 times; at 0.7 times precision -0.123.
MAX_BULGE_VARIANCES = 3.5**2
# Largest ratio of the error of a joint quadric to that of the own plane, in each region of a wall.
# tuned: 14 real frames through FastDepth, SC with the planes of the sensor's depth; flat to 1.4
# times; at 0.7 times precision -0.013.
MAX_BOW_RATIO = 3.0
# Largest angle between any two regions that become one in the depth of a network, if each has at
# least this share of the cells. tuned: classes and angles of six sets of images through fastdepth,
# seeds 100 to 105, flat from 15 to 25 degrees, and for most sets from 0.02 to 0.03; at 0.01 small
# pieces with a wrong normal are left, at 0.02 in one attic (docs/results.md).
MAX_NETWORK_FOLD_DEG, MIN_FOLDED_SHARE = 20.0, 0.03
# chosen: in variances, far above the error of any region.
ALL_ERRORS = 1e6
# chosen: about as many lines, and samples per line, as cells along the longer side of a piece.
SIGHT_LINES = 24
# This many cells between two pieces may be farther than their plane. A cell counts from
# MAX_DEVIATIONS on, and fully at twice that, so that no single cell decides by a hair's breadth.
# chosen: three times the share of normal deviates below -3.
MAX_FARTHER_SHARE = 0.004
# Pieces that do not touch are one plane up to this angle, or up to this many of its standard
# deviations.
# tuned: eight NYU frames with 12 seeds, SC .909 without, .918 with it; 3 degrees and a deviation
# more .918, but the wall on both sides of a thick column is then two in one draw of three.
MAX_HIDDEN_FOLD_DEG, FOLD_DEVIATIONS = 3.0, 2.0
# The pieces share the systematic part, which is long as well as large: what is left has less of
# the density of the noise by this power of the bending.
# tuned: as above; SC .918 at 6, .911 at 4, where it is variance of the residuals.
UNSHARED_POWER = 6
# Twice the gain in log-likelihood, under the density of the noise, from which on pieces that do
# not touch are two planes, however small their angle is.
# derived: chi-squared with the three coefficients of a plane reaches it once in a thousand times.
MIN_HIDDEN_GAIN = 16.3


def merge_coplanar(cells: WeightedCells, graph: RegionGraph,
                   correlation: Correlation | None, recall: Recall | None = None,
                   max_fold_deg: float = np.inf) -> RegionGraph:
    """
    Merge pairs of regions, best fit first, until no pair fits.

    Parameters
    ----------
    cells : WeightedCells
    graph : RegionGraph
    correlation : Correlation or None
        Of the noise, for model selection; if None, all pairs that fit are merged.
    recall : Recall, optional
        Of the image before.
    max_fold_deg : float
        Largest angle between any two large regions that become one.

    Returns
    -------
    RegionGraph
        Planes refitted to all their cells.

    """
    folded = _folded(graph, max_fold_deg)
    unshared = correlation and correlation.density / correlation.bending**UNSHARED_POWER

    def is_apart(graph: RegionGraph, i: int, j: int, misfit: float) -> bool:
        touches = graph.borders[i, j, PAIRS] > 0
        if _has_folded(folded, graph, i, j):
            return True
        if recall and recall.is_two(Decision.MISFIT, misfit, graph.labels, (i, j), touches):
            return True
        if not touches:
            is_two = (
                (correlation and _folds(graph.planes, graph.sums, graph.lens, (i, j), unshared))
                or not _is_hidden_between(graph.labels, cells.table, cells.is_planar, graph.sums,
                                          (i, j))
                or (correlation and _gain_of_two(graph.planes, graph.sums, (i, j))
                    * cells.least_variance > MIN_HIDDEN_GAIN * correlation.density))
            if recall:
                is_two = recall.is_two(Decision.HIDDEN, CLEAR if is_two else 1 / CLEAR,
                                       graph.labels, (i, j))
            if is_two:
                return True
        return prefer_two_planes(cells, graph.labels, correlation, i, j, recall)

    for min_pairs in (1, 0):  # neighbours first
        test = OnePlane(PLANE, MAX_JOINT_VARIANCES, min_pairs=min_pairs)
        graph = merge_pairs(graph, partial(misfits, test=test), is_apart,
                            recall.most if recall else 1.0)
    return graph.without_merged()


def _folded(graph: RegionGraph, max_fold_deg: float) -> np.ndarray:
    """Return which large regions (K, K) have a larger angle between them."""
    if np.isinf(max_fold_deg):
        return np.empty((0, 0), bool)
    fx, fy, x, y = graph.lens
    normals = unit_vectors(graph.planes @ np.array([[fx, 0, x], [0, fy, y], [0, 0, 1]]))
    is_large = graph.sums[:, N] >= MIN_FOLDED_SHARE * graph.labels.size
    return ((normals @ normals.T < np.cos(np.radians(max_fold_deg)))
            & is_large & is_large[:, None])


def _has_folded(folded: np.ndarray, graph: RegionGraph, i: int, j: int) -> bool:
    """Return whether any of the regions merged into i is folded against any of those in j."""
    return bool(folded.size and folded[graph.owner == i][:, graph.owner == j].any())


@kernel('boolean(float64[:, ::1], float64[:, ::1], float64[::1], UniTuple(int64, 2), float64)',
        is_short=True)
def _folds(planes, sums, lens, pair, density):
    """Return whether the angle between two planes is larger than that of pieces of one plane."""
    variance, dot, square, normals = 0.0, 0.0, 1.0, np.empty((2, 3))
    for side in range(2):
        k, of_normal = pair[side], 0.0
        normal = normal_of(planes[k, 0], planes[k, 1], planes[k, 2], lens)
        for axis in range(3):
            normals[side, axis] = normal[axis]
            of_normal += normal[axis] * normal[axis]
        x, y = sums[k, X] / sums[k, N], sums[k, Y] / sums[k, N]
        # The slope of a plane has the variance of its means over the spread of its cells, which
        # is least across a narrow region.
        xx, xy = sums[k, XX] / sums[k, N] - x * x, sums[k, XY] / sums[k, N] - x * y
        yy = sums[k, YY] / sums[k, N] - y * y
        narrow = (xx + yy) / 2 - math.hypot((xx - yy) / 2, xy)
        slope2 = density / (sums[k, N] * max(narrow, MIN_VARIANCE))
        variance += slope2 * lens[0] ** 2 / of_normal
        square *= of_normal
    for axis in range(3):
        dot += normals[0, axis] * normals[1, axis]
    fold_deg = math.degrees(math.acos(min(max(dot / math.sqrt(square), -1.0), 1.0)))
    return fold_deg > max(MAX_HIDDEN_FOLD_DEG, FOLD_DEVIATIONS * math.degrees(math.sqrt(variance)))


@kernel('float64(float64[:, ::1], float64[:, ::1], UniTuple(int64, 2))', is_short=True)
def _gain_of_two(planes, sums, pair):
    """
    Return how much worse a joint plane fits two regions than their own, in variances.

    For large regions that of MAX_CELLS cells: slow errors do not average out over more.
    """
    i, j = pair
    a, b, c = fit_plane(sums[i, :10] + sums[j, :10])
    gain = 0.0
    for k in pair:
        own = squared_error(planes[k, 0], planes[k, 1], planes[k, 2], sums[k])
        gain += (squared_error(a, b, c, sums[k]) - own) * sums[k, N] / sums[k, VARIANCE]
    return gain * min(1.0, MAX_CELLS / (sums[i, N] + sums[j, N]))


def merge_bowed_walls(graph: RegionGraph) -> RegionGraph:
    """Merge adjacent regions that one slightly bent quadric fits as well as their planes do."""
    # The angle is approximate, since the shift of the disparity may be unknown.
    bowed = OnePlane(QUADRIC, MAX_BOW_RATIO, max_fold_deg=MIN_CREASE_DEG)
    folded = _folded(graph, MAX_NETWORK_FOLD_DEG)

    def is_apart(graph: RegionGraph, i: int, j: int, _: float) -> bool:
        # A bow is a quadric within the noise, however far the wall turns.
        return _has_folded(folded, graph, i, j) and (
            fit_quadric(graph.sums[i], graph.sums[j], ALL_ERRORS)[2] > 1 / ALL_ERRORS)
    return merge_pairs(graph, partial(misfits, test=bowed), is_apart).without_merged()


def join_nearly_flat(cells: WeightedCells, graph: RegionGraph, removed: np.ndarray,
                     correlation: Correlation | None,
                     config: SegmentationConfig, recall: Recall | None = None
                     ) -> tuple[np.ndarray, np.ndarray]:
    """
    Merge adjacent regions that are flat within the settings, flattest pair first.

    A step between them that model selection confirms keeps them apart.

    Parameters
    ----------
    cells : WeightedCells
    graph : RegionGraph
        Of 1/z in 1/metres.
    removed : (n,) int
        Regions that are not joined to others.
    correlation : Correlation or None
        Of the noise, for model selection; if None, all pairs that fit are merged.
    config : SegmentationConfig
        Its ``flatness_distance`` and ``flatness_angle`` are used.
    recall : Recall, optional
        Of the image before.

    Returns
    -------
    owner : (K,) int
        The region that each is part of, itself if it is not joined.
    coefficients : (K, 3) float64
        Refitted for regions that others joined.

    """
    def is_apart(graph: RegionGraph, i: int, j: int, misfit: float) -> bool:
        if i in removed or j in removed or (
                recall and recall.is_two(Decision.FLAT, misfit, graph.labels, (i, j))):
            return True
        _, _, gap = fold(graph.planes, graph.sums, graph.borders, graph.lens, i, j)
        # The difference of two cells has this deviation: a smaller gap is a dip, not a step.
        return gap > 2**0.5 and prefer_two_planes(cells, graph.labels, correlation, i, j, recall)

    if config.flatness_distance > 0:
        flat = OnePlane(PLANE_M, config.flatness_distance, MAX_DEVIATIONS, config.flatness_angle)
        graph = merge_pairs(graph, partial(misfits, test=flat), is_apart,
                            recall.most if recall else 1.0)
    return graph.owner, graph.planes


def misfits(graph: RegionGraph, test: OnePlane) -> np.ndarray:
    """Return the misfit (K, K) of pairs i < j, up to 1 for one plane; infinity elsewhere."""
    return _misfits(graph.planes, graph.sums, graph.borders, graph.lens, tuple(test))


@kernel('float64[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[::1], '
        'Tuple((int64, float64, float64, float64, int64)))', is_short=True)
def _misfits(planes, sums, borders, lens, test):
    surface, tolerance, max_gap, max_fold_deg, min_pairs = test
    misfit, joint = np.full((len(planes), len(planes)), np.inf), np.empty(10)
    for i in range(len(planes)):
        for j in range(i + 1, len(planes)):
            if (borders[i, j, PAIRS] < min_pairs or sums[i, N] == 0 or sums[j, N] == 0
                    or normals_differ(sums, lens, i, j)):
                continue
            fold_deg, gap = 0.0, 0.0
            if np.isfinite(max_fold_deg):
                fold_deg, _, gap = fold(planes, sums, borders, lens, i, j)
            is_one = fold_deg <= max_fold_deg
            if is_one and gap >= max_gap:
                is_one = (surface == PLANE_M and fit_quadric(sums[i], sums[j],
                                                             MIN_NOISE_SHARE)[2] < MAX_RATIO)
            if is_one:
                misfit[i, j] = _joint_misfit(sums, lens, i, j, joint, surface) / tolerance
            if surface == PLANE:
                large, small = (i, j) if sums[i, N] >= sums[j, N] else (j, i)
                bulge = squared_error(planes[large, 0], planes[large, 1], planes[large, 2],
                                      sums[small]) / sums[small, VARIANCE]
                misfit[i, j] = min(misfit[i, j], bulge / MAX_BULGE_VARIANCES)
    return misfit


@kernel('float64(float64[:, ::1], float64[::1], int64, int64, float64[::1], int64)')
def _joint_misfit(sums, lens, i, j, joint, surface):
    """Return the misfit of a surface to the worse of two regions; ``joint`` is overwritten."""
    if surface == QUADRIC:
        return fit_quadric(sums[i], sums[j], MIN_NOISE_SHARE)[2]
    for k in range(len(joint)):
        joint[k] = sums[i, k] + sums[j, k]
    a, b, c = fit_plane(joint)
    if np.isnan(a):
        return np.inf
    worst, normal = -np.inf, normal_of(a, b, c, lens)
    offset_m = 1 / np.sqrt(normal[0]**2 + normal[1]**2 + normal[2]**2)
    for k in (i, j):
        square = squared_error(a, b, c, sums[k])
        if surface == PLANE:
            worst = max(worst, square / sums[k, VARIANCE])
        else:  # a point at 1/z is off the plane by offset_m times its relative residual
            worst = max(worst, offset_m * np.sqrt(max(square, 0.0) * sums[k, N]) / sums[k, D])
    return worst


@kernel('boolean(float64[:, ::1], float64[::1], int64, int64)')
def normals_differ(sums, lens, i, j):
    """
    Return whether normals show that two regions lie on two planes.

    The slopes of the disparity are constant on a plane. The scatter of the normals' slopes within
    a region is their noise.
    """
    if min(sums[i, NORMALS], sums[j, NORMALS]) <= PLANE_TERMS:
        return False
    apart, variance = 0.0, 0.0
    for slope in (NORMAL_X, NORMAL_Y):
        apart += (sums[i, slope] / sums[i, NORMALS] - sums[j, slope] / sums[j, NORMALS]) ** 2
    for k in (i, j):
        n = sums[k, NORMALS]
        min_slope = np.radians(MIN_NORMAL_ERROR_DEG) * sums[k, NORMALS_D] / n / lens[0]
        spread = (sums[k, NORMAL_SQUARES] / n - (sums[k, NORMAL_X] / n) ** 2
                  - (sums[k, NORMAL_Y] / n) ** 2)
        variance += max(spread, 0.0) / 2 + min_slope**2
    return apart > MAX_DEVIATIONS**2 * variance


@kernel('boolean(int32[:, ::1], float64[:, ::1], boolean[::1], float64[:, ::1], '
        'UniTuple(int64, 2))', is_short=True)
def _is_hidden_between(labels, table, is_planar, sums, pair):
    """Sample straight lines from cells of one region to the nearest cells of the other."""
    (rows, columns), first, second = labels.shape, pair[0], pair[1]
    at, count, joint = np.empty((2, labels.size, 2)), np.zeros(2, np.int64), np.empty(10)
    for k in range(10):
        joint[k] = sums[first, k] + sums[second, k]
    a, b, c = fit_plane(joint)
    for row in range(rows):
        for column in range(columns):
            if labels[row, column] == first or labels[row, column] == second:
                side = int(labels[row, column] == second)
                at[side, count[side], 0], at[side, count[side], 1] = row, column
                count[side] += 1
    farther, seen, last = 0.0, 0, SIGHT_LINES - 1
    for line in range(SIGHT_LINES):
        start = at[0, (count[0] - 1) * line // last]
        end, nearest = start, np.inf
        for k in range(count[1]):
            square = (at[1, k, 0] - start[0]) ** 2 + (at[1, k, 1] - start[1]) ** 2
            if square < nearest:
                end, nearest = at[1, k], square
        for sample in range(SIGHT_LINES):
            row = int(np.rint(start[0] + sample / last * (end[0] - start[0])))
            column = int(np.rint(start[1] + sample / last * (end[1] - start[1])))
            i, label = row * columns + column, labels[row, column]
            # A cell that straddles an edge is neither nearer nor farther.
            if label != first and label != second and is_planar[i]:
                seen += 1
                deviations = -residual(table, i, a, b, c) * np.sqrt(table[i, MEAN_WEIGHT])
                farther += min(max(deviations / MAX_DEVIATIONS - 1, 0.0), 1.0)
    return farther <= MAX_FARTHER_SHARE * seen

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Removal of curved regions.

Within the tolerance of any method, a curtain or a cushion is a row of narrow planes. The cells of
a single region show the curvature: a quadric fits them far better than a plane (F-test), and the
normal turns from one end to the other. Noise hides this, and a column becomes three or four
planes. A quadric has as many parameters as the two planes of a pair: it fits a bend as well as the
planes do in either region, but a fold between planes worse. Noise hides this too: a pair that fits
within the noise is a weak bend. A single weak bend may be a fold by chance, but not a chain of
three regions, nor the neighbour of a curved region.
"""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.segmentation.cells.grid import (
    XX,
    XY,
    YY,
    D,
    N,
    X,
    Y,
    normal_of,
    solve_least_squares,
)
from plane_detector.segmentation.cells.model import MAX_DEVIATIONS, MIN_VARIANCE
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.region_graph import (
    PAIRS,
    PLANE_TERMS,
    PRODUCTS,
    VARIANCE,
    RegionGraph,
    fold,
)

# The coefficients of a quadric over the image.
QUADRIC_TERMS = len(PRODUCTS) - 1
# Threshold of the F-statistic: improvement of the fit by the quadric over the noise.
# derived: planes reach it once in 40 000 times (chi-squared with 3 degrees of freedom is 24).
MIN_F = 8.0
# The share of its variogram half across a region that noise takes in each further coefficient of a
# quadric.
# derived: .048 to .052 for a random walk over squares of 8 to 30 cells; for the powers of sensors,
# .9 to 1.8, from .02 to .08.
BEND_SHARE = 0.05
# A single region must turn by as many times more as its radius is larger: trays, tables and floors
# that bow by millimetres over tens of centimetres are planes for every user, though the bow is
# clear in a sensor's depth.
# chosen: columns, pipes and balls measure up to 1.4 m (benchmark accuracy), bowed trays and floors
# of real sensors from 4.9 m; curved scenes are the same at 2 m.
MAX_RADIUS_M = 1.5
# Planes that meet at more than this have an edge between them.
# tuned: curved scenes, rooms and lived-in rooms below seed 9000; 0.03 more of curved surfaces have
# labels at noise 0.01 at 60, recall of lived-in rooms -0.016 at 90.
MAX_FOLD_DEG = 70.0
# Largest ratio of the quadric's error to the plane's error in one of the regions.
# tuned: benchmark curved of 28e5049; flat from 1.4 to 2; at 1.3 0.04 more of the curved surfaces
# have labels at noise 0.01; from 1.5 on walls of real frames are lost.
MAX_RATIO = 1.4
# Share of the noise that counts. Small regions fit the noise, so this is the lower bound of the
# error of their planes. A pair is bent if one plane fits worse than the quadric by the noise, and
# weakly bent if it does so by more than this share.
# tuned: curved scenes, rooms, lived-in rooms and sensor frames: flat from 0.1 to 0.35.
MIN_NOISE_SHARE = 0.2
# derived: as many regions in a row turn twice.
MIN_CHAIN = 3


@kernel('float64[:, ::1](float64[::1])')
def _products(sums):
    products = np.empty((7, 7))
    for row in range(7):
        for column in range(7):
            products[row, column] = sums[PRODUCTS[row, column]]
    return products


@kernel('UniTuple(float64, 3)(float64[::1], float64[::1], float64)')
def fit_quadric(first, second, noise_share):
    """
    Fit one plane and one quadric to a pair of regions, given by their sums.

    Return how much less the squared error of the quadric is, as a share of the noise; and the
    ratio of its error to that of the regions' own planes, over both and over the worse region. The
    errors of these planes are at least ``noise_share`` of the noise.
    """
    joint, quadric, total, worst = _products(first + second), np.zeros(7), 0.0, 0.0
    of_plane = solve_least_squares(joint, PLANE_TERMS, quadric)
    of_quadric = solve_least_squares(joint, QUADRIC_TERMS, quadric)
    quadric[6] = -1.0
    for sums in (first, second):
        products, error = _products(sums), 0.0
        for row in range(7):
            for column in range(7):
                error += quadric[row] * products[row, column] * quadric[column]
        own = solve_least_squares(products, PLANE_TERMS, np.empty(7))
        own = max(own, noise_share * sums[VARIANCE])
        total, worst = total + own, max(worst, error / own)
    gain = (of_plane - of_quadric) / (first[VARIANCE] + second[VARIANCE])
    return gain, of_quadric / total, worst


def find_curved(graph: RegionGraph, noise_density: float, min_turn_deg: float,
                bending: float, max_radius_m: float = np.inf,
                correlation: Correlation | None = None,
                much: np.ndarray | None = None) -> np.ndarray:
    """
    Find regions that a quadric explains better than a plane, alone or together with neighbours.

    Parameters
    ----------
    graph : RegionGraph
    noise_density : float
        Variance of a cell times the number of cells that share their noise; at least that of each
        cell counts.
    min_turn_deg : float
        Surfaces whose normals turn by less are planes with a dent.
    bending : float
        Of the noise. The systematic errors of neighbouring regions are the same: the fits of a
        pair are judged by the errors about planes alone, but for the gap between them, since
        planes that may be bent lie off a curved surface along their border.
    max_radius_m : float
        Single regions of a larger radius must turn by more; infinite without metres.
    correlation : Correlation or None
        Of the noise; it replaces ``noise_density``.
    much : (K,) float64, optional
        How many times the limits each must exceed, a pair their geometric mean; default: once.

    Returns
    -------
    (n,) int
        Their indices.

    """
    sums, max_gap = graph.sums.copy(), bending * MAX_DEVIATIONS
    sums[:, VARIANCE] /= bending**2
    # Without a correlation the variogram bounds nothing.
    of_bows = (noise_density, np.inf, 0.0, 0.0, 1.0, 1.0)
    if correlation is not None:
        of_bows = correlation.of_bows
    if much is None:
        much = np.ones(len(sums))
    return np.flatnonzero(_in_bends(_bends(graph.planes, sums, graph.borders, graph.lens, of_bows,
                                           (min_turn_deg, max_gap, max_radius_m), much)))


@kernel('int8[:, ::1](float64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[::1], '
        'UniTuple(float64, 6), UniTuple(float64, 3), float64[::1])', is_short=True)
def _bends(planes, sums, borders, lens, of_bows, limits, much):
    """Return 2 for regions and pairs that are clearly bent, 1 for weak bends, 0 for others."""
    (min_deg, max_gap, max_radius), count = limits, len(planes)
    bends = np.zeros((count, count), np.int8)
    for i in range(count):
        bends[i, i] = 2 * _is_curved(sums[i], lens, of_bows, min_deg, max_radius, much[i])
        for j in range(i + 1, count):
            if borders[i, j, PAIRS] == 0:
                continue
            fold_deg, gap, _ = fold(planes, sums, borders, lens, i, j)
            by = np.sqrt(much[i] * much[j])
            # A gap that bends explain counts along a side: the root of a square's number of cells.
            side = np.sqrt(min(sums[i, N], sums[j, N]))
            most = max_gap if borders[i, j, PAIRS] >= side else MAX_DEVIATIONS
            if gap * by >= most or not min_deg * by < fold_deg < MAX_FOLD_DEG:
                continue
            gain, _, worst = fit_quadric(sums[i], sums[j], 1.0)
            if gain > MIN_NOISE_SHARE * by and worst * by < MAX_RATIO:
                _, total, worst = fit_quadric(sums[i], sums[j], MIN_NOISE_SHARE)
                bends[i, j] = bends[j, i] = 1 + (gain > by and total * by < 1
                                                 and worst * by < MAX_RATIO)
    return bends


@kernel('boolean(float64[::1], float64[::1], UniTuple(float64, 6), float64, float64, float64)')
def _is_curved(sums, lens, of_bows, min_deg, max_radius, much):
    """Return whether a quadric fits far better than a plane and turns by more than the angle."""
    count, mean, quadric, products = sums[N], sums[D] / sums[N], np.zeros(7), _products(sums)
    of_plane, plane = solve_least_squares(products, PLANE_TERMS, quadric), quadric.copy()
    of_quadric = solve_least_squares(products, QUADRIC_TERMS, quadric)
    # The bend over the width of the region along each direction, whose variance is a twelfth of
    # the width squared: its squares have this trace.
    xx, xy, yy = 2 * quadric[3], quadric[4], 2 * quadric[5]
    x, y = sums[X] / count, sums[Y] / count
    of_x, of_y = sums[XX] / count - x * x, sums[YY] / count - y * y
    of_xy = sums[XY] / count - x * y
    along_x = xx * xx * of_x + xy * xy * of_y + 2 * xx * xy * of_xy
    along_y = xy * xy * of_x + yy * yy * of_y + 2 * xy * yy * of_xy
    # Half across the region, along the bend, the noise has changed by its variogram.
    half2 = 3 * (along_x + along_y) / max(xx * xx + 2 * xy * xy + yy * yy, MIN_VARIANCE)
    density, own, smooth, decay, power, columns = of_bows
    change = own - smooth * np.expm1(-decay * (columns * columns * half2) ** (power / 2))
    variance = max(of_quadric / (count - QUADRIC_TERMS), sums[VARIANCE] / count,
                   min(density, BEND_SHARE * count * change))
    if of_plane - of_quadric <= MIN_F * (QUADRIC_TERMS - PLANE_TERMS) * variance * much:
        return False
    turn = np.sqrt(max(12 * (lens[0]**2 * along_x + lens[1]**2 * along_y), 0.0))
    # Along a ray of slope X the depth bends by the second derivative of 1/z by X per square metre,
    # across the surface by that times the cosine of the angle at which it is seen.
    normal = normal_of(plane[1], plane[2], plane[0], lens)
    cosine = mean / np.sqrt(normal[0]**2 + normal[1]**2 + normal[2]**2)
    xx, xy, yy = lens[0]**2 * xx, lens[0] * lens[1] * xy, lens[1]**2 * yy
    curvature = abs(xx + yy) / 2 + np.sqrt((xx - yy)**2 / 4 + xy**2)
    turn_deg = np.degrees(np.arctan2(turn, mean))
    return turn_deg > min_deg * much * max(1.0, 1 / (max_radius * curvature * cosine))


@kernel('boolean[::1](int8[:, ::1])', is_short=True)
def _in_bends(bends):
    """Return which regions bends link to a clear one (hysteresis, Canny 1986) or to a chain."""
    # Loops throughout: an operation on arrays takes up to a second to compile.
    count, found = len(bends), np.zeros(len(bends), np.bool_)
    linked, strongest = np.empty(bends.shape, np.bool_), np.zeros(count, np.int8)
    for i in range(count):
        for k in range(count):
            linked[i, k], strongest[i] = bends[i, k] > 0, max(strongest[i], bends[i, k])
    for through in range(count):  # transitive closure (Warshall 1962)
        for i in range(count):
            for k in range(count if linked[i, through] else 0):
                linked[i, k] |= linked[through, k]
    for i in range(count):
        size = is_clear = 0
        for k in range(count):
            if k == i or linked[i, k]:
                size, is_clear = size + 1, max(is_clear, strongest[k])
        found[i] = is_clear > 1 or size >= MIN_CHAIN
    return found

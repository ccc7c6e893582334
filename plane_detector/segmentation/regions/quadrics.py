# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Quadric surfaces fitted to regions and pairs of regions, and dihedral angles of planes.

Noise hides the curvature of a single region, so that a column or a cushion becomes three or four
planes. A quadric has as many parameters as the two planes of a pair: it fits a bend better than
the two planes do, and a fold between planes worse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.compilation import kernel
from plane_detector.segmentation.cells.model import MIN_VARIANCE, PlaneRegions, WeightedCells
from plane_detector.segmentation.cells.plane_fit import solve_least_squares
from plane_detector.segmentation.regions.adjacency import RegionAdjacency, sum_up_regions
from plane_detector.segmentation.search.plane_search import TYPICAL_FOCAL_SHARE

# derived: coefficients of a plane and of a quadric over the image.
PLANE_TERMS, QUADRIC_TERMS = 3, 6


@dataclass(frozen=True)
class Quadrics:
    """
    Products of each region for surface fits.

    Attributes
    ----------
    products : (K, 7, 7) float64
        Sums over the planar cells of products of two of 1, x, y, xx, xy, yy and d.
    noise : (K,) float64
        Squared error expected from the noise.
    error : (K,) float64
        Squared error of the region's own plane.

    """

    products: np.ndarray
    noise: np.ndarray
    error: np.ndarray


def sum_up_quadrics(cells: WeightedCells, regions: PlaneRegions) -> Quadrics:
    """Sum the products over the cells of each region."""
    sums = sum_up_regions(cells, regions)
    centre = sums.moments[:, [1, 2, 6]].sum(axis=0) / sums.count.sum()
    products = quadric_products(cells, regions.labels,
                                np.repeat(centre[None], len(sums.count), axis=0))
    return Quadrics(products, sums.variance * sums.count, fit_surfaces(products, PLANE_TERMS)[0])


def quadric_products(cells: WeightedCells, labels: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the products (K, 7, 7) of the planar cells about the centres (K, 3)."""
    return _products(np.ascontiguousarray(labels).reshape(-1), cells.table, cells.is_planar,
                     np.ascontiguousarray(centre))


@kernel('float64[:, :, ::1](int32[::1], float64[:, ::1], boolean[::1], float64[:, ::1])')
def _products(labels, table, is_planar, centre):
    products = np.zeros((len(centre), 7, 7))
    terms = np.ones(7)
    for i in range(len(labels)):
        k = labels[i]
        if k < 0 or not is_planar[i]:
            continue
        x, y = table[i, 0] - centre[k, 0], table[i, 1] - centre[k, 1]
        terms[1], terms[2], terms[3], terms[4], terms[5] = x, y, x * x, x * y, y * y
        terms[6] = table[i, 2] - centre[k, 2]
        for row in range(7):
            for column in range(7):
                products[k, row, column] += terms[row] * terms[column]
    return products


@kernel('Tuple((float64[::1], float64[:, ::1]))(float64[:, :, ::1], int64)')
def fit_surfaces(products, terms):
    """
    Fit planes (3 terms) or quadrics (6 terms) to products (G, 7, 7).

    Returns
    -------
    error : (G,) float64
        Squared error.
    coefficients : (G, 7) float64
        Of the surface; the last column, for the disparity, is -1.

    """
    error, coefficients = np.zeros(len(products)), np.zeros((len(products), 7))
    for g in range(len(products)):
        error[g] = solve_least_squares(products[g], terms, coefficients[g])
        coefficients[g, 6] = -1.0
    return error, coefficients


def fit_pairs(quadrics: Quadrics, first: np.ndarray,
              second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Fit one quadric to each pair of regions.

    Returns
    -------
    plane_error, joint_error : (P,) float64
        Squared error of one plane, and of one quadric.
    errors : (P, 2) float64
        Squared error of the quadric over each of the two.

    """
    products = quadrics.products[first] + quadrics.products[second]
    joint, surface = fit_surfaces(products, QUADRIC_TERMS)
    errors = [np.einsum('pi,pij,pj->p', surface, quadrics.products[side], surface)
              for side in (first, second)]
    return fit_surfaces(products, PLANE_TERMS)[0], joint, np.stack(errors, axis=1)


def folds(cells: WeightedCells, regions: PlaneRegions,
          adjacency: RegionAdjacency) -> tuple[np.ndarray, np.ndarray]:
    """Return the dihedral angle of each pair, degrees, and the gap, deviations; (P,)."""
    normals = regions.coefficients * [TYPICAL_FOCAL_SHARE, TYPICAL_FOCAL_SHARE, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = (normals[adjacency.first] * normals[adjacency.second]).sum(axis=1)
    variance = sum_up_regions(cells, regions).variance[adjacency.first]
    gap = adjacency.gap(regions.coefficients) / np.sqrt(np.maximum(variance, MIN_VARIANCE))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))), gap

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Least-squares fits to any set of cells, from products that are added up once."""

from __future__ import annotations

import numpy as np

# Of terms of like size: what a fit to too few cells leaves open.
LEAST_EIGENVALUE = 1e-10


def quadratic_products(members: np.ndarray, x: np.ndarray, y: np.ndarray,
                       d: np.ndarray) -> np.ndarray:
    """
    Add up what fits of surfaces need over the cells of each patch.

    Parameters
    ----------
    members : (K, n) float64
        1 or 0: the cells of each patch.
    x, y, d : (n,) float64
        Place and disparity of each cell.

    Returns
    -------
    (K, 7, 7) float64
        Sums of the products of two of 1, x, y, xx, xy, yy and d.

    """
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, d], axis=1)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(len(x), -1)
    return (members @ products).reshape(-1, 7, 7)


def least_squares(products: np.ndarray, terms: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit what is linear in its coefficients: planes, of 3 terms, or quadratic surfaces, of 6.

    Parameters
    ----------
    products : (K, 7, 7) float64
        As :func:`quadratic_products` gives them; the last row and column belong to the values.
    terms : int
        How many of the first rows and columns to use.

    Returns
    -------
    error : (K,) float64
        Squared error.
    coefficients : (K, terms) float64

    """
    normal_matrix, projection = products[:, :terms, :terms], products[:, :terms, 6]
    square = products[:, 6, 6]
    scale = np.sqrt(np.maximum(np.einsum('kii->ki', normal_matrix), np.finfo(float).tiny))
    unit = normal_matrix / (scale[:, :, None] * scale[:, None, :])
    coefficients = (pseudo_inverse(unit, LEAST_EIGENVALUE)
                    @ (projection / scale)[..., None])[..., 0] / scale
    return np.maximum(square - (coefficients * projection).sum(axis=1), 0), coefficients


def pseudo_inverse(matrix: np.ndarray, least: float) -> np.ndarray:
    """
    Return the pseudo-inverses of symmetric matrices (K, n, n), as numpy's pinv but faster.

    Eigenvalues of less than this share of the largest are taken for zero.
    """
    values, vectors = np.linalg.eigh(matrix)
    size = np.abs(values)
    large = size > least * size.max(axis=1, keepdims=True)
    inverse = np.divide(1, values, out=np.zeros_like(values), where=large)
    return (vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1)

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Least-squares planes from moments, and linear least squares from sums of products."""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel

# derived: columns of moments, sums over pixels of 1, x, y, xx, xy, yy, d, xd, yd and dd.
N, X, Y, XX, XY, YY, D, XD, YD, DD = range(10)

# chosen: far above the rounding of float64. A smaller eigenvalue, relative to the largest one,
# counts as zero: the pixels lie on a line, or there are too few cells for the fit.
MIN_EIGENVALUE = 1e-10


@kernel('void(float64[::1], float64[::1])')
def add_moments(total, moments):
    """Add moments (10,); on a row of a matrix six times as fast as with its index in the loop."""
    for j in range(10):
        total[j] += moments[j]


@kernel('UniTuple(float64, 3)(float64[::1])')
def fit_plane(moments):
    """
    Fit the least-squares plane d = a x + b y + c.

    Parameters
    ----------
    moments : (10,) float64
        Sums over pixels.

    Returns
    -------
    a, b, c : float
        NaN where the pixels lie on a line or are fewer than three.

    """
    per = 1 / max(moments[N], 1.0)
    x, y, d = moments[X] * per, moments[Y] * per, moments[D] * per
    xx, xy, yy = moments[XX] * per - x * x, moments[XY] * per - x * y, moments[YY] * per - y * y
    xd, yd = moments[XD] * per - x * d, moments[YD] * per - y * d
    determinant = xx * yy - xy * xy
    if not determinant > MIN_EIGENVALUE * (xx + yy) ** 2:
        return np.nan, np.nan, np.nan
    inverse = 1 / determinant
    a, b = (yy * xd - xy * yd) * inverse, (xx * yd - xy * xd) * inverse
    return a, b, d - a * x - b * y


@kernel('UniTuple(float64, 3)(float64, float64, float64, float64[::1])')
def normal_of(a, b, c, lens):
    """Return a normal of the plane 1/z = a x + b y + c, as long as 1 over its distance."""
    return a * lens[0], b * lens[1], a * lens[2] + b * lens[3] + c


@kernel('float64(float64, float64, float64, float64[::1])')
def squared_error(a, b, c, moments):
    """Return the squared error of a plane over the pixels of moments (10,)."""
    return (moments[DD] + c * (c * moments[N] + 2 * (a * moments[X] + b * moments[Y] - moments[D]))
            + a * (a * moments[XX] + 2 * (b * moments[XY] - moments[XD]))
            + b * (b * moments[YY] - 2 * moments[YD]))


@kernel('float64[:, ::1](float64[:, ::1])', is_short=True)
def fit_planes(moments):
    """Fit a plane to each row of moments (K, 10), as :func:`fit_plane` does; (K, 3)."""
    planes = np.empty((len(moments), 3))
    for k in range(len(moments)):
        planes[k, 0], planes[k, 1], planes[k, 2] = fit_plane(moments[k])
    return planes


@kernel('float64(float64[:, ::1], int64, float64[::1])')
def solve_least_squares(products, terms, coefficients):
    """
    Solve a linear least-squares problem by Gauss-Jordan elimination.

    Parameters
    ----------
    products : (m, m) float64
        Sums of the products of any two columns: the terms, and last the values.
    terms : int
        How many of the first terms to use.
    coefficients : (m,) float64
        Output: the first ``terms`` are written; 0 for terms that the data do not determine.

    Returns
    -------
    float
        Squared error.

    """
    last = len(products) - 1
    work = products.copy()
    for k in range(terms):
        pivot = work[k, k]
        is_open = pivot <= MIN_EIGENVALUE * products[k, k]
        for j in range(last + 1):
            work[k, j] = 0.0 if is_open else work[k, j] / pivot
        for i in range(last + 1):
            factor = 0.0 if i == k else work[i, k]
            for j in range(last + 1):
                work[i, j] -= factor * work[k, j]
    for k in range(terms):
        coefficients[k] = work[k, last]
    return max(work[last, last], 0.0)

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of the arrays of cells that the compiled loops read and write."""

from __future__ import annotations

# derived: of moments, sums over pixels of 1, x, y, xx, xy, yy, d, xd, yd and dd.
N, X, Y, XX, XY, YY, D, XD, YD, DD = range(10)
# derived: of WeightedCells.table: means of x, y and d, dd/dx and dd/dy, the inverse variances of
# these means and slopes, and the expected squared error of the pixels about a plane.
MEAN_X, MEAN_Y, MEAN_D, SLOPE_X, SLOPE_Y, MEAN_WEIGHT, SLOPE_WEIGHT, SQUARED_ERROR = range(8)

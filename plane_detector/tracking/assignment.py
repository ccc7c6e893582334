# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Assignment of rows to columns by the Hungarian method [Kuhn 1955]; scipy's takes 46 MB."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import kernel


def best_pairs(score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return rows and columns, one to one, with the largest sum of scores.

    Parameters
    ----------
    score : (N, M) float64
        Finite.

    Returns
    -------
    rows, columns : (min(N, M),) int64
        Ordered by the rows.

    Examples
    --------
    >>> rows, columns = best_pairs(np.array([[0.9, 0.8], [0.7, 0.1]]))
    >>> rows.tolist(), columns.tolist()
    ([0, 1], [1, 0])

    """
    if score.shape[0] > score.shape[1]:
        columns, rows = best_pairs(score.T)
        order = np.argsort(rows)
        return rows[order], columns[order]
    return np.arange(score.shape[0]), _columns(np.ascontiguousarray(-score, float))


@kernel('int64[::1](float64[:, ::1])', is_short=True)
def _columns(cost):
    """Return the column of each row; rows and columns count from 1, 0 is that of no partner."""
    height, width = cost.shape
    row_price, column_price = np.zeros(height + 1), np.zeros(width + 1)
    row_of, column_before = np.zeros(width + 1, np.int64), np.zeros(width + 1, np.int64)
    for row in range(1, height + 1):
        # The cheapest way from this row to a free column, over columns that change their row.
        row_of[0], column = row, 0
        distance, is_visited = np.full(width + 1, np.inf), np.zeros(width + 1, np.bool_)
        while row_of[column]:
            is_visited[column] = True
            here, nearest, step = row_of[column], 0, np.inf
            for other in range(1, width + 1):
                if is_visited[other]:
                    continue
                way = cost[here - 1, other - 1] - row_price[here] - column_price[other]
                if way < distance[other]:
                    distance[other], column_before[other] = way, column
                if distance[other] < step:
                    step, nearest = distance[other], other
            for other in range(width + 1):
                if is_visited[other]:
                    row_price[row_of[other]] += step
                    column_price[other] -= step
                else:
                    distance[other] -= step
            column = nearest
        while column:
            row_of[column] = row_of[column_before[column]]
            column = column_before[column]
    found = np.empty(height, np.int64)
    for column in range(1, width + 1):
        if row_of[column]:
            found[row_of[column] - 1] = column - 1
    return found

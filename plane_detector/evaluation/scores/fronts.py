# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The table of all fronts."""

from __future__ import annotations

from plane_detector.evaluation.scores import colour, cost, measured, robots
from plane_detector.evaluation.scores.table import Measurement

MEASUREMENTS: tuple[Measurement, ...] = (
    *measured.MEASUREMENTS, *colour.MEASUREMENTS, *robots.MEASUREMENTS,
    *cost.MEASUREMENTS)

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tools for developers to evaluate the package: scenes, metrics, benchmarks; not installed."""

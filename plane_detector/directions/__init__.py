# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Directions of the scene from the straight lines of an image: gravity and horizontal axes."""

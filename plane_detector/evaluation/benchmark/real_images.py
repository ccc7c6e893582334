# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Real images and networks, or why there are none."""

from __future__ import annotations

from pathlib import Path

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.model_zoo import NetworkUnavailableError
from plane_detector.evaluation.benchmark.tables import emit
from plane_detector.evaluation.datasets import Frame, frames, library_frames


def collect_frames(data: Path) -> list[Frame]:
    """Return the frames of the data folder and of the libraries; prints which are missing."""
    found: list[Frame] = []
    for source in (lambda: frames(data), library_frames):
        try:
            found += source()
        except (FileNotFoundError, ImportError) as error:
            emit(f'Not looked at: {error}.')
    return found


def load_network(model: str) -> tuple[DepthEstimator | None, str]:
    """
    Return a network and its name; None and the reason if it is not available.

    Raises
    ------
    ValueError, FileNotFoundError
        It is not a network, or its name is unknown.

    """
    try:
        estimate = DepthEstimator(DepthConfig(model=model))
    except NetworkUnavailableError as error:
        return None, f'absent: {error}'
    return estimate, f'{estimate.name}, {estimate.output}'

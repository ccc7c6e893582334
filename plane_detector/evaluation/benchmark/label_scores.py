# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""All metrics of one method on one frame, and tables of them over frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector.evaluation.benchmark.tables import table
from plane_detector.evaluation.metrics import (
    RECALL_ANGLES_DEG,
    RECALL_DEPTHS_M,
    depth_recall,
    known_mean,
    normal_recall,
    score,
)
from plane_detector.evaluation.plane_geometry import plane_depth
from plane_detector.types import CameraIntrinsics

Numbers = dict[str, float]
"""Metric to value; NaN where it is undefined."""
BY_DEPTH = [f'{depth_m:g} m' for depth_m in RECALL_DEPTHS_M]
BY_ANGLE = [f'{angle_deg:g} deg' for angle_deg in RECALL_ANGLES_DEG]


@dataclass(frozen=True)
class Truth:
    """
    True planes of a frame, and the depth of its sensor.

    Attributes
    ----------
    labels : (H, W) int
        Index into ``planes``, or -1.
    planes : (K, 4) float64
    depth_m : (H, W) floating
        NaN where unknown; such pixels do not count.
    intrinsics : CameraIntrinsics

    """

    labels: np.ndarray
    planes: np.ndarray
    depth_m: np.ndarray
    intrinsics: CameraIntrinsics


def numbers_of(truth: Truth, labels: np.ndarray, planes: np.ndarray) -> Numbers:
    """Return all metrics of predicted labels (H, W) and planes (J, 4) on a frame."""
    mask = np.isfinite(truth.depth_m)
    one = score(truth.labels, truth.planes, labels, planes, mask)
    numbers = {'SC': one.segmentation_covering, 'VOI': one.variation_of_information,
               'RI': one.rand_index, 'recall': one.recall, 'precision': one.precision,
               'normal error': one.normal_error_deg, 'offset error': one.offset_error_m,
               'true planes': float(len(truth.planes)),
               'true pixels': float(np.count_nonzero(mask & (truth.labels >= 0)))}
    if len(truth.planes):
        depth_m = plane_depth(labels, planes, truth.intrinsics)
        recalls = (*depth_recall(truth.labels, truth.depth_m, labels, depth_m, mask),
                   *normal_recall(truth.labels, truth.planes, labels, planes, mask))
    else:
        recalls = tuple(np.full(len(names), np.nan)
                        for names in (BY_DEPTH, BY_DEPTH, BY_ANGLE, BY_ANGLE))
    for kind, names, values in zip(('planes', 'pixels') * 2,
                                   (BY_DEPTH, BY_DEPTH, BY_ANGLE, BY_ANGLE), recalls, strict=True):
        numbers |= {f'{kind} {name}': float(value)
                    for name, value in zip(names, values, strict=True)}
    return numbers


def segmentation_table(rows: Mapping[str, Mapping[int, Numbers]]) -> str:
    """Return the Markdown table of the metrics without coefficients; rows by name and frame."""
    header = ('method', 'frames', 'SC', 'worst SC (frame)', 'VOI', 'RI', 'recall', 'precision',
              'normal error (deg)', 'offset error (cm)')
    lines = []
    for name, frames in rows.items():
        worst = min(frames, key=lambda number, frames=frames: frames[number]['SC'])
        lines.append([name, len(frames), f'{mean(frames, "SC"):.4f}',
                      f'{frames[worst]["SC"]:.3f} ({worst})', f'{mean(frames, "VOI"):.3f}',
                      f'{mean(frames, "RI"):.4f}', f'{mean(frames, "recall"):.4f}',
                      f'{mean(frames, "precision"):.4f}', f'{mean(frames, "normal error"):.2f}',
                      f'{100 * mean(frames, "offset error"):.1f}'])
    return table(header, lines)


def recall_table(rows: Mapping[str, Mapping[int, Numbers]]) -> str:
    """Return the Markdown table of recalls by depth and angle: planes / pixels."""
    lines = [[name, *(f'{100 * pooled(frames, f"planes {limit}", "true planes"):.1f} / '
                      f'{100 * pooled(frames, f"pixels {limit}", "true pixels"):.1f}'
                      for limit in (*BY_DEPTH, *BY_ANGLE))] for name, frames in rows.items()]
    return table(('method', *BY_DEPTH, *BY_ANGLE), lines)


def worst_table(rows: Mapping[str, Mapping[int, Numbers]], count: int) -> str:
    """Return the Markdown table of the frames with the lowest SC, by method."""
    lines = [[name, ', '.join(f'{number} ({frames[number]["SC"]:.2f})' for number in sorted(
        frames, key=lambda number, frames=frames: frames[number]['SC'])[:count])]
        for name, frames in rows.items()]
    return table(('method', f'{count} worst frames (SC)'), lines)


def mean(frames: Mapping[int, Numbers], name: str) -> float:
    """Return the mean of a metric over the frames where it is defined."""
    return known_mean(np.array([numbers[name] for numbers in frames.values()]))


def pooled(frames: Mapping[int, Numbers], name: str, weight: str) -> float:
    """Return a recall over the planes or pixels of all frames together."""
    pairs = np.array([(numbers[name], numbers[weight]) for numbers in frames.values()
                      if numbers[weight] > 0]).reshape(-1, 2)
    return float(np.average(pairs[:, 0], weights=pairs[:, 1])) if len(pairs) else float('nan')


def summary(rows: Mapping[str, Mapping[int, Numbers]], worst: int) -> Sequence[str]:
    """Return all tables with explanations, as blocks of Markdown."""
    return (segmentation_table(rows),
            'Means over the frames. Recall: true planes over 1500 pixels matched by IoU > 0.5; '
            'precision: predicted planes that match; errors: medians over the matches of a frame.',
            recall_table(rows),
            'Recall in percent, planes / pixels, over all frames together: IoU > 0.5 and depth or '
            'normal within the limit.', worst_table(rows, worst))

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Accuracy of a segmentation, measured as in the evaluation code of PlaneRCNN and ZeroPlane.

Label images are (H, W) int, -1 for no plane, which is an additional class on each side. Only
pixels of the mask count: those with valid true depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MIN_PIXELS = 1500
"""Smaller true planes are not counted as missed."""
PURE = 0.8
"""A plane with more than this share of its pixels on one true plane is compared with that one."""


@dataclass(frozen=True)
class Overlap:
    """Numbers of pixels common to true plane i and predicted plane j."""

    counts: np.ndarray  # (I + 1, J + 1) int64: the last row and column are for no plane
    iou: np.ndarray  # (I, J) float64: intersection over union of the planes


def overlap(true_labels: np.ndarray, labels: np.ndarray, mask: np.ndarray) -> Overlap:
    """Count the common pixels of two label images."""
    true_count = int(true_labels.max(initial=-1)) + 2
    count = int(labels.max(initial=-1)) + 2
    true_class = np.where(true_labels < 0, true_count - 1, true_labels)[mask].astype(np.int64)
    predicted_class = np.where(labels < 0, count - 1, labels)[mask]
    counts = np.bincount(true_class * count + predicted_class, minlength=true_count * count)
    counts = counts.reshape(true_count, count)
    union = counts.sum(1)[:, None] + counts.sum(0)[None, :] - counts
    return Overlap(counts, (counts / np.maximum(union, 1))[:-1, :-1])


def angle_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between unit vectors (..., 3)."""
    return np.degrees(np.arccos(np.clip((first * second).sum(-1), -1, 1)))


def pure_errors(shared: Overlap, true_planes: np.ndarray,
                planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles between PURE planes (J, 4) and the true ones, and their pixels."""
    on_plane, pixels = shared.counts[:-1, :-1], shared.counts[:, :-1].sum(axis=0)
    error_deg = angle_deg(true_planes[on_plane.argmax(axis=0), :3], planes[:, :3])
    is_pure = on_plane.max(axis=0) > PURE * pixels
    return error_deg[is_pure], pixels[is_pure]


def segmentation_covering(counts: np.ndarray) -> float:
    """Return the mean best IoU of the segments of both sides, weighted by their pixels."""
    return (covering_of_truth(counts) + covering_of_truth(counts.T)) / 2


def covering_of_truth(counts: np.ndarray) -> float:
    """Return the mean best IoU of the true segments alone, weighted by their pixels."""
    rows, columns = counts.sum(1), counts.sum(0)
    iou = counts / np.maximum(rows[:, None] + columns[None, :] - counts, 1)
    return float((rows * iou.max(1)).sum() / counts.sum())


@dataclass(frozen=True)
class Score:
    """The metrics of one image; see the functions and :func:`score`."""

    segmentation_covering: float
    recall: float
    precision: float
    normal_error_deg: float
    offset_error_m: float


def score(true_labels: np.ndarray, true_planes: np.ndarray, labels: np.ndarray,
          planes: np.ndarray, mask: np.ndarray, min_pixels: int = MIN_PIXELS) -> Score:
    """
    Compare a segmentation and its planes (J, 4) with the ground truth, planes (I, 4).

    Recall and precision count matches with IoU > 0.5; without true or predicted planes they are
    NaN. True planes up to ``min_pixels`` are not counted as missed, but a predicted plane may
    match any. The errors are medians over the matched planes.
    """
    shared = overlap(true_labels, labels, mask)
    large = shared.counts[:-1].sum(1) > min_pixels
    matches = shared.iou > 0.5
    true_index, index = np.nonzero(matches)
    cosine = np.abs((true_planes[true_index, :3] * planes[index, :3]).sum(1)).clip(0, 1)
    offset_error_m = np.abs(true_planes[true_index, 3] - planes[index, 3])
    return Score(
        segmentation_covering(shared.counts),
        known_mean(matches[large].any(1)), known_mean(matches.any(0)),
        *(float(np.median(errors)) if errors.size else float('nan')
          for errors in (np.degrees(np.arccos(cosine)), offset_error_m)))


def _distances_of_matches(shared: Overlap, true_labels: np.ndarray, true_depth_m: np.ndarray,
                          labels: np.ndarray, depth_m: np.ndarray,
                          mask: np.ndarray) -> np.ndarray:
    """Return the mean depth difference (I, J) over shared pixels; inf below IoU 0.5."""
    off_m = np.full(shared.iou.shape, np.inf)
    for i, j in zip(*np.nonzero(shared.iou > 0.5), strict=True):
        both = mask & (true_labels == i) & (labels == j)
        off_m[i, j] = np.abs(true_depth_m[both] - depth_m[both]).mean()
    return off_m


def found_within(true_labels: np.ndarray, true_depth_m: np.ndarray, labels: np.ndarray,
                 depth_m: np.ndarray, mask: np.ndarray,
                 limits_m: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the share of predicted planes, and of true ones, that match one within each limit.

    A match has IoU > 0.5 and a mean difference of the depths (H, W) of both planes over what they
    share of at most the limit. NaN without predicted, or without true planes.
    """
    shared = overlap(true_labels, labels, mask)
    off_m = _distances_of_matches(shared, true_labels, true_depth_m, labels, depth_m, mask)
    within = off_m[..., None] <= np.asarray(limits_m)
    is_seen = shared.counts[:, :-1].sum(axis=0) > 0, shared.counts[:-1].sum(axis=1) > 0
    precision, recall = (
        within.any(axis=axis)[seen].mean(axis=0) if seen.any() else np.full(len(limits_m), np.nan)
        for axis, seen in enumerate(is_seen))
    return precision, recall


PIECE_SHARE = 0.1
"""A predicted plane that covers this share of a true plane is one of its pieces."""


def labelled_score(true_labels: np.ndarray, labels: np.ndarray,
                   mask: np.ndarray) -> dict[str, float]:
    """
    Compare a segmentation with planes labelled by hand, where the mask says that they are known.

    A predicted plane with most of its pixels where there is no true plane, on an object for
    example, counts as no plane. Recall (IoU > 0.5) and pieces, the mean number of predicted planes
    with over PIECE_SHARE of a true plane's pixels, are of true planes over MIN_PIXELS. Merged: of
    the predicted planes with over half of a true plane, those with several; unlabelled: share of
    the true planes' pixels without a predicted plane.
    """
    counts = overlap(true_labels, labels, mask).counts
    elsewhere = np.append(2 * counts[-1, :-1] > counts[:, :-1].sum(axis=0), False)
    kept = counts[:, ~elsewhere]
    kept[:, -1] += counts[:, elsewhere].sum(axis=1)
    pixels, both = kept[:-1].sum(axis=1), kept[:-1, :-1]
    union = pixels[:, None] + kept[:, :-1].sum(axis=0) - both
    halves = (2 * both > pixels[:, None]).sum(axis=0)
    large = pixels > MIN_PIXELS
    return {'SC': segmentation_covering(kept),
            'recall': known_mean((2 * both > union).any(axis=1)[large]),
            'pieces': float((both > PIECE_SHARE * pixels[:, None]).sum(axis=1)[large].mean()),
            'merged': known_mean(halves[halves > 0] > 1),
            'unlabelled': float(kept[:-1, -1].sum() / pixels.sum())}


def hoover_score(true_labels: np.ndarray, labels: np.ndarray, mask: np.ndarray,
                 tolerance: float = 0.8) -> dict[str, int]:
    """
    Return the numbers of true regions by kind, and of predicted ones that are none: noise.

    A pair is correct if its common pixels are at least ``tolerance``, above 0.5, of both regions.
    A true region is over-segmented if two or more predicted ones lie in it, each with that share
    of itself, and together have that share of it; under-segmented is the reverse. A region that
    fits several kinds is counted as the first of these.

    References
    ----------
    A. Hoover et al.: An Experimental Comparison of Range Image Segmentation Algorithms, PAMI 1996.

    """
    counts = overlap(true_labels, labels, mask).counts
    true_pixels, pixels = counts.sum(axis=1)[:-1], counts.sum(axis=0)[:-1]
    both = counts[:-1, :-1][true_pixels > 0][:, pixels > 0]
    of_true = both / true_pixels[true_pixels > 0, None]
    of_predicted = both / pixels[pixels > 0]
    same = (of_true >= tolerance) & (of_predicted >= tolerance)
    true_left, predicted_left = ~same.any(axis=1), ~same.any(axis=0)
    parts = (of_predicted >= tolerance) & true_left[:, None] & predicted_left
    over = (parts.sum(axis=1) > 1) & ((of_true * parts).sum(axis=1) >= tolerance)
    predicted_left &= ~parts[over].any(axis=0)
    true_left &= ~over
    parts = (of_true >= tolerance) & true_left[:, None] & predicted_left
    wide = (parts.sum(axis=0) > 1) & ((of_predicted * parts).sum(axis=0) >= tolerance)
    under = parts[:, wide].any(axis=1)
    return {'true': len(both), 'correct': np.count_nonzero(same),
            'over-segmented': np.count_nonzero(over), 'under-segmented': np.count_nonzero(under),
            'missed': np.count_nonzero(true_left & ~under),
            'noise': np.count_nonzero(predicted_left & ~wide)}


def known_mean(values: np.ndarray) -> float:
    """Return the mean of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float('nan')

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Accuracy of a segmentation, measured as in the evaluation code of PlaneRCNN and ZeroPlane.

Label images are (H, W) int, -1 for no plane, which is an additional class on each side. Only
pixels of the mask count: those with valid true depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MIN_PIXELS = 1500
"""Smaller true planes are not counted as missed."""


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


def rand_index(counts: np.ndarray) -> float:
    """Return the share of pixel pairs that both segmentations treat alike."""
    counts = counts.astype(np.float64)
    pixels = counts.sum()
    apart = ((counts.sum(0) ** 2).sum() + (counts.sum(1) ** 2).sum()) / 2 - (counts**2).sum()
    return float(1.0 - apart / (pixels * (pixels - 1) / 2))


def variation_of_information(counts: np.ndarray) -> float:
    """Return H1 + H2 - 2 MI in bits."""
    joint = counts / counts.sum()
    return float(2 * _entropy(joint.ravel()) - _entropy(joint.sum(0)) - _entropy(joint.sum(1)))


def _entropy(probabilities: np.ndarray) -> float:
    positive = probabilities[probabilities > 0]
    return float(-(positive * np.log2(positive)).sum())


def segmentation_covering(counts: np.ndarray) -> float:
    """Return the mean best IoU of the segments of both sides, weighted by their pixels."""
    rows, columns = counts.sum(1), counts.sum(0)
    iou = counts / np.maximum(rows[:, None] + columns[None, :] - counts, 1)
    return float(((rows * iou.max(1)).sum() + (columns * iou.max(0)).sum()) / (2 * counts.sum()))


@dataclass(frozen=True)
class Score:
    """The metrics of one image; see the functions and :func:`score`."""

    rand_index: float
    variation_of_information: float
    segmentation_covering: float
    recall: float
    precision: float
    true_planes: int
    predicted_planes: int
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
        rand_index(shared.counts), variation_of_information(shared.counts),
        segmentation_covering(shared.counts),
        _share(matches[large].any(1)), _share(matches.any(0)), int(large.sum()), len(planes),
        _median(np.degrees(np.arccos(cosine))), _median(offset_error_m))


def _share(hits: np.ndarray) -> float:
    return float(hits.mean()) if hits.size else float('nan')


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if values.size else float('nan')


RECALL_DEPTHS_M = (0.05, 0.1, 0.2, 0.3, 0.6)
RECALL_ANGLES_DEG = (5.0, 10.0, 30.0)


def depth_recall(true_labels: np.ndarray, true_depth_m: np.ndarray, labels: np.ndarray,
                 depth_m: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return plane recall and pixel recall at each of RECALL_DEPTHS_M.

    A true plane is found at a depth if some predicted plane has IoU > 0.5 with it and the mean
    difference of their depths over the intersection is at most that depth.
    """
    shared = overlap(true_labels, labels, mask)
    planes_found = np.zeros((len(shared.iou), len(RECALL_DEPTHS_M)), bool)
    pixels_found = np.zeros(planes_found.shape)
    for i, j in zip(*np.nonzero(shared.iou > 0.5), strict=True):
        both = mask & (true_labels == i) & (labels == j)
        error_m = np.abs(true_depth_m[both] - depth_m[both]).mean()
        planes_found[i] = error_m <= np.array(RECALL_DEPTHS_M)
        pixels_found[i] = planes_found[i] * shared.counts[i, j]
    true_pixels = max(shared.counts[:-1].sum(), 1)
    return planes_found.mean(0), pixels_found.sum(0) / true_pixels


def normal_recall(true_labels: np.ndarray, true_planes: np.ndarray, labels: np.ndarray,
                  planes: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return plane recall and pixel recall at each of RECALL_ANGLES_DEG.

    A true plane is found at an angle if some predicted plane has IoU > 0.5 with it and the angle
    between their normals is at most that angle.
    """
    shared = overlap(true_labels, labels, mask)
    cosine = np.abs(true_planes[:, :3] @ planes[:, :3].T).clip(0, 1)
    angle_deg = np.where(shared.iou > 0.5, np.degrees(np.arccos(cosine)), np.inf)
    within = angle_deg[..., None] <= np.array(RECALL_ANGLES_DEG)
    pixels_found = (shared.counts[:-1, :-1, None] * within).max(axis=1, initial=0)
    true_pixels = max(shared.counts[:-1].sum(), 1)
    return within.any(axis=1).mean(axis=0), pixels_found.sum(axis=0) / true_pixels


PIECE_SHARE = 0.1
"""A predicted plane that covers this share of a true plane is one of its pieces."""


@dataclass(frozen=True)
class LabelledScore:
    """
    A segmentation against planes labelled by hand; unlabelled pixels do not count.

    True planes up to MIN_PIXELS do not count in recall and pieces.
    """

    segmentation_covering: float
    recall: float  # share of true planes that a predicted one matches with IoU > 0.5
    pieces: float  # mean number of predicted planes with over PIECE_SHARE of a true plane's pixels
    merged: float  # of the predicted planes with over half of a true plane, those with several
    unlabelled: float  # share of the true planes' pixels without a predicted plane


def labelled_score(true_labels: np.ndarray, labels: np.ndarray,
                   mask: np.ndarray) -> LabelledScore:
    """
    Compare a segmentation with planes labelled by hand, where the mask says that they are known.

    A predicted plane with most of its pixels where there is no true plane, on an object for
    example, counts as no plane.
    """
    counts = overlap(true_labels, labels, mask).counts
    elsewhere = np.append(2 * counts[-1, :-1] > counts[:, :-1].sum(axis=0), False)
    kept = counts[:, ~elsewhere]
    kept[:, -1] += counts[:, elsewhere].sum(axis=1)
    pixels, both = kept[:-1].sum(axis=1), kept[:-1, :-1]
    union = pixels[:, None] + kept[:, :-1].sum(axis=0) - both
    halves = (2 * both > pixels[:, None]).sum(axis=0)
    large = pixels > MIN_PIXELS
    return LabelledScore(
        segmentation_covering(kept), _share((2 * both > union).any(axis=1)[large]),
        float((both > PIECE_SHARE * pixels[:, None]).sum(axis=1)[large].mean()),
        _share(halves[halves > 0] > 1), float(kept[:-1, -1].sum() / pixels.sum()))


@dataclass(frozen=True)
class HooverScore:
    """Numbers of true regions by kind, and of predicted ones that are none: noise."""

    true: int
    correct: int
    over_segmented: int
    under_segmented: int
    missed: int
    noise: int


def hoover_score(true_labels: np.ndarray, labels: np.ndarray, mask: np.ndarray,
                 tolerance: float = 0.8) -> HooverScore:
    """
    Classify the regions of a segmentation.

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
    missed = true_left & ~under
    return HooverScore(*(int(np.count_nonzero(found)) for found in (
        np.ones(len(both)), same, over, under, missed, predicted_left & ~wide)))


def known_mean(values: np.ndarray) -> float:
    """Return the mean of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float('nan')

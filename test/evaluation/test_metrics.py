# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The metrics on cases solved by hand."""

import numpy as np
import pytest

from plane_detector.evaluation.metrics import (
    hoover_score,
    labelled_score,
    overlap,
    score,
    segmentation_covering,
)

# Eight pixels: true planes of 4 and 2, two of none; predicted planes of 3, 3 and two of none.
TRUTH = np.array([[0, 0, 0, 0, 1, 1, -1, -1]])
FOUND = np.array([[0, 0, 0, 1, 1, 1, -1, -1]])
ALL = np.ones((1, 8), bool)
PLANES = np.array([[0, 0, -1, 2.0], [0, -1, 0, 1.0]])


def test_segmentation_metrics_by_hand():
    shared = overlap(TRUTH, FOUND, ALL)
    counts = shared.counts
    np.testing.assert_array_equal(counts, [[3, 1, 0], [0, 2, 0], [0, 0, 2]])
    np.testing.assert_allclose(shared.iou, [[3 / 4, 1 / 6], [0, 2 / 3]])
    covering = (4 * 3 / 4 + 2 * 2 / 3 + 2 + 3 * 3 / 4 + 3 * 2 / 3 + 2) / 16
    assert segmentation_covering(counts) == pytest.approx(covering)


def test_equal_segmentations_are_perfect_whatever_their_numbers():
    counts = overlap(TRUTH, np.where(TRUTH < 0, -1, 1 - TRUTH), ALL).counts
    assert segmentation_covering(counts) == 1


@pytest.mark.parametrize(('found', 'recall'), [([0, 0, -1, -1], 0), ([0, 0, 0, -1], 1)])
def test_an_iou_of_one_half_is_no_match(found, recall):
    truth = np.zeros((1, 4), int)
    result = score(truth, PLANES[:1], np.array([found]), PLANES[:1], ALL[:, :4], min_pixels=1)
    assert result.recall == recall


def test_errors_are_those_of_the_matched_planes():
    tilted = np.radians(10)
    found = np.array([[0, np.sin(tilted), -np.cos(tilted), 2.1], [0, -1, 0, 1.3]])
    result = score(TRUTH, PLANES, FOUND, found, ALL, min_pixels=1)
    assert (result.recall, result.precision) == (1, 1)
    assert result.normal_error_deg == pytest.approx(5)
    assert result.offset_error_m == pytest.approx(0.2)


def test_without_planes_recall_and_precision_are_unknown():
    nothing = np.full_like(TRUTH, -1)
    result = score(nothing, PLANES[:0], nothing, PLANES[:0], ALL)
    assert np.isnan([result.recall, result.precision, result.normal_error_deg]).all()
    assert result.segmentation_covering == 1


def test_labelled_planes_in_pieces_merged_and_not_found():
    # Three planes of 40 x 100 pixels and an object; unlabelled columns are not in the mask.
    truth = np.repeat([[0, 1, 2, -1]], 100, axis=0).repeat(40, axis=1)
    found = truth.copy()
    found[:30, :40] = 4             # plane 0 in two pieces
    found[:90, 40:120] = 1          # planes 1 and 2 merged, a tenth without a label
    found[90:, 40:120] = -1
    found[50:, 120:] = 5            # a plane on the object counts as none
    everything = np.ones(truth.shape, bool)
    covering = segmentation_covering(
        overlap(truth, np.where(truth < 0, -1, found), everything).counts)
    assert labelled_score(truth, found, everything) == pytest.approx({
        'SC': covering, 'recall': 1 / 3,  # plane 0 by its piece of 70 %
        'pieces': 4 / 3, 'merged': 1 / 2, 'unlabelled': 800 / 12000})


def test_regions_by_kind_after_hoover():
    # Five true regions of 10 pixels: one in two parts, one of which only half is found.
    truth = np.repeat([[0, 1, 2, 3, 4, -1]], 10, axis=1)
    found = np.repeat([[0, 0, 1, 2, 3, 3, 4, 4, -1, 5, -1, 6]], 5, axis=1)
    found[0, 9] = -1                # 90 % of region 0 are enough
    everything = np.ones(truth.shape, bool)
    assert hoover_score(truth, found, everything) == {
        'true': 5, 'correct': 3, 'over-segmented': 1, 'under-segmented': 0, 'missed': 1,
        'noise': 2}
    found[0, 20:40] = 3             # one plane on both regions 2 and 3
    assert hoover_score(truth, found, everything) == {
        'true': 5, 'correct': 1, 'over-segmented': 1, 'under-segmented': 2, 'missed': 1,
        'noise': 2}
    found[0, 2:10] = -1             # 20 % of region 0 are not
    assert hoover_score(truth, found, everything)['correct'] == 0

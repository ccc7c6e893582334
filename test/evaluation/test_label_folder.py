# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Label images and tables of planes as files."""

import cv2
import numpy as np
import pytest

from plane_detector.evaluation.label_folder import (
    label_files,
    planes_of_frame,
    read_annotation,
    read_labels,
    read_plane_table,
    write_labels,
)

LABELS = np.array([[-1, 0, 0, 1], [-1, 0, 1, 1]])
PLANES = np.array([[0, 0, -1, 1 / 3], [0.6, 0.0, -0.8, np.pi]])


def test_written_labels_can_be_read(tmp_path):
    write_labels(tmp_path / 'out', 7, LABELS, PLANES)
    (number, path), = label_files(tmp_path / 'out').items()
    assert (number, path.name) == (7, '00007.png')
    assert cv2.imread(str(path), cv2.IMREAD_UNCHANGED).dtype == np.uint16
    values = read_labels(path, (2, 4))
    np.testing.assert_array_equal(values, LABELS + 1)
    table = read_plane_table(tmp_path / 'out')
    np.testing.assert_array_equal(planes_of_frame(table, 7, np.array([1, 2])), PLANES)


def test_labels_of_another_resolution_are_resized_and_of_another_shape_refused(tmp_path):
    path = tmp_path / '1.png'
    cv2.imwrite(str(path), np.array([[0, 300], [5, 65535]], np.uint16))
    np.testing.assert_array_equal(read_labels(path, (4, 4)), np.kron(
        [[0, 300], [5, 65535]], np.ones((2, 2))))
    with pytest.raises(ValueError, match='shape of 8 x 4'):
        read_labels(path, (4, 8))
    cv2.imwrite(str(path), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(ValueError, match='one channel'):
        read_labels(path, (2, 2))


def test_the_published_annotation_is_read_and_stretched(tmp_path):
    labels = np.array([[0, 1], [2, 1]], np.uint8)
    np.savez(tmp_path / 'plane_instance_12.npz', plane_instance=labels,
             plane_param=np.ones((2, 3)))
    cv2.imwrite(str(tmp_path / 'plane_instance_12.png'), np.zeros((2, 2, 3), np.uint8))
    (number, path), = label_files(tmp_path).items()
    assert number == 12
    np.testing.assert_array_equal(read_annotation(path, (2, 6)), np.repeat(labels, 3, axis=1))
    np.savez(path, other=labels)
    with pytest.raises(ValueError, match='NYUv2-Plane'):
        read_annotation(path, (2, 6))


def test_planes_are_normalised_and_look_at_the_camera(tmp_path):
    (tmp_path / 'all.csv').write_text(
        'label,frame,normal_x,normal_y,normal_z,d,note\n2,1,0,0,2,-3,far\n')
    np.testing.assert_array_equal(read_plane_table(tmp_path)[1, 2], [0, 0, -1, 1.5])

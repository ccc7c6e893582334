# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every method is timed on one thread."""

import cv2

from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark import runtime
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.process import one_thread
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=0, distance_m=2.0)


def test_times_are_taken_of_every_method_and_case():
    case = (WALL.depth_m, SMALL)
    ms = runtime.median_ms([peers.Ours()], [case, case], repeats=2)
    assert ms.shape == (1, 2)
    assert (ms > 0).all()


def test_the_number_of_threads_is_restored():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before

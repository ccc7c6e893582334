# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What is missing for classes and obstacles is logged once, and so is that it no longer is."""

from dataclasses import replace

import output_scene as scene

from plane_detector.ros.diagnostics import Health
from plane_detector.types import GroundPixels, PlaneClass, Planes


class Logger(list):
    """Keeps what is logged, by level."""

    def info(self, text):
        self.append(('info', text))

    def warning(self, text):
        self.append(('warning', text))


def without_gravity():
    return scene.detection(planes=Planes.of([
        replace(scene.plane(index), plane_class=PlaneClass.UNKNOWN)
        for index in (scene.WALL, scene.FLOOR)]), ground_pixels=GroundPixels())


def test_a_gap_is_logged_once_and_withdrawn_once():
    logger = Logger()
    health = Health(logger)
    for found in 2 * [without_gravity(), without_gravity(), scene.detection()]:
        health.note(found, ['planes'])
    (level, text), withdrawn = logger
    assert level == 'warning' and text.startswith('planes have no class: ')
    assert withdrawn == ('info', 'no longer: planes have no class')

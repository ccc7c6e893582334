# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of a small package written by the test."""

import pytest

from plane_detector.evaluation.structure import constants, counts, floors, imports, rooms

LONG = 'def long(a, b, c, d, e, f, g):\n' + 40 * '    a += 1\n'
FILES = {
    '__init__.py': '', 'config.py': '', 'depth/__init__.py': '', 'evaluation/report.py': LONG,
    'depth/model.py': 'from plane_detector import config\n',
    'segmentation/cells.py': (
        'from plane_detector.depth.model import predict\n'
        '# derived: twice the noise,\n# which is 1.\nREACH, DEPTH = 2, -1e-3\n'
        'SHARE = 1 / 3  # tuned: by hand\n\nWINDOWS = np.array([[3, 3]])\n'
        'HALF = 0.5 * SHARE\nNAME, small = "cells", 3\nTABLE = {1: 2}\n')}


@pytest.fixture
def package(tmp_path):
    for name, text in FILES.items():
        path = tmp_path / 'plane_detector' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / 'plane_detector'


def test_constants_are_numbers_with_the_origin_of_the_comment_above(package):
    assert list(constants(package / 'segmentation' / 'cells.py')) == [
        ('REACH', 'derived'), ('DEPTH', 'derived'), ('SHARE', 'tuned'), ('WINDOWS', '')]


def test_rooms_and_floors(package):
    imported = imports(package)
    assert imported['plane_detector.segmentation.cells'] == {'plane_detector.depth.model'}
    assert rooms(imported) == {'config': set(), 'depth': {'config'}, 'evaluation': set(),
                               'segmentation': {'depth'}}
    assert floors(rooms(imported))['segmentation'] == 3


def test_a_cycle_of_imports_is_counted_once():
    assert set(floors({'a': {'b'}, 'b': {'a'}})) == {'a', 'b'}


def test_counts(package):
    assert counts(package) == {
        'modules': 6, 'modules that are installed': 5, 'modules in the top folder': 2,
        'lines that are installed': 11, 'rooms': 4, 'import floors of the rooms': 3,
        'import floors of the modules': 3, 'lines of the segmentation': 10,
        'constants of the segmentation': 4, '... that are derived': 2, '... that are after': 0,
        '... that are tuned': 1, '... without an origin': 1, 'functions over 40 lines': 1,
        'functions over 6 arguments': 1}
    assert counts(package, ['config'])['lines of the segmentation'] == 10, 'the folder counts'

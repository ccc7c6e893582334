# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program on NYU Depth V2 and on label folders, on a file made of rendered rooms."""


import cv2
import numpy as np
import pytest
from nyu_files import nyu_room, write_nyu

from plane_detector.depth.depth_function import DepthFunction
from plane_detector.evaluation.benchmark import nyu_frames
from plane_detector.evaluation.benchmark.__main__ import main
from plane_detector.evaluation.benchmark.nyu_frames import Task, evaluate
from plane_detector.evaluation.nyu_depth import COLUMNS, ROWS
from plane_detector.evaluation.peers import OpenCv

pytest.importorskip('h5py', reason='the extra plane_detector[benchmark] is missing')
SEEDS = (9000, 9001, 9002)
OURS = 'plane_detector, sensor'
ABSENT = OpenCv(0.03).absent
needs_find_planes = pytest.mark.skipif(bool(ABSENT), reason=ABSENT)


@pytest.fixture(scope='module')
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp('nyu') / 'nyu_depth_v2_labeled.mat'
    write_nyu(path, SEEDS)
    return path


@pytest.fixture
def run(capsys):
    def run(*arguments):
        main([str(argument) for argument in arguments])
        return capsys.readouterr().out
    return run


def rows(printed, name):
    return [[cell.strip() for cell in line.strip('| ').split(' | ')[1:]]
            for line in printed.splitlines() if line.startswith(f'| {name} |')]


@needs_find_planes
def test_all_tables_are_printed_for_every_method(file, run, tmp_path):
    text = run('nyu', file, '--model', 'none', '--methods', 'ours,opencv', '--processes', 1,
               '--output', tmp_path / 'out')
    assert '### NYU Depth V2, 3 frames, raw depth, truth: annotations' in text
    (frames, covering, *_), recalls, worst, times = rows(text, OURS)
    assert frames == '3'
    assert float(covering) > 0.95
    assert len(recalls) == 8
    assert float(recalls[0].split(' / ')[1]) > 90
    assert len(worst[0].split(', ')) == 3
    assert float(times[0]) > 0
    assert len(rows(text, 'OpenCV findPlanes, 3 cm, sensor')) == 4


@needs_find_planes
def test_a_label_folder_is_scored_like_the_method_that_wrote_it(file, run, tmp_path):
    written = run('nyu', file, '--model', 'none', '--methods', 'ours,opencv', '--processes', 1,
                  '--output', tmp_path, '--write-labels')
    text = run('labels', f'a={tmp_path}/labels/plane_detector_sensor',
               f'b={tmp_path}/labels/OpenCV_findPlanes_3_cm_sensor', '--nyu', file,
               '--processes', 1)
    assert rows(text, 'a') == rows(written, OURS)[:3]
    assert rows(text, 'b') == rows(written, 'OpenCV findPlanes, 3 cm, sensor')[:3]
    folder = tmp_path / 'labels' / 'plane_detector_sensor'
    inside, outside = (evaluate(task, 2).rows[name] for task, name in (
        (Task(file, methods=('ours',)), OURS), (Task(file, methods=(), outside=(('a', folder),)),
                                                'a')))
    # Normals that are read are normalised again, which rounds.
    assert inside == pytest.approx(outside, rel=1e-6, nan_ok=True)


def test_the_published_annotation_may_be_the_truth(file, tmp_path):
    labels = nyu_room(SEEDS[1]).labels[ROWS, COLUMNS].astype(np.int16) + 1
    np.savez(tmp_path / 'plane_instance_2.npz', plane_param=np.zeros((labels.max(), 3)),
             plane_instance=cv2.resize(labels, (256, 192), interpolation=cv2.INTER_NEAREST))
    task = Task(file, depth='filled', truth=str(tmp_path), methods=('ours',))
    assert evaluate(task, 2).rows[OURS]['SC'] > 0.95


@needs_find_planes
def test_the_network_has_rows_of_its_own(file, run, tmp_path, monkeypatch):
    depth_m = nyu_room(SEEDS[0]).depth_m[ROWS, COLUMNS]
    network = DepthFunction(lambda rgb: (3 / depth_m + 0.5).astype(np.float32),
                            'relative_disparity', noise_share=0.001)
    monkeypatch.setattr(nyu_frames, 'DepthEstimator', lambda config: network)
    nyu_frames._detector.cache_clear()
    (tmp_path / 'frames.txt').write_text('1')
    (tmp_path / 'net').mkdir()
    cv2.imwrite(str(tmp_path / 'net' / '1.png'), np.ones((480, 640), np.uint16))
    text = run('nyu', file, '--split', tmp_path / 'frames.txt', '--model', 'made_up',
               '--methods', 'ours,opencv', '--outside', f'net={tmp_path / "net"}',
               '--processes', 1, '--output', tmp_path)
    nyu_frames._detector.cache_clear()
    assert float(rows(text, 'plane_detector, network')[0][1]) > 0.9
    assert float(rows(text, 'OpenCV findPlanes, 3 cm, network')[0][1]) > 0.5
    assert float(rows(text, 'net')[0][1]) < 0.5

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program on NYU Depth V2, on a file made of rendered rooms."""

import numpy as np
import pytest
from nyu_files import nyu_room, write_nyu

from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.benchmark import nyu
from plane_detector.evaluation.benchmark.__main__ import main
from plane_detector.evaluation.nyu_depth import COLUMNS, ROWS
from plane_detector.evaluation.peers import OpenCv

pytest.importorskip('h5py', reason='the extra plane_detector[benchmark] is missing')
SEEDS = (9000, 9001, 9002)


def rows(printed, name):
    return [[cell.strip() for cell in line.strip('| ').split(' | ')[1:]]
            for line in printed.splitlines() if line.startswith(f'| {name} |')]


@pytest.mark.skipif(bool(OpenCv(0.03).absent), reason=OpenCv(0.03).absent)
def test_every_method_is_scored_on_the_depth_of_sensor_and_network(tmp_path, monkeypatch, capsys):
    write_nyu(tmp_path / 'nyu.mat', SEEDS)
    depth_m = nyu_room(SEEDS[0]).depth_m[ROWS, COLUMNS]
    network = DepthFunction(lambda rgb: (3 / depth_m + 0.5).astype(np.float32),
                            'relative_disparity', noise_share=0.001)
    monkeypatch.setattr(nyu, 'DepthEstimator', lambda config: network)
    nyu._detector.cache_clear()
    (tmp_path / 'frames.txt').write_text('1')
    for options in (['--model', 'none'],
                    ['--model', 'made_up', '--split', str(tmp_path / 'frames.txt')]):
        main(['nyu', str(tmp_path / 'nyu.mat'), '--methods', 'ours', 'opencv', '--processes', '1',
              *options])
    nyu._detector.cache_clear()
    of_sensor, of_both = capsys.readouterr().out.split('### NYU Depth V2, ')[1:]
    assert of_sensor.startswith('3 frames, raw depth')
    (frames, worst, covering, *_, cpu_ms), recalls = rows(of_sensor, 'plane_detector, sensor')
    assert frames == '3'
    assert float(worst.split()[0]) <= float(covering)
    assert float(covering) > 0.95
    assert float(cpu_ms) > 0
    assert len(recalls) == 8
    assert float(recalls[0].split(' / ')[1]) > 90
    assert len(rows(of_sensor, 'OpenCV findPlanes, 3 cm, sensor')) == 2
    assert float(rows(of_both, 'plane_detector, network')[0][2]) > 0.9
    assert float(rows(of_both, 'OpenCV findPlanes, 3 cm, network')[0][2]) > 0.5

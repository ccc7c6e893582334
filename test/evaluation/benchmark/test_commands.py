# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One program with subcommands: each has a help, runs on a scene or two, and explains errors."""

import re
import subprocess
import sys

import cv2
import numpy as np
import pytest
from data_files import write_frame
from onnx_models import write_depth_network

from plane_detector.evaluation.benchmark import __main__ as program
from plane_detector.evaluation.benchmark.__main__ import main
from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.types import CameraIntrinsics

MODULE = 'plane_detector.evaluation.benchmark'
ONE_OF_EACH = '--rooms 1 --living 1 --curved 1 --processes 1'
# What would take long replaced, and a row that must be printed.
RUNS = {
    f'accuracy --only-ours --plots figures {ONE_OF_EACH}':
        ({'samples.SIGMAS': (0.001,), 'samples.CURVED_SIGMAS': (0.0,), 'samples.SENSORS': {}},
         r'rooms \| 0.001 \| plane_detector \| 1 \| 0.9\d+ \| 0.\d+ \(9000\) \| 0.\d+ \| 1.0000'),
    f'ablation --only small {ONE_OF_EACH}':
        ({'samples.SIGMAS': (0.0,), 'samples.CURVED_SIGMAS': (0.0,), 'samples.SENSORS': {}},
         r'without small planes \| -0.\d+ \(0.000\) / -0.\d+ / \+?0?'),
    'labelled --frames --only-ours':
        ({'labelled.SENSOR_CASES': {}, 'labelled.SEEDS': 1, 'labelled.DRAWS': 1},
         r'sensors/7 \| plane_detector \| 1.000 \| 1.000 \| 1.000[\s\S]*'
         r'\| 7 \| 1.00 \| 1.00 \| 1.00 \|'),
    'ground --only quay --views 1':
        ({'ground.NOISES': (0.0,), 'ground.BOX_HEIGHTS_M': (0.03, 0.2),
          'ground.KERB_DISTANCES_M': (2.0,)},
         r'all \| 1.000, 1.000, 0 of 1 \| - .* \| 1 of 1 \| 1.000 \| 0 of 1 \|[\s\S]*'
         r'0.0 \| 20 cm \| 20 cm \| 20 cm \| 2 m'),
    'shapes --scenes 1 --first-seed 0': ({'shapes.SIGMAS': (0.0,)}, r'0 \| 1 \| \d \| 1.00'),
    'network net.onnx --output metric_depth --short-side 56 --images 1':
        ({}, r'net.onnx \| 70 x 56 \| \d+.\d \| \d+ \| \d+.\d \| \d+.\d \| \d+.\d'),
    'orientation --only rendered --scenes 1 --first-seed 300 --data nowhere':
        ({'orientation.SCENES': {'rooms': random_room}},
         r'rooms \| 1 of 1 answer.*\n\| strokes of all directions \| 0 of 1 answer')}


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    """Return a data folder with a wall, once without labels and twice labelled by hand."""
    folder = tmp_path_factory.mktemp('data')
    wall = single_wall(CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120), 20.0, 2.0)
    for parent in ('labelled', 'sensors'):
        (folder / parent).mkdir()
    for path in (folder / 'office', folder / 'labelled' / 'office', folder / 'sensors' / 'd435'):
        write_frame(path, np.rint(1000 * wall.depth_m).astype(np.uint16))
        if path.parent != folder:
            cv2.imwrite(str(path / '7_labels.png'), np.full((120, 160), 3, np.uint8))
    return folder


@pytest.mark.parametrize('command', RUNS)
def test_a_command_prints_its_tables(command, data, monkeypatch, capsys, tmp_path):
    name, *options = command.split()
    replaced, row = RUNS[command]
    monkeypatch.chdir(tmp_path)
    if '--plots' in options:
        pytest.importorskip('matplotlib', reason='plane_detector[benchmark] is missing')
    if name == 'network':
        pytest.importorskip('onnx', reason='onnx, of the extra "test", is not installed')
        write_depth_network(tmp_path / options[0], weights=(0.1, 0.1, 0.1, 3.0))
    for place, value in replaced.items():
        monkeypatch.setattr(f'{MODULE}.{place}', value)
    takes_data = ('--data' in program.subcommand(name)[1].format_usage()
                  and '--data' not in options)
    main([name, *options, *(['--data', str(data)] if takes_data else [])])
    printed = capsys.readouterr().out
    assert re.search(rf'^\| {row}', printed, re.MULTILINE), printed
    assert '--plots' not in options or '<svg' in (tmp_path / 'figures/accuracy.svg').read_text()


def test_wrong_input_ends_a_process_with_a_line():
    run = subprocess.run([sys.executable, '-m', MODULE, 'labelled', '--data', 'no_such_folder'],
                         capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert 'Traceback' not in run.stderr and 'no_such_folder' in run.stderr
    start = f'`python3 -m {MODULE} labelled --data no_such_folder`\n\n'
    assert run.stdout.startswith(start), 'the provenance of a result is stated'
    for part in ('cores, Python 3.', f'numpy {np.__version__}', '; commit '):
        assert part in run.stdout

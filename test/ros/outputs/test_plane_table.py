# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes and their outlines as clouds, the table that is printed, the snippet that reads them."""

import io
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import rclpy
from ros_helpers import cloud_array, header, random_domain
from sensor_msgs.msg import PointCloud2

from plane_detector.planes.outline import Polygon, Rectangle
from plane_detector.ros.cloud_reading import read_cloud
from plane_detector.ros.outputs.clouds import PixelPoints, points_to_msg
from plane_detector.ros.outputs.plane_table import boundaries_to_msg, planes_to_msg
from plane_detector.tools.show import PlanePrinter, main, table_of
from plane_detector.types import CameraIntrinsics, Plane

TOPICS = Path(__file__).resolve().parents[3] / 'docs' / 'topics.md'
TURNED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
RECTANGLE = Rectangle(np.array([0.5, 0.25, 3.0]), TURNED, 4.0, 2.5)


def make_plane(normal, offset_m):
    normal = np.asarray(normal, float)
    return Plane(normal, offset_m, -offset_m * normal, 1234, 0.003, 2.5, np.eye(4), 0.75)


def two_planes():
    planes = make_plane([0.0, 0.6, -0.8], 2.0), make_plane([0.0, -1.0, 0.0], 1.25)
    return planes_to_msg(header(2.0), planes, np.array([7, 9], np.uint32), (1, 3),
                         (RECTANGLE, RECTANGLE), (0, 4)), planes


def test_planes_cloud():
    msg, planes = two_planes()
    assert [f.name for f in msg.fields][:13] == [
        'x', 'y', 'z', 'normal_x', 'normal_y', 'normal_z', 'd', 'label', 'num_inliers', 'rms',
        'area', 'class', 'confidence']
    assert (msg.height, msg.width, msg.header) == (1, 2, header(2.0))
    (table,) = cloud_array(msg)
    for row, plane in zip(table, planes, strict=True):
        normal = np.array([row['normal_x'], row['normal_y'], row['normal_z']])
        np.testing.assert_allclose(normal, plane.normal, atol=1e-7)
        centroid = np.array([row['x'], row['y'], row['z']])
        assert abs(normal @ centroid + row['d']) < 1e-6
    np.testing.assert_array_equal(table['label'], [7, 9])
    np.testing.assert_allclose(table['rms'], 0.003)
    np.testing.assert_allclose(table['area'], 2.5)
    np.testing.assert_allclose(table['confidence'], 0.75)
    np.testing.assert_array_equal(table['num_inliers'], 1234)
    np.testing.assert_array_equal(table['class'], [1, 3])
    np.testing.assert_array_equal(table['merged'], [0, 4])


def test_the_rectangle_is_in_the_table():
    row = cloud_array(two_planes()[0])[0][0]
    assert [float(row[f'rect_{name}']) for name in ('x', 'y', 'z', 'width', 'height')] == [
        0.5, 0.25, 3.0, 4.0, 2.5]
    quaternion = np.array([row[f'rect_q{axis}'] for axis in 'xyzw'])
    np.testing.assert_allclose(np.abs(quaternion), [np.sqrt(0.5), np.sqrt(0.5), 0, 0], atol=1e-7)


def test_without_classes_they_are_unknown():
    plane = make_plane([0, 0, -1], 1.0)
    msg = planes_to_msg(header(), (plane,), np.array([1]), (), (RECTANGLE,), ())
    assert cloud_array(msg)[0]['class'].tolist() == [0]


def test_no_plane_is_an_empty_cloud_with_fields():
    msg = planes_to_msg(header(), (), np.zeros(0, np.uint32), (), (), ())
    assert (msg.height, msg.width, len(msg.data)) == (1, 0, 0)
    assert len(msg.fields) == 23
    assert read_cloud(msg).shape == (1, 0)


def test_boundaries_are_closed_and_marked():
    square = np.array([[0.0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 1, 2]])
    hole = 0.5 * square + [0.25, 0.25, 1.0]
    msg = boundaries_to_msg(header(3.0), (4, 8), (
        (Polygon(square, False), Polygon(hole, True)), (Polygon(square[:3], False),)))
    (table,) = cloud_array(msg)
    assert msg.header == header(3.0)
    np.testing.assert_array_equal(table['polygon'], [0] * 5 + [1] * 5 + [2] * 4)
    np.testing.assert_array_equal(table['label'], [4] * 10 + [8] * 4)
    np.testing.assert_array_equal(table['hole'], [0] * 5 + [1] * 5 + [0] * 4)
    for number in range(3):
        corners = table[table['polygon'] == number]
        assert [corners[0][axis] for axis in 'xyz'] == [corners[-1][axis] for axis in 'xyz']


def test_no_boundaries_are_an_empty_cloud():
    msg = boundaries_to_msg(header(), (), ())
    assert (msg.height, msg.width) == (1, 0)
    assert [field.name for field in msg.fields] == ['x', 'y', 'z', 'label', 'hole', 'polygon']


def test_the_printed_table():
    lines = table_of(two_planes()[0]).splitlines()
    assert lines[0] == '2 planes at 2.000000000 in camera_optical_frame, metres'
    assert re.split(r'\s{2,}', lines[2].strip())[:2] == ['7', 'floor']
    assert '2.00    4.00    2.50     2.50   0.003   75%' in lines[2]
    assert 'unknown unit' in table_of(two_planes()[0], is_metric=False)
    assert len(lines) == 4


def test_the_table_is_printed_live(robot):
    printed = io.StringIO()
    robot.add(PlanePrinter('/plane_detector', printed, context=robot.context))
    robot.publish('/plane_detector/planes', two_planes()[0])
    assert robot.spin(lambda: '2 planes at' in printed.getvalue())


def test_silence_is_explained_with_the_existing_nodes(robot):
    printer = PlanePrinter('front', io.StringIO(), context=robot.context)
    robot.add(printer)
    assert printer.why_nothing() == 'nobody publishes /front/planes; is it running?'
    robot.node.create_publisher(PointCloud2, '/rear/planes', 1)
    assert robot.spin(lambda: printer.why_nothing().endswith('; there is: --node /rear'))
    robot.node.create_publisher(PointCloud2, '/front/planes', 1)
    assert robot.spin(lambda: printer.why_nothing().startswith('no planes on /front/planes yet'))


def test_silence_is_logged_until_there_are_planes(robot):
    printed = io.StringIO()
    printer = PlanePrinter('front', printed, context=robot.context)
    told = []
    printer.get_logger().warning = told.append
    robot.add(printer)
    assert robot.spin(lambda: told)
    robot.publish('/front/planes', two_planes()[0])
    assert robot.spin(printed.getvalue)
    assert len(told) == len(set(told))
    assert printer._silence.is_canceled()


def test_arguments_that_show_does_not_know_are_refused(capsys):
    with pytest.raises(SystemExit) as ended:
        main(['--nodes', 'front', '--bogus'])
    assert ended.value.code == 2
    printed = capsys.readouterr().err
    assert printed.startswith('usage: ros2 run plane_detector show')
    assert '--bogus' in printed


@pytest.fixture
def snippet(monkeypatch):
    """Run the snippet with a stand-in for sensor_msgs_py, which is not a package of PyPI."""
    module = ModuleType('sensor_msgs_py.point_cloud2')
    module.read_points = lambda msg: cloud_array(msg).ravel()  # as it does for all fields
    monkeypatch.setitem(sys.modules, 'sensor_msgs_py', ModuleType('sensor_msgs_py'))
    monkeypatch.setitem(sys.modules, 'sensor_msgs_py.point_cloud2', module)
    source, = re.findall(r'```python\n(.*?)```', TOPICS.read_text(encoding='utf-8'), re.DOTALL)
    names = {'__name__': 'snippet'}
    exec(compile(source, 'topics.md', 'exec'), names)
    rclpy.init(domain_id=random_domain())
    yield names
    rclpy.try_shutdown()


def test_the_snippet_joins_planes_to_points(snippet, capsys):
    points = PixelPoints(np.ones((2, 3), np.float32),
                         np.array([[0, 0, 0], [-1, 1, 1]], np.int32),
                         CameraIntrinsics(1.0, 1.0, 0.0, 0.0, 3, 2))
    points_msg = points_to_msg(header(2.0), points, np.zeros((2, 3, 3), np.uint8),
                               np.array([7, 9, 0], np.uint32))
    reader = snippet['PlaneReader']()
    reader.on_planes(two_planes()[0])
    reader.on_points(points_msg)
    reader.on_planes(two_planes()[0])
    assert capsys.readouterr().out.splitlines() == [
        '7 floor 2.00 m away, 4.00 x 2.50 m, 3 points',
        '9 wall 1.25 m away, 4.00 x 2.50 m, 2 points']
    reader.destroy_node()


def test_the_class_values_of_the_docs_are_those_of_the_code(snippet):
    from plane_detector.planes.classification import PlaneClass
    assert snippet['CLASSES'] == tuple(kind.name.lower().replace('_', ' ') for kind in PlaneClass)
    told = ', '.join(f'{kind.value} {kind.name.lower().replace("_", " ")}' for kind in PlaneClass)
    assert told in TOPICS.read_text(encoding='utf-8')

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The installed examples read what the node publishes.

The one in C++ is compiled with the headers of sensor_msgs and a stand-in for rclcpp, which is not
among the wheels: spinning it calls the subscription with the message of the test.
"""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import output_scene as scene
import pytest
import rclpy
import sensor_msgs
from map_helpers import map_plane
from ros_helpers import cloud_array, header, next_domain

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.map_plane import as_planes
from plane_detector.mapping.plane_map import MapSnapshot
from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.outputs.frame import MapView
from plane_detector.ros.outputs.map_messages import map_planes_to_msg
from plane_detector.ros.outputs.topics import OUTPUTS

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / 'docs' / 'examples'
NAMES = [kind.readable for kind in PlaneClass]


def two_planes():
    return OUTPUTS['planes'].make(scene.frame())


@pytest.fixture
def listener(monkeypatch):
    """Return the names of the program, with a stand-in for sensor_msgs_py, not in pip."""
    module = ModuleType('sensor_msgs_py.point_cloud2')
    module.read_points = lambda msg: cloud_array(msg).ravel()  # as it does for all fields
    monkeypatch.setitem(sys.modules, 'sensor_msgs_py', ModuleType('sensor_msgs_py'))
    monkeypatch.setitem(sys.modules, 'sensor_msgs_py.point_cloud2', module)
    source = (EXAMPLES / 'plane_listener.py').read_text('utf-8')
    names = {'__name__': 'example'}
    exec(compile(source, 'plane_listener.py', 'exec'), names)
    rclpy.init(domain_id=next_domain())
    yield names
    rclpy.try_shutdown()


def test_python_joins_planes_to_points(listener, capsys):
    node, planes = listener['PlaneListener'](), two_planes()
    node.on_planes(planes)
    node.on_points(OUTPUTS['points'].make(scene.frame()))
    node.on_planes(planes)
    assert capsys.readouterr().out.splitlines() == [
        f'{row["label"]} {name} {row["d"]:.2f} m away, {row["rect_width"]:.2f} x '
        f'{row["rect_height"]:.2f} m, {row["num_inliers"]} points'
        for row, name in zip(cloud_array(planes)[0], ('wall', 'floor'), strict=True)]
    node.destroy_node()


def test_ctrl_c_ends_the_examples_quietly(listener, monkeypatch, capsys):
    def interrupted(node):
        raise KeyboardInterrupt

    monkeypatch.setattr(rclpy, 'init', lambda: None)
    monkeypatch.setattr(rclpy, 'spin', interrupted)
    listener['main']()
    for name, words in (('moveit_msgs', ModuleType('moveit_msgs')),
                        ('moveit_msgs.msg', SimpleNamespace(PlanningScene=MoveitMessage,
                                                            CollisionObject=MoveitMessage))):
        monkeypatch.setitem(sys.modules, name, words)
    monkeypatch.setattr(rclpy, 'create_node', lambda name: SimpleNamespace(
        create_publisher=lambda *args: None, create_subscription=lambda *args: None))
    runpy.run_path(str(EXAMPLES / 'tables_to_moveit.py'))['main']()
    assert capsys.readouterr() == ('', '')


def test_both_know_all_classes(listener):
    assert list(listener['CLASSES']) == NAMES
    source = (EXAMPLES / 'plane_listener.cpp').read_text('utf-8')
    table = re.search(r'kClasses\{(.*?)\}', source, re.DOTALL)[1]
    assert re.findall(r'"([^"]*)"', table) == NAMES


def map_msg():
    """Return a map: a table turned by 30 degrees, a small box, an underside, a floor."""
    def surface(label, kind, side, middle, rows, columns):
        x, y = np.cos(np.radians(30)), np.sin(np.radians(30))
        axes = np.array([[x, y, 0], [-side * y, side * x, 0], [0, 0, side]])
        return map_plane(label, kind, middle, axes, np.full((rows, columns), 10),
                         (-columns // 2, -rows // 2))

    level = PlaneClass.OTHER_HORIZONTAL
    surfaces = (surface(3, level, 1, (1, 2, 0.75), 14, 24),
                surface(4, level, 1, (1, 1, 0.85), 2, 24),
                surface(5, level, -1, (1, 2, 0.7), 14, 24),
                surface(6, PlaneClass.STEP, 1, (3, 2, 0.4), 14, 24),
                surface(7, PlaneClass.FLOOR, 1, (3, 4, 0.9), 14, 24),
                surface(1, PlaneClass.FLOOR, 1, (0, 0, 0), 60, 60))
    return map_planes_to_msg(MapView(header(1.0), MapSnapshot(
        surfaces, as_planes(surfaces), RigidTransform.identity()), {9: 3}))


def test_without_moveit_the_example_says_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, 'moveit_msgs', None)
    with pytest.raises(SystemExit, match='apt install ros-jazzy-moveit-msgs'):
        runpy.run_path(str(EXAMPLES / 'tables_to_moveit.py'))['main']()


class MoveitMessage(SimpleNamespace):
    """A stand-in for messages of moveit_msgs, which is not in pip."""

    ADD, REMOVE = b'\x00', b'\x01'

    def __getattr__(self, name):
        setattr(self, name, [] if name == 'collision_objects' else MoveitMessage())
        return vars(self)[name]


def test_tables_are_given_to_moveit_and_taken_away(listener, monkeypatch):
    module, changes, received = ModuleType('moveit_msgs.msg'), [], []
    module.PlanningScene = module.CollisionObject = MoveitMessage
    monkeypatch.setitem(sys.modules, 'moveit_msgs', ModuleType('moveit_msgs'))
    monkeypatch.setitem(sys.modules, 'moveit_msgs.msg', module)
    monkeypatch.setattr(rclpy, 'init', lambda: None)
    monkeypatch.setattr(rclpy, 'create_node', lambda name: SimpleNamespace(
        create_publisher=lambda *args: SimpleNamespace(publish=changes.append),
        create_subscription=lambda kind, topic, callback, qos: received.append(callback)))
    nothing = OUTPUTS['planes'].make(scene.frame(empty()))
    monkeypatch.setattr(rclpy, 'spin', lambda node: [
        received[0](msg) for msg in (map_msg(), nothing)])
    runpy.run_path(str(EXAMPLES / 'tables_to_moveit.py'))['main']()
    tables, taken = (change.world.collision_objects for change in changes)
    # A table, a low one, one that fills the view of an arm; no floor, underside or narrow board.
    assert {one.id: round(one.pose.position.z, 3) for one in tables} == {
        'table_3': 0.74, 'table_6': 0.39, 'table_7': 0.89}
    assert {one.id for one in taken} == {one.id for one in tables}
    table, gone = tables[0], taken[0]
    assert (table.id, table.operation) == ('table_3', MoveitMessage.ADD)
    assert table.header.frame_id == map_msg().header.frame_id
    assert list(table.primitives[0].dimensions) == pytest.approx([1.2, 0.7, 0.02], abs=1e-3)
    place, turn = table.pose.position, table.pose.orientation
    assert (place.x, place.y, place.z) == pytest.approx((1, 2, 0.74), abs=1e-6)
    along = RigidTransform.from_quaternion((turn.x, turn.y, turn.z, turn.w), (0.0, 0.0, 0.0))
    assert abs(along.rotation[:2, 0] @ [3**0.5 / 2, 0.5]) == pytest.approx(1, abs=1e-4)
    assert (gone.id, gone.operation) == ('table_3', MoveitMessage.REMOVE)
    assert all(change.is_diff and change.robot_state.is_diff for change in changes)


def test_examples_are_installed():
    setup = (ROOT / 'setup.py').read_text('utf-8')
    assert "(f'share/{NAME}/examples', sorted(glob('docs/examples/*')))" in setup
    assert {path.suffix for path in EXAMPLES.iterdir()} == {'.py', '.cpp'}


STAND_IN = """
#pragma once
#include <functional>
#include <memory>
#include <string>
#include <sensor_msgs/msg/point_cloud2.hpp>
sensor_msgs::msg::PointCloud2 message_of_test();
namespace rclcpp {
template <typename Message>
struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
struct Node {
  explicit Node(const std::string &) {}
  std::function<void(std::shared_ptr<const sensor_msgs::msg::PointCloud2>)> callback;
  template <typename Message, typename Callback>
  typename Subscription<Message>::SharedPtr create_subscription(
      const std::string & topic, int, Callback given) {
    if (topic == "/plane_detector/planes") callback = given;
    return nullptr;
  }
};
inline void init(int, char **) {}
inline void shutdown() {}
template <typename Kind>
void spin(std::shared_ptr<Kind> node) {
  node->callback(std::make_shared<const sensor_msgs::msg::PointCloud2>(message_of_test()));
}
}  // namespace rclcpp
"""


def cpp_of(msg):
    """Return the source of a function that makes the message."""
    fields = '\n'.join(
        f'  field.name = "{field.name}"; field.offset = {field.offset}; field.count = 1; '
        f'field.datatype = {field.datatype}; msg.fields.push_back(field);' for field in msg.fields)
    return f"""
#include <rclcpp/rclcpp.hpp>
sensor_msgs::msg::PointCloud2 message_of_test() {{
  sensor_msgs::msg::PointCloud2 msg;
  sensor_msgs::msg::PointField field;
{fields}
  msg.height = {msg.height}; msg.width = {msg.width}; msg.is_bigendian = false;
  msg.point_step = {msg.point_step}; msg.row_step = {msg.row_step};
  msg.data = {{{", ".join(map(str, msg.data))}}};
  return msg;
}}
"""


def test_cpp_prints_the_planes(tmp_path):
    compiler = shutil.which('g++') or pytest.skip('no C++ compiler')
    include = next((parent / 'include' for parent in Path(sensor_msgs.__file__).parents
                    if (parent / 'include' / 'sensor_msgs').is_dir()), None)
    if include is None:
        pytest.skip('no C++ headers of sensor_msgs')
    msg = two_planes()
    (tmp_path / 'rclcpp').mkdir()
    (tmp_path / 'rclcpp' / 'rclcpp.hpp').write_text(STAND_IN)
    (tmp_path / 'message.cpp').write_text(cpp_of(msg))
    program = tmp_path / 'plane_listener'
    subprocess.run([compiler, '-std=c++17', '-Wall', '-Werror', '-O0', f'-I{tmp_path}',
                    *(f'-isystem{folder}' for folder in sorted(include.iterdir())),
                    EXAMPLES / 'plane_listener.cpp', tmp_path / 'message.cpp', '-o', program],
                   check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        f'{row["label"]} {name} {row["d"]:.2f} m away, normal ' + ' '.join(
            f'{row[f"normal_{axis}"]:.2f}' for axis in 'xyz')
        for row, name in zip(cloud_array(msg).ravel(), ('wall', 'floor'), strict=True)]


def empty():
    """Return a detection without planes."""
    found = scene.detection()
    return scene.detection(planes=found.planes.selected([]), shapes=(),
                           labels=np.full_like(found.labels, -1))

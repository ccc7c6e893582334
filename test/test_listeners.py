# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The installed examples read what the node publishes.

The one in C++ is compiled with the headers of sensor_msgs and a stand-in for rclcpp, which is not
among the wheels: spinning it calls the subscription with the message of the test.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import output_scene as scene
import pytest
import rclpy
import sensor_msgs
from ros_helpers import cloud_array, random_domain

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.outputs.topics import OUTPUTS

ROOT = Path(__file__).resolve().parents[1]
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
    rclpy.init(domain_id=random_domain())
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


def test_both_know_all_classes(listener):
    assert list(listener['CLASSES']) == NAMES
    source = (EXAMPLES / 'plane_listener.cpp').read_text('utf-8')
    table = re.search(r'kClasses\{(.*?)\}', source, re.DOTALL)[1]
    assert re.findall(r'"([^"]*)"', table) == NAMES


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


@pytest.mark.parametrize('count', [2, 0])
def test_cpp_prints_the_planes(count, tmp_path):
    compiler = shutil.which('g++') or pytest.skip('no C++ compiler')
    include = next((parent / 'include' for parent in Path(sensor_msgs.__file__).parents
                    if (parent / 'include' / 'sensor_msgs').is_dir()), None)
    if include is None:
        pytest.skip('no C++ headers of sensor_msgs')
    msg = two_planes() if count else OUTPUTS['planes'].make(scene.frame(empty()))
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
        for row, name in zip(cloud_array(msg).ravel()[:count], ('wall', 'floor'), strict=False)]


def empty():
    """Return a detection without planes."""
    found = scene.detection()
    return scene.detection(planes=found.planes.picked([]), shapes=(),
                           labels=np.full_like(found.labels, -1))

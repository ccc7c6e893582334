// SPDX-FileCopyrightText: 2026 The plane_detector authors
// SPDX-License-Identifier: Apache-2.0
//
// Print the planes of each image. In the CMakeLists.txt of a package of yours:
//
//   find_package(rclcpp REQUIRED)
//   find_package(sensor_msgs REQUIRED)
//   add_executable(plane_listener plane_listener.cpp)
//   target_link_libraries(plane_listener rclcpp::rclcpp ${sensor_msgs_TARGETS})

#include <array>
#include <cstdint>
#include <cstdio>
#include <memory>

#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <sensor_msgs/point_cloud2_iterator.hpp>

using sensor_msgs::msg::PointCloud2;
template <typename Number>
using Field = sensor_msgs::PointCloud2ConstIterator<Number>;

constexpr std::array<const char *, 8> kClasses{
    "unknown", "floor", "ceiling", "wall", "other horizontal", "other", "ramp", "step"};

class PlaneListener : public rclcpp::Node {
 public:
  PlaneListener() : Node("plane_listener") {
    planes_ = create_subscription<PointCloud2>(
        "/plane_detector/planes", 1,
        [](PointCloud2::ConstSharedPtr planes) { on_planes(*planes); });
  }

 private:
  // normal . p + d = 0; the normal looks at the camera, and d is its distance from the plane.
  static void on_planes(const PointCloud2 & planes) {
    Field<std::uint32_t> label(planes, "label");
    Field<std::uint8_t> kind(planes, "class");
    Field<float> normal(planes, "normal_x");  // normal_y and normal_z follow it
    Field<float> d(planes, "d");
    for (; label != label.end(); ++label, ++kind, ++normal, ++d) {
      const char * name = *kind < kClasses.size() ? kClasses[*kind] : "?";
      std::printf("%u %s %.2f m away, normal %.2f %.2f %.2f\n", *label, name, *d, normal[0],
                  normal[1], normal[2]);
    }
  }

  rclcpp::Subscription<PointCloud2>::SharedPtr planes_;
};

int main(int argc, char ** argv) {
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<PlaneListener>());
  rclcpp::shutdown();
  return 0;
}

#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Give the tables and shelves of the map of planes to MoveIt, as boxes. Copy it, and change it.

    python3 $(ros2 pkg prefix --share plane_detector)/examples/tables_to_moveit.py

The box of the plane with label 3 is the collision object `table_3`. The same name is the support
surface of what stands on it, `support_surface_name` of MoveIt's Pickup and Place, or a link of
the allowed collisions. MoveIt must know the frame of the map.
"""

from contextlib import suppress

# Classes of level surfaces above the floor: 4, and 7 within half a metre of it. A table that fills
# the view of an arm looks like a floor (1), which is no table below z = LEAST_HEIGHT_M. For an arm
# on its own table, whose frame begins there, lower that; or state the height of the camera above
# the floor to the detector (scale.camera_height), which then knows the floor.
ABOVE_FLOOR, FLOOR = (4, 7), 1
LEAST_HEIGHT_M = 0.1
LEAST_SIDE_M = 0.2  # smaller surfaces are left out
THICKNESS_M = 0.02  # of a box; its upper face is the plane


def boxes_of(planes):
    """
    Return the boxes of the tables in ~/map/planes.

    From rows with the fields of the topic; returns a dictionary from the name of each box to its
    centre (x, y, z), its quaternion (x, y, z, w) and its sides, metres in the frame of the map.
    """
    boxes = {}
    for plane in planes:
        is_above = plane['class'] in ABOVE_FLOOR or (
            plane['class'] == FLOOR and plane['rect_z'] > LEAST_HEIGHT_M)
        if (plane['subsumed_by'] or not is_above
                or plane['normal_z'] < 0.9  # an underside, or the frame does not have z up
                or plane['rect_height'] < LEAST_SIDE_M):
            continue
        centre = [float(plane[f'rect_{axis}'] - THICKNESS_M / 2 * plane[f'normal_{axis}'])
                  for axis in 'xyz']
        turn = [float(plane[f'rect_q{axis}']) for axis in 'xyzw']
        sides = [float(plane['rect_width']), float(plane['rect_height']), THICKNESS_M]
        boxes[f'table_{plane["label"]}'] = centre, turn, sides
    return boxes


def main():
    """Follow the map until Ctrl-C."""
    try:
        from moveit_msgs.msg import CollisionObject, PlanningScene
    except ImportError as error:
        raise SystemExit(
            f'MoveIt is missing ({error}): apt install ros-jazzy-moveit-msgs') from error
    import rclpy
    from geometry_msgs.msg import Point, Pose, Quaternion
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import PointCloud2
    from sensor_msgs_py.point_cloud2 import read_points
    from shape_msgs.msg import SolidPrimitive

    rclpy.init()
    node = rclpy.create_node('tables_to_moveit')
    scene = node.create_publisher(PlanningScene, '/planning_scene', 1)
    known = set()

    def on_planes(msg):
        boxes = boxes_of(read_points(msg))
        change = PlanningScene(is_diff=True)
        change.robot_state.is_diff = True
        for name, (centre, turn, sides) in boxes.items():
            x, y, z, w = turn
            change.world.collision_objects.append(CollisionObject(
                header=msg.header, id=name, operation=CollisionObject.ADD,
                pose=Pose(position=Point(x=centre[0], y=centre[1], z=centre[2]),
                          orientation=Quaternion(x=x, y=y, z=z, w=w)),
                primitives=[SolidPrimitive(type=SolidPrimitive.BOX, dimensions=sides)],
                primitive_poses=[Pose()]))
        for name in sorted(known - boxes.keys()):
            change.world.collision_objects.append(CollisionObject(
                header=msg.header, id=name, operation=CollisionObject.REMOVE))
        known.clear()
        known.update(boxes)
        scene.publish(change)

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(PointCloud2, '/plane_detector/map/planes', on_planes, latched)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()

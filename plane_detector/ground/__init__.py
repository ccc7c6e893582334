# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Traversable ground, obstacles and drops.

The lowest level in an image is not the floor: at the head of a staircase it is the landing below.
Planes give the levels and slopes, pixels what lies on them. The steps, as in `ground.find_ground`:

1. The direction down (`own_floor`). If the own floor is level within the error of gravity, it is
   exact: slopes are measured against the own floor, and the error of an IMU tilts nothing.
2. The own floor: the surface at the height of the camera, if that is known; otherwise the one that
   most ways over the ground (`ways`) meet first, which reaches nearest to the robot. Of several
   levels that ways meet first, it is one of half of them that ends at an edge across the view, as
   at the head of stairs seen by a rolled camera; otherwise the lowest, beside tables. A floor too
   rough for a plane is the level of the nearest pixels.
3. Ground: own floor and what joins it (`levels`). Two surfaces join if their planes have the same
   height along their common border in the image; across a step or a jump in depth they have not.
   Pieces of one level join even if something stands between them, and pieces of a floor that a
   sensor bends by less than ``min_height``. Lower levels are ground too: they are no obstacle, the
   edge before them is a drop. The pieces of a curved surface join as planes do.
4. Pixels (`seen_ground`): each way is followed away from the robot. The ground seen last is the
   reference of the pixels behind it: a pixel that stands off it by less than ``min_height``, or by
   less than its error, is ground. So is one without a plane to which the way leads without a step:
   what is behind a ramp may be too small for a plane. Every other one is an obstacle, but for
   specks and flying pixels (`obstacles`). A plane that is not ground differs from it by all its
   pixels: of these only the foot is ground. Depth that was removed because it repeats exactly is
   an obstacle if it is nearer than what is seen elsewhere and not below the ground.
5. Drops: where the ground ends on a way and the next surface seen is lower. An obstacle that is
   met first hides what is behind it: nothing is claimed there. Where nothing at all is seen behind
   the end of the ground, near enough that a floor would be seen, the ground ends too, unless the
   range of the sensor ends there (`sensor_reach`). Where ground goes on behind a gap, the floor
   did not return depth (dark, shiny): that is no drop; nor is a lower surface that would be seen
   through that ground, a reflection.
6. Classes: FLOOR, RAMP and STEP.
"""

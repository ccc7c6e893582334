# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Traversable ground, obstacles and drops.

The lowest level in an image need not be the floor: at the top of a staircase it is the landing
below. Planes determine the levels and slopes, pixels the objects on them. The steps, as in
`ground.find_ground`:

1. The direction down (`own_floor`). If the own floor is level within the error of gravity, its
   normal is that direction: slopes are measured relative to the own floor, and the error of an IMU
   tilts nothing.
2. The own floor: the surface at the height of the camera, if that is known; otherwise the surface
   that most ways, the paths over the ground (`ways`), meet first and that reaches nearest to the
   robot. If ways meet several levels first, it is a level that half of them meet and that ends at
   an edge across the view, as at the top of stairs seen by a rolled camera; otherwise it is the
   lowest level, as beside tables. If the floor is too rough for a plane, it is the level of the
   nearest pixels.
3. Ground: the own floor and the surfaces that join it (`surfaces`). Two surfaces join if their
   planes have the same height along their common border in the image, which is not the case across
   a step or a jump in depth. Pieces of one level join even if something stands between them; so do
   pieces of a floor that a sensor bends by less than ``min_height``. Lower levels are ground too:
   they are not obstacles, and the edge in front of them is a drop. The pieces of a curved surface
   join as planes do.
4. Pixels (`seen_ground`): each way is followed away from the robot. The last ground on it is the
   reference for the pixels behind: a pixel that deviates from it by less than ``min_height``, or
   by less than its error, is ground. So is a pixel without a plane that the way reaches without a
   step, because the surface behind a ramp may be too small for a plane. All other pixels are
   obstacles, except specks and flying pixels (`obstacles`). A plane that is not ground differs
   from it as a whole, so only its foot can be ground. Depth that was removed because it repeats
   exactly is an obstacle if it is nearer than everything else and not below the ground.
5. Drops: where the ground ends on a way and the next visible surface is lower. An obstacle on the
   way hides what is behind it, so nothing is claimed there. Where nothing at all is visible behind
   the end of the ground, near enough that a floor would be visible, the ground ends too, unless
   the range of the sensor ends there (`sensor_reach`). Where ground continues behind a gap, the
   floor did not return depth (dark, shiny), so there is no drop; nor is there one if a lower
   surface would be visible only through that ground: it is a reflection.
6. Classes: FLOOR, RAMP and STEP.
"""

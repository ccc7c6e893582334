# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes and shapes as markers: outlines, normals and captions; surfaces of the shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from plane_detector.geometry.projection import pixel_rays
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.types import Plane, Shape, ShapeType

# As a share of the distance from the camera, like the sizes of captions.
_LINE_WIDTH = 0.006
# chosen: lines in the surface of the points flicker; lifted by this share of the distance towards
# the camera, they are in front of it and look the same from there.
_LIFTED_BY = 0.01
# chosen: parts and holes below this share of a plane's largest part in the image are not drawn:
# half of all outlines, with a sixth of the corners; ~/boundaries has them.
_SMALLEST_OUTLINE = 0.05
# Of captions: legible on every colour; viewers add a dark box.
_WHITE = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
_SURFACE_ALPHA = 0.6
_CONE_SIDES = 24
# chosen: quantiles of a cone's pixels beyond which single wrong ones may lie, for a robust length
_CONE_START = 0.02
# Of captions, as a share of the distance from the camera: they look the same near and far.
_TEXT_HEIGHT = 0.025
# As a share of the distance from the camera.
_ARROW_LENGTH = 0.15
# chosen: limits, as a share of the plane's own size, that keep neighbouring captions apart.
_LARGEST_TEXT_HEIGHT, _LARGEST_ARROW = 0.2, 0.5
# derived: the width of a monospaced character is .6 of its height; viewers draw a box around text.
_ADVANCE, _BOX = 0.6, 1.5
# chosen: a caption stays near its plane, by this share of its distance from the camera.
_FARTHEST_LIFT = 0.25
_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
Blank = dict[str, Any]  # all slots of a marker


def markers_to_msg(frame: DetectedFrame) -> MarkerArray:
    """
    Return the markers of all planes and shapes; the id of a marker is the label of its object.

    The first marker deletes all earlier ones, including those of an earlier node.
    """
    marker = Marker(header=frame.target_header)
    blank = {name: getattr(marker, name) for name in marker.__slots__}
    return MarkerArray(markers=[_marker(blank, action=Marker.DELETEALL),
                                *_plane_markers(frame, blank), *_shape_markers(frame, blank)])


def _plane_markers(frame: DetectedFrame, blank: Blank) -> Iterator[Marker]:
    planes = frame.detection.planes
    widths_m = (_LINE_WIDTH * planes.distances_m).tolist()
    lengths_m = np.minimum(_ARROW_LENGTH * planes.distances_m,
                           _LARGEST_ARROW * np.sqrt(planes.areas_m2))
    tips_m = planes.centroids_m + lengths_m[:, None] * planes.normals
    arrows = messages.point_msgs(frame.placed(
        np.hstack([planes.centroids_m, tips_m]).reshape(-1, 3)))
    texts, heights_m, middles_m = _captions(frame)
    places = messages.pose_msgs(frame.placed(middles_m), np.tile(_NO_ROTATION, (len(planes), 1)))
    for k, (label, corners) in enumerate(zip(planes.labels.tolist(), _outlines(frame),
                                             strict=True)):
        colour = _colour(frame, label)
        if corners:  # none if the plane is too narrow
            # One marker per plane, because a marker costs as much as 25 corners.
            kind = Marker.LINE_STRIP if len(corners) == 1 else Marker.LINE_LIST
            yield _marker(blank, ns='outline', id=label, type=kind, color=colour,
                          scale=Vector3(x=widths_m[k]), points=_sides(corners))
        yield _marker(blank, ns='normal', id=label, type=Marker.ARROW, color=colour,
                      scale=Vector3(x=widths_m[k], y=3 * widths_m[k]),
                      points=arrows[2 * k:2 * k + 2])
        yield _marker(blank, ns='caption', id=label, type=Marker.TEXT_VIEW_FACING, color=_WHITE,
                      scale=Vector3(z=heights_m[k]), text=texts[k], pose=places[k])


def _outlines(frame: DetectedFrame) -> list[list[list[Point]]]:
    """Return the corners of the outlines of each plane that are large enough, lifted from it."""
    large = [[polygon.corners_m for polygon in of_plane
              if polygon.area_px >= _SMALLEST_OUTLINE * of_plane[0].area_px]
             for of_plane in frame.camera_polygons]
    corners = iter(messages.point_msgs(frame.placed((1 - _LIFTED_BY) * np.concatenate(
        [np.zeros((0, 3)), *chain.from_iterable(large)]))))
    return [[list(islice(corners, len(corners_m))) for corners_m in of_plane]
            for of_plane in large]


def _sides(outlines: Sequence[Sequence[Point]]) -> list[Point]:
    """Return the corners of one closed outline, or the ends of all sides of several."""
    if len(outlines) == 1:
        return [*outlines[0], outlines[0][0]]
    return [end for corners in outlines
            for side in zip([corners[-1], *corners[:-1]], corners, strict=True) for end in side]


def _shape_markers(frame: DetectedFrame, blank: Blank) -> Iterator[Marker]:
    """Yield a marker of each shape: a sphere, a cylinder, or the triangles of a cone."""
    labels = messages.shape_labels(frame.detection).tolist()
    for index, (shape, label) in enumerate(zip(frame.shapes, labels, strict=True)):
        diameter_m = 2 * shape.radius_m
        kind, (x_m, y_m, z_m) = {
            ShapeType.CONE: (Marker.TRIANGLE_LIST, (1.0, 1.0, 1.0)),
            ShapeType.CYLINDER: (Marker.CYLINDER, (diameter_m, diameter_m, shape.length_m)),
            ShapeType.SPHERE: (Marker.SPHERE, (diameter_m,) * 3)}[shape.type]
        corners_m = (_cone_corners(shape, _cone_start_m(frame, index))
                     if shape.type == ShapeType.CONE else ())
        yield _marker(blank, ns='shape', id=label, type=kind, scale=Vector3(x=x_m, y=y_m, z=z_m),
                      color=_colour(frame, label, _SURFACE_ALPHA),
                      points=messages.point_msgs(corners_m),
                      pose=messages.pose_msgs(shape.position_m[None],
                                              _orientation(shape.axis)[None])[0])


def _cone_start_m(frame: DetectedFrame, index: int) -> float:
    """Return the distance along the axis from the apex to the visible part of a cone."""
    found = frame.detection
    shape, ray = found.shapes[index], pixel_rays(frame.intrinsics)
    rows, columns = np.nonzero(found.shape_labels == index)
    z_m = found.depth_m[rows, columns]
    points_m = np.stack([z_m * ray[0][columns], z_m * ray[1][rows], z_m], axis=-1)
    along_m = (points_m - shape.position_m) @ shape.axis
    return max(float(np.quantile(along_m, _CONE_START)), 0.0) if along_m.size else 0.0


def _cone_corners(shape: Shape, start_m: float) -> np.ndarray:
    """Return the corners (N, 3) of triangles about the z axis, with the apex at 0."""
    angles = np.linspace(0, 2 * np.pi, _CONE_SIDES + 1)
    circle = np.column_stack([np.cos(angles), np.sin(angles)]) * np.tan(shape.half_angle_rad)
    circle = np.column_stack([circle, np.ones(angles.size)])
    near_m, far_m = start_m * circle, shape.length_m * circle
    return np.stack([near_m[1:], far_m[:-1], far_m[1:], near_m[:-1], far_m[:-1], near_m[1:]],
                    axis=1).reshape(-1, 3)


def _orientation(axis: np.ndarray) -> np.ndarray:
    """Return the shortest rotation x y z w that turns z into an axis; identity for a sphere."""
    x, y, z = axis
    half_way = np.array([-y, x, 0.0, 1.0 + z])
    length = np.linalg.norm(half_way)
    return half_way / length if length else np.array([1.0, 0.0, 0.0, 0.0])


def _marker(blank: Blank, **fields: Any) -> Marker:
    """Return a marker with other fields than a blank one."""
    return messages.assembled(Marker, **(blank | {f'_{name}': fields[name] for name in fields}))


def _colour(frame: DetectedFrame, label: int, alpha: float = 1.0) -> ColorRGBA:
    red, green, blue = (frame.colours[label] / 255.0).tolist()
    return ColorRGBA(r=red, g=green, b=blue, a=alpha)


def plane_name(plane: Plane) -> str:
    """Return the label of a plane with its class."""
    return f'{plane.label} {plane.plane_class.readable}'


def _captions(frame: DetectedFrame) -> tuple[list[str], list[float], np.ndarray]:
    """
    Return label, class and d of each plane as a text, its height, and its centre (K, 3).

    The centre is where the plane is widest in the image, in the frame of the camera. The text
    faces the viewer. It is lifted along the normal so that, seen from the camera, it does not
    intersect the plane.
    """
    planes, camera = frame.detection.planes, frame.intrinsics
    unit = ' m' if frame.detection.scale.is_metric else ''
    texts = [f'{plane_name(plane)}, d {plane.offset_m:.2f}{unit}' for plane in planes]
    middles_m = planes.centroids_m.copy()
    for k, label in enumerate(planes.labels.tolist()):
        if (place := frame.label_places.get(label)) is not None:
            z_m = float(frame.detection.depth_m[place.row, place.column])
            middles_m[k] = (z_m * (place.column - camera.cx) / camera.fx,
                            z_m * (place.row - camera.cy) / camera.fy, z_m)
    distances_m = np.sqrt((middles_m**2).sum(axis=1))
    heights_m = np.minimum(_TEXT_HEIGHT * distances_m,
                           _LARGEST_TEXT_HEIGHT * np.sqrt(planes.areas_m2))
    widths_m = _ADVANCE * heights_m * np.array([len(text) for text in texts])
    lifts_m = np.minimum(
        _BOX / 2 * (abs(planes.normals[:, 0]) * widths_m + abs(planes.normals[:, 1]) * heights_m)
        + _LIFTED_BY * distances_m, _FARTHEST_LIFT * distances_m)
    return texts, heights_m.tolist(), middles_m + lifts_m[:, None] * planes.normals

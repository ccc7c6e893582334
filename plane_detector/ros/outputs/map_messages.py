# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the map of planes: ~/map/planes, ~/map/boundaries and ~/map/markers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from geometry_msgs.msg import Vector3
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from plane_detector.drawing import plane_colours
from plane_detector.mapping.cells import runs
from plane_detector.mapping.map_plane import MapPlane, polygons_of, rectangles_of
from plane_detector.planes.outline import Polygon
from plane_detector.planes.plane_table import FIRST, FORMATS
from plane_detector.ros.outputs.clouds import corners_to_msg
from plane_detector.ros.outputs.frame import MapView
from plane_detector.ros.outputs.messages import cloud_msg, point_msgs

_OF_MAP = {'first_seen': '<f8', 'last_seen': '<f8', 'views': '<u4', 'subsumed_by': '<u4'}
MAP_PLANE_DTYPE = np.dtype(list({**{name: FORMATS[name] for name in FIRST}, **_OF_MAP,
                                 **FORMATS}.items()), align=True)
_ALPHA = 0.5


def map_planes_to_msg(view: MapView) -> PointCloud2:
    """
    Return one point per plane, then one per plane that was merged since the last message.

    The latter have only a label and ``subsumed_by``, the label of the plane that they are part of
    now.
    """
    planes, surfaces = view.snapshot.planes, view.snapshot.surfaces
    table = np.zeros(len(planes) + len(view.subsumed), MAP_PLANE_DTYPE)
    own, gone = table[:len(planes)], table[len(planes):]
    planes.write_to(own)
    rectangles_of(surfaces).moved(view.snapshot.to_poses).write_to(own)
    for name, values in (
            ('first_seen', [plane.first_seen_s for plane in surfaces]),
            ('last_seen', [plane.last_seen_s for plane in surfaces]),
            ('views', [plane.views for plane in surfaces])):
        own[name] = values
    for row, (label, larger) in zip(gone, sorted(view.subsumed.items()), strict=True):
        row['label'], row['subsumed_by'] = label, larger
    return cloud_msg(view.header, MAP_PLANE_DTYPE, table, 1, len(table))


def map_boundaries_to_msg(view: MapView) -> PointCloud2:
    """Return one point per corner of the outlines, as in ~/boundaries."""
    return corners_to_msg(view.header, [
        (plane.label, Polygon(view.snapshot.to_poses.points(polygon.corners_m), polygon.is_hole))
        for plane in view.snapshot.surfaces for polygon in polygons_of(plane)])


def map_markers_to_msg(view: MapView) -> MarkerArray:
    """Return a filled surface for each plane; the first marker deletes the earlier ones."""
    return MarkerArray(markers=[Marker(header=view.header, action=Marker.DELETEALL),
                                *_surfaces(view)])


def _surfaces(view: MapView) -> Iterator[Marker]:
    planes = view.snapshot.planes
    colours = plane_colours(planes.labels, planes.classes) / 255
    for plane, (red, green, blue) in zip(view.snapshot.surfaces, colours.tolist(), strict=True):
        yield Marker(
            header=view.header, ns='map', id=plane.label, type=Marker.TRIANGLE_LIST,
            scale=Vector3(x=1.0, y=1.0, z=1.0), color=ColorRGBA(r=red, g=green, b=blue, a=_ALPHA),
            points=point_msgs(view.snapshot.to_poses.points(_triangles(plane))))


def _triangles(plane: MapPlane) -> np.ndarray:
    """Return the corners (N, 3) of two triangles for each run of observed cells."""
    first_row, last_row, first, last = runs(plane.cells).T
    corners = [(first, first_row), (last, first_row), (last, last_row),
               (first, first_row), (last, last_row), (first, last_row)]
    flat = np.stack([np.column_stack(corner) for corner in corners], axis=1).reshape(-1, 2)
    return plane.points(plane.cells.size_m * (flat + np.array(plane.cells.low)))

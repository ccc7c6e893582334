# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Export a map of planes: a floor plan as SVG or GeoJSON, keep-out zones for Nav2, surfaces as PLY.

    ros2 run plane_detector export planes.json --floor-plan plan.svg --keep-out keep_out.yaml
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import cv2
import numpy as np
import yaml

from plane_detector import PAGES
from plane_detector._runtime.ending import run_program
from plane_detector.drawing import plane_colours
from plane_detector.mapping.map_file import SavedMap, read_map
from plane_detector.mapping.map_plane import MapPlane, polygons_of, rectangles_of
from plane_detector.types import PlaneClass

# A wall exists where it was observed between these heights above the floor: a doorway is a gap,
# which neither a lintel nor a threshold closes.
WALL_FROM_M, WALL_TO_M = 0.3, 1.7
# chosen: gaps too narrow for a robot are closed.
LEAST_GAP_M = 0.4
# chosen: planes within 10 degrees of it are level, and within 10 degrees of upright are walls.
_LEVEL, _UPRIGHT = np.cos(np.radians(10.0)), np.sin(np.radians(10.0))
# chosen: the resolution of the usual costmaps.
KEEP_OUT_CELL_M = 0.05
# The longer side of a floor plan, its border, and the strip below with scale and legend.
_LONG_SIDE_PX, _BORDER_PX, _STRIP_PX = 1000, 40, 70
# Wide enough for the height of a surface to be written on it.
_NAMED_PX = 60
# The usual colours: floors green, level surfaces yellow-brown, walls blue.
_STYLE = """
.paper { fill: #fff } .floor { fill: #cfe8c8 } .surface { fill: #e8c98a; stroke: #8a6d2b }
.wall { stroke: #2b5fa8; stroke-width: 6; stroke-linecap: round } .ink { stroke: #222 }
text { font: 16px sans-serif; fill: #222 }
@media (prefers-color-scheme: dark) {
.paper { fill: #181a1b } .floor { fill: #2c4a2a } .surface { fill: #7a6230; stroke: #d9b866 }
.wall { stroke: #7fb0f5 } .ink { stroke: #ddd } text { fill: #ddd } }
"""


@dataclass(frozen=True)
class Level:
    """A level surface: the floor, or a table or shelf above it."""

    label: int
    kind: str  # ``floor`` or ``surface``
    plane_class: str
    height_m: float  # above the floor
    size_m: tuple[float, float]  # sides of the smallest rectangle around it
    parts: tuple[tuple[np.ndarray, bool], ...]  # corners (N, 2), x and y, and whether it is a hole


@dataclass(frozen=True)
class FloorPlan:
    """Walls and level surfaces from above, in the frame of the map; z is up."""

    frame_id: str
    walls: tuple[tuple[int, np.ndarray], ...]  # label and both ends (2, 2), metres
    levels: tuple[Level, ...]  # the floor first, then by height


def floor_plan(saved: SavedMap) -> FloorPlan:
    """
    Return the plan of a map whose frame has z up, such as odom or map.

    Examples
    --------
    >>> from plane_detector.geometry.rigid_transform import RigidTransform
    >>> floor_plan(SavedMap((), RigidTransform.identity(), 'odom', 0.0)).walls
    ()

    """
    to_frame = saved.transform.inverse()
    heights = {plane.label: to_frame.points(plane.centroid_m)[2] for plane in saved.planes}
    floors = [plane for plane in saved.planes if plane.plane_class == PlaneClass.FLOOR]
    largest = max(floors, key=lambda plane: plane.cells.count, default=None)
    floor_m = heights[largest.label] if largest else min(heights.values(), default=0.0)
    walls, levels = [], []
    for plane in saved.planes:
        up = to_frame.rotation @ plane.axes[2]
        if abs(up[2]) < _UPRIGHT:
            walls += [(plane.label, to_frame.points(ends_m)[:, :2])
                      for ends_m in _wall_pieces(plane, to_frame, floor_m)]
        elif up[2] > _LEVEL:
            (rectangle,) = rectangles_of([plane])
            levels.append(Level(
                plane.label, 'floor' if plane in floors else 'surface',
                plane.plane_class.readable, float(heights[plane.label] - floor_m),
                (rectangle.width_m, rectangle.height_m), tuple(
                    (to_frame.points(polygon.corners_m)[:, :2], polygon.is_hole)
                    for polygon in polygons_of(plane))))
    levels.sort(key=lambda level: (level.kind != 'floor', level.height_m))
    return FloorPlan(saved.frame_id, tuple(walls), tuple(levels))


def _wall_pieces(plane: MapPlane, to_frame, floor_m: float) -> list[np.ndarray]:
    """Return both ends (2, 3) of each piece of a wall between its doorways."""
    cells = plane.cells
    rows, columns = np.nonzero(cells.seen)
    flat_m = cells.size_m * (np.column_stack([columns, rows]) + np.array(cells.low) + 0.5)
    height_m = to_frame.points(plane.points(flat_m))[:, 2] - floor_m
    is_there = np.zeros(cells.seen.shape[1], int)
    np.add.at(is_there, columns[(height_m > WALL_FROM_M) & (height_m < WALL_TO_M)], 1)
    # Most of the height, so that neither a picture rail nor a parapet of one cell is a wall.
    there = np.flatnonzero(is_there * cells.size_m > 0.3)
    if not len(there):
        return []
    gaps = np.flatnonzero(np.diff(there) * cells.size_m > LEAST_GAP_M)
    starts, ends = np.append(0, gaps + 1), np.append(gaps, len(there) - 1)
    middle_v = flat_m[:, 1].mean()
    return [plane.points(np.array([
        [cells.size_m * (there[start] + cells.low[0]), middle_v],
        [cells.size_m * (there[end] + 1 + cells.low[0]), middle_v]]))
        for start, end in zip(starts, ends, strict=True)]


def to_svg(plan: FloorPlan) -> str:
    """Return the plan as SVG, y up, with scale and legend, for light and dark viewers."""
    points = [ends for _, ends in plan.walls] + [
        corners for level in plan.levels for corners, _ in level.parts]
    together = np.vstack(points) if points else np.zeros((1, 2))
    low, high = together.min(axis=0), together.max(axis=0)
    px_per_m = _LONG_SIDE_PX / max(*(high - low), 1.0)

    def place(corners: np.ndarray) -> np.ndarray:
        return np.round(_BORDER_PX + px_per_m * np.column_stack(
            [corners[:, 0] - low[0], high[1] - corners[:, 1]]), 1)

    width, bottom = (2 * _BORDER_PX + px_per_m * (high - low)).round().astype(int)
    width, height = max(width, 600), bottom + _STRIP_PX
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
             f'width="{width}" height="{height}">', f'<style>{_STYLE}</style>',
             f'<rect class="paper" width="{width}" height="{height}"/>']
    names = []
    for level in plan.levels:
        rings = [place(corners) for corners, _ in level.parts]
        path = ' '.join('M' + ' L'.join(f'{x} {y}' for x, y in ring.tolist()) + ' Z'
                        for ring in rings)
        lines.append(f'<path d="{path}" class="{level.kind}" fill-rule="evenodd">'
                     f'<title>{_title(level)}</title></path>')
        largest = max(rings, key=lambda ring: np.ptp(ring, axis=0).min(), default=None)
        if level.kind == 'surface' and largest is not None and (
                np.ptp(largest, axis=0).min() > _NAMED_PX):
            x, y = ((largest.min(axis=0) + largest.max(axis=0)) / 2).tolist()
            names.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle">'
                         f'{level.height_m:.2f} m</text>')
    for label, ends in plan.walls:
        (x1, y1), (x2, y2) = place(ends).tolist()
        lines.append(f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" class="wall">'
                     f'<title>wall {label}</title></line>')
    return '\n'.join([*lines, *names, *_legend(bottom, px_per_m, plan.frame_id), '</svg>', ''])


def _legend(top: int, px_per_m: float, frame_id: str) -> list[str]:
    """Return the strip below a plan: length of a metre, colours, frame."""
    y, metre = top + 20, round(px_per_m, 1)
    start = _BORDER_PX
    lines = [f'<path class="ink" fill="none" d="M{start} {y - 8} v16 m0 -8 h{metre} m0 -8 v16"/>',
             f'<text x="{start + metre + 10:.1f}" y="{y + 6}">1 m, frame {escape(frame_id)}'
             '</text>']
    for k, (kind, name) in enumerate((('floor', 'floor'), ('surface', 'level surface, its height'),
                                      ('wall', 'wall'))):
        x = start + (0, 110, 360)[k]
        lines += [f'<rect class="{kind}" x="{x}" y="{y + 18}" width="24" height="16"/>'
                  if kind != 'wall' else
                  f'<path class="wall" d="M{x} {y + 26} h24"/>',
                  f'<text x="{x + 32}" y="{y + 32}">{name}</text>']
    return lines


def _title(level: Level) -> str:
    width_m, depth_m = level.size_m
    return (f'{level.plane_class} {level.label}: {level.height_m:.2f} m above the floor, '
            f'{width_m:.2f} x {depth_m:.2f} m')


def to_geojson(plan: FloorPlan) -> str:
    """Return the plan as GeoJSON; coordinates are metres in the frame of the map, not degrees."""
    features = [{'type': 'Feature', 'properties': {'kind': 'wall', 'label': label},
                 'geometry': {'type': 'LineString', 'coordinates': ends.round(3).tolist()}}
                for label, ends in plan.walls]
    for level in plan.levels:
        rings: list[list] = []
        for corners, is_hole in level.parts:
            ring = np.vstack([corners, corners[:1]]).round(3).tolist()
            if is_hole and rings:
                rings[-1].append(ring)
            else:
                rings.append([ring])
        features.append({
            'type': 'Feature', 'properties': {
                'kind': level.kind, 'label': level.label, 'class': level.plane_class,
                'height_m': round(level.height_m, 3),
                'size_m': [round(side_m, 3) for side_m in level.size_m]},
            'geometry': {'type': 'MultiPolygon', 'coordinates': rings}})
    return json.dumps({'type': 'FeatureCollection', 'frame': plan.frame_id, 'units': 'm',
                       'features': features}, indent=1)


def write_keep_out(plan: FloorPlan, path: Path) -> None:
    """Write the walls as a map for Nav2's map server: a YAML file, and an image next to it."""
    ends = np.vstack([ends for _, ends in plan.walls] or [np.zeros((1, 2))])
    low, high = ends.min(axis=0) - 1.0, ends.max(axis=0) + 1.0
    width, height = np.ceil((high - low) / KEEP_OUT_CELL_M).astype(int).tolist()
    image = np.full((height, width), 254, np.uint8)  # free
    for _, both in plan.walls:
        (x1, y1), (x2, y2) = np.floor((both - low) / KEEP_OUT_CELL_M).astype(int).tolist()
        cv2.line(image, (x1, height - 1 - y1), (x2, height - 1 - y2), 0, 1)
    picture = path.with_suffix('.pgm')
    if not cv2.imwrite(str(picture), image):
        raise OSError(f'{picture} cannot be written')
    path.write_text(yaml.safe_dump({
        'image': picture.name, 'mode': 'trinary', 'resolution': KEEP_OUT_CELL_M,
        'origin': [*low.round(3).tolist(), 0.0], 'negate': 0, 'occupied_thresh': 0.65,
        'free_thresh': 0.25}, sort_keys=False), encoding='utf-8')


def to_ply(saved: SavedMap) -> str:
    """
    Return the surfaces as a mesh with the colours of their classes, in ASCII PLY.

    Its faces are convex pieces of the outlines without their holes, counterclockwise on the
    observed side, each with the label of its plane.
    """
    to_frame, vertices, faces = saved.transform.inverse(), [], []
    labels = np.array([plane.label for plane in saved.planes], int)
    classes = np.array([plane.plane_class for plane in saved.planes], int)
    for plane, colour in zip(saved.planes, plane_colours(labels, classes).tolist(), strict=True):
        for piece in convex_pieces([corners for corners, _ in plane.cells.outlines]):
            faces.append(' '.join(map(str, [len(piece), *(
                len(vertices) + k for k in range(len(piece))), plane.label])))
            vertices += [' '.join([*(f'{value:.4f}' for value in corner_m), *map(str, colour)])
                         for corner_m in to_frame.points(plane.points(piece)).tolist()]
    return '\n'.join([
        'ply', 'format ascii 1.0', f'element vertex {len(vertices)}',
        *(f'property float {axis}' for axis in 'xyz'),
        *(f'property uchar {name}' for name in ('red', 'green', 'blue')),
        f'element face {len(faces)}', 'property list uchar int vertex_indices',
        'property int label', 'end_header', *vertices, *faces, ''])


def convex_pieces(rings: Sequence[np.ndarray]) -> list[np.ndarray]:
    """
    Return trapezoids and triangles (3 or 4, 2), counterclockwise, that fill closed outlines.

    Holes are outlines inside others. Between two consecutive corner heights no edge ends. There,
    each edge encloses a piece with the next edge in order; the piece continues as long as the two
    stay neighbours.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]])
    >>> len(convex_pieces([square])), len(convex_pieces([square, square / 3 + 1]))
    (1, 4)

    """
    if not rings:
        return []
    corners = np.concatenate(rings)
    edges = np.stack([corners, np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])], 1)
    edges = edges[edges[:, 0, 1] != edges[:, 1, 1]]
    is_down = edges[:, 0, 1] > edges[:, 1, 1]
    edges[is_down] = edges[is_down, ::-1]
    levels = np.unique(corners[:, 1])

    def across(index: np.ndarray, height: float) -> np.ndarray:
        (x, low), (x_high, high) = edges[index].transpose(1, 2, 0)
        return x + (x_high - x) * ((height - low) / (high - low))

    pieces: list[np.ndarray] = []
    begun: dict[tuple[int, int], float] = {}
    for low, high in zip(levels, [*levels[1:], np.inf], strict=True):
        there = np.flatnonzero((edges[:, 0, 1] <= low) & (edges[:, 1, 1] >= high))
        there = there[np.argsort(across(there, (low + high) / 2))].tolist() if len(there) else []
        pairs = {pair: begun.get(pair, low)
                 for pair in zip(there[::2], there[1::2], strict=True)}
        for pair, begin in begun.items():
            if pair not in pairs:
                # Simplified outlines may cross each other a little.
                lower, upper = (np.sort(across(np.array(pair), y)) for y in (begin, low))
                whole = np.array([[lower[0], begin], [lower[1], begin], [upper[1], low],
                                  [upper[0], low]])
                pieces.append(whole[(whole != np.roll(whole, 1, axis=0)).any(axis=1)])
        begun = pairs
    return [piece for piece in pieces if len(piece) > 2]  # outlines may touch themselves


def main(arguments: Sequence[str] | None = None) -> int:
    """Export; return the exit code."""
    parser = argparse.ArgumentParser(prog='ros2 run plane_detector export',
                                     description=__doc__.strip().splitlines()[0],
                                     epilog=f'More: {PAGES}/map.md')
    parser.add_argument('map', type=Path, metavar='FILE', help='of ~/map/save or replay --map')
    parser.add_argument('--floor-plan', type=Path, metavar='SVG')
    parser.add_argument('--geojson', type=Path, metavar='JSON')
    parser.add_argument('--keep-out', type=Path, metavar='YAML')
    parser.add_argument('--ply', type=Path, metavar='PLY')
    options = parser.parse_args(arguments)
    if not (options.floor_plan or options.geojson or options.keep_out or options.ply):
        parser.error('nothing to write: state --floor-plan, --geojson, --keep-out or --ply')
    return run_program('export', lambda: _export(options))


def _export(options: argparse.Namespace) -> int:
    _check_paths(options)
    saved = read_map(options.map)
    plan = floor_plan(saved)
    for path, text in ((options.floor_plan, to_svg(plan)), (options.geojson, to_geojson(plan)),
                       (options.ply, to_ply(saved))):
        if path is not None:
            path.write_text(text, encoding='utf-8')
            print(f'{path} is written')
    if options.keep_out is not None:
        write_keep_out(plan, options.keep_out)
        print(f'{options.keep_out} is written')
    return 0


def _check_paths(options: argparse.Namespace) -> None:
    """Raise ValueError if a file would overwrite the map or another file."""
    used = {options.map.resolve(): 'the map'}
    picture = options.keep_out and options.keep_out.with_suffix('.pgm')
    for path, what in ((options.floor_plan, '--floor-plan'), (options.geojson, '--geojson'),
                       (options.ply, '--ply'), (options.keep_out, '--keep-out'),
                       (picture, 'the image of --keep-out')):
        if path is not None and (other := used.setdefault(path.resolve(), what)) != what:
            raise ValueError(f'{what} would overwrite {other}, {path}: choose another name')


if __name__ == '__main__':
    sys.exit(main())

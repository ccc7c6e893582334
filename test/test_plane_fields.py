# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Every column of planes is that of the rendered scene, in every frame and unit, also in messages.

The truth is computed here from points of the scene; in another frame, from the moved points.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plane_detector import CameraIntrinsics, Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig, ScaleConfig, TrackingConfig
from plane_detector.directions.finder import CameraImage, find_in_image
from plane_detector.evaluation.metrics import overlap
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.plane_fields import POWERS, columns_of
from plane_detector.planes.measurement import measure_planes
from plane_detector.planes.outline import PlacedDetection, Rectangles
from plane_detector.planes.plane_table import FIRST, PLANE_DTYPE, PUBLISHED
from plane_detector.planes.reorientation import reorient
from plane_detector.segmentation.segment import metric_noise_floor, segment
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import PlaneClass, Planes

CAMERA = CameraIntrinsics(290.0, 330.0, 170.0, 105.0, 320, 240)
SEEDS, SIGMA = range(8230, 8236), 0.002
COLUMNS = columns_of(Planes)
# Of planes with fewer pixels, a few of their neighbours outweigh the noise.
LEAST_PIXELS = 2000


@dataclass
class View:
    """Planes found in an image, and what the renderer knows of each, in one frame and unit."""

    planes: Planes
    points: list  # measured, (N, 3) of each plane
    exact: list  # where the same pixels see the true plane
    squares: list  # (N, 4, 3), the corners of these pixels there
    camera: np.ndarray
    down: np.ndarray
    floor_height: float
    unit: float = 1.0  # of a metre
    others: tuple = ()  # labels of the same planes in the image before

    def moved(self, turn, shift, scale):
        def place(points):
            return scale * points @ turn.T + shift
        return replace(self, planes=self.planes.moved(RigidTransform(turn, shift), scale),
                       points=[place(one) for one in self.points],
                       exact=[place(one) for one in self.exact],
                       squares=[place(one) for one in self.squares], camera=place(self.camera),
                       down=turn @ self.down, floor_height=scale * self.floor_height,
                       unit=scale * self.unit)

    def selected(self, index):
        def some(values):
            return [values[k] for k in np.arange(len(self.planes))[index]]
        return replace(self, planes=self.planes[index], points=some(self.points),
                       exact=some(self.exact), squares=some(self.squares),
                       others=some(self.others))

    def equations(self):
        """Return the true planes (K, 4), normals towards the camera."""
        found = []
        for points in self.exact:
            middle = points.mean(axis=0)
            normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
            normal *= np.sign((self.camera - middle) @ normal)
            found.append([*normal, -normal @ middle])
        return np.array(found)


def on_plane(equation, u, v):
    """Return where the rays of pixels meet a plane, (..., 3)."""
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy,
                     np.ones(u.shape)], axis=-1)
    return -equation[3] / (rays @ equation[:3])[..., None] * rays


@cache
def image(seed):
    """Return the view of an image of a room, the second of a stream, and the detection."""
    scene = random_room(np.random.default_rng(seed), CAMERA)
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic'),
                                    scale=ScaleConfig(gravity=tuple(scene.gravity_camera))))
    before, found = (detector.detect(scene.rgb, CAMERA, with_disparity_noise(
        scene.depth_m, SIGMA, np.random.default_rng(seed + k), 0.0, 1)) for k in range(2))
    iou, v, u = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m)).iou, *np.indices(
        found.labels.shape).astype(float)
    large = np.flatnonzero((iou.max(axis=0) > 0.8) & (found.planes.counts > LEAST_PIXELS))
    view = View(found.planes[large], [], [], [], np.zeros(3), scene.gravity_camera,
                scene.height_m, others=[])
    for k in large:
        mask, equation = found.labels == k, scene.planes[iou[:, k].argmax()]
        pixels = u[mask], v[mask]
        rays = np.stack([(pixels[0] - CAMERA.cx) / CAMERA.fx, (pixels[1] - CAMERA.cy) / CAMERA.fy,
                         np.ones(mask.sum())], axis=1)
        view.points.append(found.depth_m[mask][:, None] * rays)
        view.exact.append(on_plane(equation, *pixels))
        view.squares.append(on_plane(equation, *(
            one[:, None] + np.array(steps) for one, steps in zip(
                pixels, ([-0.5, 0.5, 0.5, -0.5], [-0.5, -0.5, 0.5, 0.5]), strict=True))))
        same = np.bincount(before.labels[mask & (before.labels >= 0)]).argmax()
        view.others.append(before.planes.labels[same])
    return view, found


def frames():
    turn, shift = Rotation.from_euler('xyz', [30, -50, 70], degrees=True).as_matrix(), np.array(
        [3.0, -2.0, 1.0])
    return {'camera': lambda view: view, 'moved': lambda view: view.moved(turn, shift, 1.0),
            'scaled': lambda view: view.moved(np.eye(3), np.zeros(3), 2.5),
            'moved and scaled': lambda view: view.moved(turn, shift, 0.4),
            'sliced': lambda view: view.selected(slice(None, None, -2)),
            'selected and moved': lambda view: view.selected([1, 0]).moved(turn, shift, 0.4)}


FRAMES = frames()


def areas(view):
    found = []
    for square in view.squares:
        first, second = square[:, 2] - square[:, 0], square[:, 3] - square[:, 1]
        found.append(0.5 * np.linalg.norm(np.cross(first, second), axis=1).sum())
    return found


def z_scores(view):
    """Return the distances of points of true planes from those found, in standard deviations."""
    scores = []
    for plane, exact in zip(view.planes, view.exact, strict=True):
        points = np.column_stack([exact[::97], np.ones(len(exact[::97]))])
        variances = np.einsum('ni,ij,nj->n', points, plane.covariance, points)
        scores.append(np.sqrt(np.mean((points @ [*plane.normal, plane.offset_m])**2 / variances)))
    return np.array(scores)


def classes(view):
    """Return the class of each true plane: rooms have a floor, walls, and boxes on the floor."""
    found = []
    for normal, points in zip(view.equations()[:, :3], view.exact, strict=True):
        up = -normal @ view.down
        height = view.floor_height - (points.mean(axis=0) - view.camera) @ view.down
        found.append(PlaneClass.WALL if abs(up) < 0.02 else PlaneClass.CEILING if up < -0.99
                     else PlaneClass.FLOOR if up > 0.99 and abs(height) < 0.01 * view.unit
                     else None)
    return found


def check_normals(view):
    cosines = (view.planes.normals * view.equations()[:, :3]).sum(axis=1)
    assert cosines == pytest.approx(1, abs=3e-5)  # .44 degrees
    assert np.linalg.norm(view.planes.normals, axis=1) == pytest.approx(1)


def check_offsets(view):
    for plane, exact in zip(view.planes, view.exact, strict=True):
        off = exact.mean(axis=0) @ plane.normal + plane.offset_m
        assert off == pytest.approx(0, abs=0.01 * view.unit)


def check_centroids(view):
    for plane, points in zip(view.planes, view.exact, strict=True):
        size = np.linalg.norm(points.std(axis=0))
        assert np.linalg.norm(plane.centroid_m - points.mean(axis=0)) < 0.05 * size
        assert plane.centroid_m @ plane.normal + plane.offset_m == pytest.approx(
            0, abs=1e-6 * view.unit)


def check_rms(view):
    for plane, points, normal in zip(view.planes, view.points, view.equations()[:, :3],
                                     strict=True):
        off = (points - points.mean(axis=0)) @ normal
        assert plane.rms_m == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.1)


def check_covariances(view):
    assert 0.3 < np.sqrt(np.mean(z_scores(view)**2)) < 3


def check_classes(view):
    for found, truth in zip(view.planes.classes, classes(view), strict=True):
        assert truth in (None, found)


# How each column is compared with the scene; with every new one comes its truth.
CHECKS = {
    'normals': check_normals, 'offsets_m': check_offsets, 'centroids_m': check_centroids,
    'counts': lambda view: [plane.inlier_count for plane in view.planes] == [
        len(points) for points in view.points],
    'rms_m': check_rms,
    'areas_m2': lambda view: view.planes.areas_m2 == pytest.approx(areas(view), rel=0.05),
    'covariances': check_covariances,
    'confidences': lambda view: (view.planes.confidences > 0.9).all(),
    'classes': check_classes,
    'labels': lambda view: view.planes.labels.tolist() == list(view.others),
    # Their scenes are below.
    'class_certainties': lambda view: np.isnan(view.planes.class_certainties).all(),
    'merged': lambda view: not view.planes.merged.any()}


@pytest.mark.parametrize('frame', FRAMES)
@pytest.mark.parametrize('column', COLUMNS)
def test_every_column_is_that_of_the_scene(column, frame):
    for seed in SEEDS:
        view = FRAMES[frame](image(seed)[0])
        assert len(view.planes) >= 2
        assert CHECKS[column](view) in (None, True), seed


def test_the_planes_of_a_single_image_are_numbered():
    scene = random_room(np.random.default_rng(SEEDS[0]), CAMERA)
    labels = segment_planes(scene.depth_m, CAMERA).planes.labels
    assert labels.tolist() == list(range(1, len(labels) + 1)) != []


def test_the_scenes_have_what_the_checks_compare():
    kinds = [kind for seed in SEEDS for kind in classes(image(seed)[0])]
    assert {PlaneClass.FLOOR, PlaneClass.WALL} <= set(kinds)
    assert sum(kind is not None for kind in kinds) > 15


@pytest.mark.parametrize('frame', FRAMES)
def test_errors_move_with_their_planes(frame):
    """The distance of a point from a plane in standard deviations is the same in every frame."""
    for seed in SEEDS:
        view = image(seed)[0]
        found = FRAMES[frame](view)
        scores = dict(zip(view.planes.labels.tolist(), z_scores(view), strict=True))
        assert z_scores(found) == pytest.approx(
            [scores[label] for label in found.planes.labels.tolist()], rel=1e-5)


def with_classes_by_lines():
    """Return the scene, and planes of smoothly wrong depth that lines of the image oriented."""
    scene, config = textured(random_room, 304), Config()
    depth_m = with_disparity_noise(scene.depth_m, 0.02, np.random.default_rng(304), 0.998, 90.0)
    regions = segment(1 / depth_m, metric_noise_floor(config, 0.004), config,
                      np.random.default_rng(0))
    planes, labels = measure_planes(regions, scene.intrinsics, 1000)
    regions = reorient(replace(regions, labels=labels), planes, find_in_image(
        CameraImage(scene.rgb, scene.intrinsics)), scene.intrinsics)
    return scene, *measure_planes(regions, scene.intrinsics, 1000)


def test_the_certainty_of_classes_is_that_of_the_lines():
    scene, planes, labels = with_classes_by_lines()
    true = scene.planes[overlap(scene.labels, labels, np.ones(labels.shape, bool)).iou.argmax(0)]
    sure = planes.class_certainties > 0.9
    assert sure.sum() >= 3

    def kind(normals):
        up = abs(normals @ scene.gravity_camera)
        return (up > 0.99).astype(int) - (up < 0.14)
    assert (kind(planes.normals) == kind(true[:, :3]))[sure].mean() > 0.8


def with_merged_label():
    """Return the largest plane of an image after its smaller part had a label of its own."""
    _, found = image(SEEDS[0])
    labels = np.where(found.labels == 0, 0, -1).astype(np.int32)
    left = np.arange(labels.shape[1]) < np.quantile(np.nonzero(labels == 0)[1], 0.3)
    split = np.where((labels == 0) & left, 1, labels)
    tracker = PlaneTracker()
    parts = tracker.update(replace(found, planes=found.planes[[0, 0]], labels=split),
                           TrackingConfig()).planes
    return parts, tracker.update(replace(found, planes=found.planes[:1], labels=labels),
                                 TrackingConfig()).planes


def test_a_merged_plane_has_the_label_of_its_smaller_part():
    parts, whole = with_merged_label()
    assert whole.labels.tolist() == [parts.labels[0]]
    assert whole.merged.tolist() == [parts.labels[1]] != [0]


def test_no_column_stays_at_its_default_in_all_scenes():
    seen = [image(seed)[0].planes for seed in SEEDS]
    seen += [with_classes_by_lines()[1], with_merged_label()[1]]
    for name, row in COLUMNS.items():
        nothing = 0 if row.default is None else row.default
        values = [getattr(planes, name) for planes in seen]
        assert any(np.any((one != nothing) & ~np.isnan(one)) for one in values), name
        assert all(one.dtype == row.dtype for one in values), name
        assert all(one.shape[1:] == row.shape for one in values), name


def written(view, found):
    table = np.zeros(len(found.planes), PLANE_DTYPE)
    placed = PlacedDetection(found, CAMERA)
    placed.planes.write_to(table)
    placed.rectangles.write_to(table)
    return table[np.isin(found.planes.labels, view.planes.labels)]


def test_every_field_of_a_message_has_its_value():
    for seed in SEEDS:
        view, found = image(seed)
        table, planes = written(view, found), view.planes
        for names, values in (
                ('x y z', planes.centroids_m), ('normal_x normal_y normal_z', planes.normals),
                ('d', planes.offsets_m), ('label', planes.labels), ('num_inliers', planes.counts),
                ('rms', planes.rms_m), ('area', planes.areas_m2), ('class', planes.classes),
                ('confidence', planes.confidences)):
            for name, column in zip(names.split(), np.atleast_2d(values.T), strict=True):
                np.testing.assert_array_equal(table[name], column.astype(table.dtype[name]))
        for row, plane in zip(table, planes, strict=True):
            upper = [row[f'cov_{a}{b}'] for k, a in enumerate('xyzd') for b in 'xyzd'[k:]]
            covariance = np.zeros((4, 4))
            covariance[np.triu_indices(4)] = covariance.T[np.triu_indices(4)] = upper
            largest = plane.covariance.max()
            np.testing.assert_allclose(covariance, plane.covariance, atol=1e-6 * largest)
            assert row['sigma_normal'] == pytest.approx(np.sqrt(np.trace(covariance[:3, :3])))
            assert row['sigma_d'] == pytest.approx(np.sqrt(covariance[3, 3]))


def test_no_field_of_a_message_stays_empty():
    tables = [written(*image(seed)) for seed in SEEDS]
    row = np.zeros(1, PLANE_DTYPE)
    with_merged_label()[1].write_to(row)
    for name in PLANE_DTYPE.names:
        assert any(table[name].any() for table in [*tables, row]), name


def test_fields_that_are_promised_come_first_and_names_are_unique():
    assert PLANE_DTYPE.names[:len(FIRST)] == FIRST
    assert len(set(PLANE_DTYPE.names)) == sum(len(part.names.split()) for part in PUBLISHED)
    in_json = [part.json for part in PUBLISHED if part.json]
    assert len(set(in_json)) == len(in_json)
    assert all(part.doc for part in PUBLISHED)


def test_units_say_how_a_column_scales():
    for table in (Planes, Rectangles):
        for name, row in columns_of(table).items():
            assert row.unit in POWERS, name
            assert name.endswith('_m2') == (row.unit == 'm^2'), name
            assert name.endswith('_m') == (row.unit == 'm'), name


def test_columns_that_are_not_given_have_their_defaults():
    whole = image(SEEDS[0])[0].planes
    given = {name: getattr(whole, name) for name, row in COLUMNS.items() if row.default is None}
    planes = Planes(**given)
    assert planes.labels.tolist() == planes.merged.tolist() == [0] * len(whole)
    assert np.isnan(planes.class_certainties).all()
    assert planes[0].plane_class is PlaneClass.UNKNOWN
    with pytest.raises(TypeError):
        Planes(normals=whole.normals)

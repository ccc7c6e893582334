# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One persistent plane per surface, from the planes of images and the poses of their camera."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np

from plane_detector._runtime.compilation import load_once
from plane_detector.config import MapConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.association import (
    apart_in_image,
    assign,
    compare,
    fitting,
    visible,
)
from plane_detector.mapping.cells import (
    MOST_CELLS_IN_ALL,
    Cells,
    View,
    extents,
    sampled,
    vote,
)
from plane_detector.mapping.heights import PlaneFrames, heights_of, with_pose_error
from plane_detector.mapping.map_file import MOST_PLANES, SavedMap, read_map, write_map
from plane_detector.mapping.map_plane import CLASSES, MapPlane, as_planes, frames_of, new_axes
from plane_detector.mapping.merging import merge_touched
from plane_detector.mapping.registration import (
    Correction,
    Prediction,
    heights_by_others,
    motion,
    predict,
    register,
)
from plane_detector.planes.outline import PlacedDetection
from plane_detector.types import CameraIntrinsics, Detection, Planes

# The plane fitted to an exact surface differs by this, 1/m: rounding of depth and poses.
_LEAST_SYSTEMATIC = 1.5e-4
# chosen: rows on which points of detected planes are sampled; the smallest detectable plane, of .3
# % of the pixels, has about fifteen.
_ROWS = 60
FORGETTING = 0.95
# chosen: weight of a new image in the average of the jitter of the poses, over some twenty images.
SMOOTHING = 0.95
# chosen: number of images whose median is the systematic error of the sensor.
_RECENT = 20
# chosen: least weight of a view, however large the systematic error of the sensor is.
_LEAST_NEWS = 0.1
# Errors of a network's depth that the residuals do not reveal, because they are the same over a
# plane and in the next images: standard deviations of the distance, as a share, and of the normal
# about each axis.
# tuned: FastDepth on the odd images of kinect_walk, error over stated deviation of the distance,
# median: .15 1.8, .2 1.5; .1 with 3 degrees 2.7 (docs/results.md, "The map of planes").
_NETWORK_SHARE, _NETWORK_TILT_RAD = 0.2, np.radians(5.0)
# A view counts fully if the camera has moved this far since the last image.
_MOVED_M, _TURNED_RAD = 0.05, np.radians(3.0)
# A plane is added to the map if its normal is known within this.
_MOST_TILT_RAD = np.radians(5.0)
# A cell is hidden or gone if its pixel is farther off the plane than this plus its noise.
_TOLERANCE_M = 0.03
# A jump must explain this many times as many pixels, in this many consecutive images.
_JUMP_GAIN, _JUMP_IMAGES = 1.2, 2
# Share of the image that is unexplained although a known plane is there, before a jump is tried.
_UNEXPLAINED = 0.1
# A detected plane shows the plane of the map if they share this much of the smaller one.
_SAME_PLACE = 0.3
# A plane that was detected in only one image is dropped after this many.
_FORGOTTEN_IMAGES = 30


@dataclass(frozen=True)
class MapUpdate:
    """The changes made by an image."""

    labels: np.ndarray  # (K,) int, label in the map of each detected plane, 0 none
    explained: float  # share of the pixels of its planes that known planes explain
    jump_m: float = 0.0  # size of a jump of the poses; 0: no jump
    subsumed: Mapping[int, int] = field(default_factory=dict)  # label: the one it is now part of
    is_full: bool = False  # planes were left out or do not grow, because the map is full


@dataclass(frozen=True)
class MapSnapshot:
    """The map after an image."""

    surfaces: tuple[MapPlane, ...]
    planes: Planes  # the same in the frame of the poses, according to the last pose
    to_poses: RigidTransform  # from the frame of the map


class PlaneMap:
    """
    The planes of all images so far.

    Examples
    --------
    >>> from plane_detector import CameraIntrinsics, PlaneDetector
    >>> camera = CameraIntrinsics.from_field_of_view(160, 120, 60.0)
    >>> detector = PlaneDetector(depth_model=lambda rgb: np.full(rgb.shape[:2], 2.0, np.float32))
    >>> found = detector.detect(np.zeros((120, 160, 3), np.uint8), camera)
    >>> walls = PlaneMap()
    >>> for _ in range(2):
    ...     update = walls.update(PlacedDetection(found, camera, RigidTransform.identity(), 0.0))
    >>> update.labels, [round(plane.cells.area_m2, 1) for plane in walls.planes]
    (array([1]), [4.0])

    """

    def __init__(self, config: MapConfig | None = None):
        self.config = config or MapConfig()
        self._next_label = 1
        self.clear()

    def clear(self) -> None:
        """Discard all planes and the correction; labels are never reused."""
        self.planes: tuple[MapPlane, ...] = ()
        self.correction = Correction.none()
        self.images = 0
        self.up = np.array([0.0, 0.0, 1.0])
        self._jump_images = 0
        self._relative: dict[int, np.ndarray] = {}
        self.jitter_m = 0.0
        self._systematic: deque[float] = deque(maxlen=_RECENT)  # of images, 1/m

    def update(self, placed: PlacedDetection) -> MapUpdate:
        """
        Add the planes of an image.

        Raises
        ------
        ValueError
            The pose or the unit of the depth is unknown.

        """
        if placed.pose is None:
            raise ValueError('there is no map without poses')
        if not placed.detection.scale.is_metric:
            raise ValueError('there is no map without metres, and the scale of the depth is not '
                             'known: see scale.method')
        load_once('mapping')
        # The systematic error belongs to the sensor; single images overestimate it by far.
        self._systematic.append(placed.detection.systematic_noise)
        image = _Image.of(placed, max(median(self._systematic), _LEAST_SYSTEMATIC))
        # 1. The pose with the carried correction.
        prediction = predict(self.correction, placed.pose, self.config)
        # 2. to 5. Planes in view, candidates, correction from them, candidates again.
        attempt = self._registered(prediction, image)
        jump_m = 0.0
        if attempt.unexplained > _UNEXPLAINED:
            # Or has the pose jumped?
            wide = self._registered(prediction.widened(), image)
            if wide.explained > max(_JUMP_GAIN * attempt.explained, _UNEXPLAINED):
                self._jump_images += 1
                if self._jump_images < _JUMP_IMAGES:
                    return MapUpdate(self._labels(attempt), attempt.explained)
                jump_m = motion(prediction.camera, wide.correction.camera)[0]
                attempt = wide
        self._jump_images = 0
        # 6. Assign detected planes; two planes that this image shows separately stay separate.
        before, self.correction = self.correction, attempt.correction
        self._note_jitter(attempt.correction)
        self.images += 1
        if image.down is not None:
            self.up = -attempt.correction.camera.rotation @ image.down
        # 7. and 8. Fuse them; vote on the cells.
        self.planes, labels, is_full = self._fused(attempt, image, self._weight(before))
        # 9. Merge planes of one surface.
        self.planes, subsumed = merge_touched(self.planes, labels, self.up)
        # 10. Drop planes without cells, or seen only once.
        self.planes = self._kept()
        labels = np.array([subsumed.get(label, label) for label in labels.tolist()], int)
        return MapUpdate(labels, attempt.explained, jump_m, subsumed, is_full)

    @property
    def confirmed(self) -> tuple[MapPlane, ...]:
        """The planes that were detected again."""
        return tuple(plane for plane in self.planes if plane.views > 1 or self.images < 2)

    def snapshot(self) -> MapSnapshot:
        """Return the confirmed planes, according to the last pose."""
        confirmed = self.confirmed
        # The error of the correction is common to all planes that the last image does not show.
        planes = as_planes([replace(plane, covariance=self._relative.get(
            plane.label, plane.covariance)) for plane in confirmed])
        camera_m = self.correction.camera.translation_m if self.correction.pose else np.zeros(3)
        others = with_pose_error(planes, self.correction.error, camera_m)
        is_shown = np.isin(planes.labels, list(self._relative))
        planes = replace(planes, covariances=np.where(
            is_shown[:, None, None], planes.covariances, others.covariances))
        to_poses = self.correction.transform.inverse()
        return MapSnapshot(confirmed, planes.moved(to_poses), to_poses)

    def save(self, path: Path, frame_id: str, stamp_s: float) -> None:
        """
        Write the confirmed planes to a file, completely or not at all.

        Raises
        ------
        OSError
            It cannot be written.
        ValueError
            It would be too large to be read.

        """
        shown = self.snapshot()
        write_map(path, SavedMap(shown.surfaces, self.correction.transform, frame_id, stamp_s),
                  shown.planes)

    def lose_pose(self) -> None:
        """Note that the next pose may be off by as much as a jump, as after time jumped back."""
        self.correction = Correction.loaded(self.correction.transform)

    def load(self, path: Path, frame_id: str) -> None:
        """
        Replace the map by that of a file; on an error it stays as it is.

        Since then, the poses may have changed by as much as a jump.

        Raises
        ------
        OSError
            The file cannot be read.
        ValueError
            The map is incomplete, in another frame, with other cells, or of a later version.

        """
        saved = read_map(path, frame_id)
        if saved.planes and saved.planes[0].cells.size_m != self.config.cell:
            raise ValueError(f'{path} is a map with cells of {saved.planes[0].cells.size_m} m, '
                             f'map.cell is {self.config.cell}: set it to that, or load another '
                             'file')
        self.clear()
        self.planes = saved.planes
        self.correction = Correction.loaded(saved.transform)
        self._next_label = max([self._next_label, *(1 + plane.label for plane in saved.planes)])

    def _note_jitter(self, correction: Correction) -> None:
        """Average the difference of poses from the carried one over some twenty images."""
        camera, persistent = correction.camera, correction.persistent.after(correction.pose)
        off_m = np.linalg.norm(camera.translation_m - persistent.translation_m)
        self.jitter_m = float(np.sqrt(SMOOTHING * self.jitter_m**2 + (1 - SMOOTHING) * off_m**2))

    def _registered(self, prediction: Prediction, image: _Image) -> _Attempt:
        """Return the correction of an image from the map, and the planes that it shows."""
        all_frames = frames_of(self.planes)
        correction = register(prediction, image.found, all_frames, np.zeros(0, int))
        # Under the predicted pose, then under the pose registered to the planes that fit it.
        for is_last in (False, True):
            camera = correction.camera
            view = image.view(camera)
            index, counts = visible(self.planes, all_frames, view)
            frames = all_frames.selected(index)
            sizes = image.found.areas_m2 / (2 * self.config.cell)**2
            sharp = image.sharp.moved(camera)
            pairs = compare(frames, sharp, counts, sizes, correction.error, camera.translation_m)
            points_m = camera.points(image.points_m)
            fit = fitting(pairs, [self.planes[k] for k in index],
                          _split(points_m, image.ends), self.up)
            taken = assign(fit, image.apart, len(sizes))
            if not is_last:
                evidence, shown = np.append(index, -1)[taken], np.flatnonzero(taken >= 0)
                correction = register(prediction, image.sharp, frames.selected(taken[shown]),
                                      shown)
        beside = pairs.selected((pairs.shared > _SAME_PLACE) & (taken[pairs.new] < 0))
        total = max(image.found.counts.sum(), 1)
        found = sharp if image.found is image.sharp else image.found.moved(camera)
        return _Attempt(
            correction, view, all_frames, found, points_m, index, np.append(index, -1)[taken],
            evidence,
            float(image.found.counts[taken >= 0].sum() / total),
            float(image.found.counts[np.unique(beside.new)].sum() / total))

    def _fused(self, attempt: _Attempt, image: _Image, weight: float
               ) -> tuple[tuple[MapPlane, ...], np.ndarray, bool]:
        """Return the planes after an image, the label of each detected plane, and whether full."""
        planes, taken = list(self.planes), attempt.taken.copy()
        self._relative = self._fuse(planes, attempt, image, weight)
        is_new = (taken < 0) & image.is_clear
        has_too_many = bool(is_new.sum() + len(planes) > MOST_PLANES)
        fresh = np.flatnonzero(is_new)[:max(MOST_PLANES - len(planes), 0)]
        taken[fresh] = len(planes) + np.arange(len(fresh))
        planes += self._new(attempt, image, fresh)
        labels = np.array([planes[k].label if k >= 0 else 0 for k in taken], int)
        has_too_large = self._vote(planes, attempt, image, taken, labels)
        return tuple(planes), labels, has_too_many or has_too_large

    @staticmethod
    def _fuse(planes: list[MapPlane], attempt: _Attempt, image: _Image, weight: float
              ) -> dict[int, np.ndarray]:
        """
        Fuse the detected planes with their planes of the map, in place.

        Information is summed; known information is reduced by forgetting. Return the covariance
        (3, 3) of each plane, relative to the camera, by label.
        """
        shown = np.flatnonzero(attempt.taken >= 0)
        old, place = np.unique(attempt.taken[shown], return_inverse=True)
        frames = attempt.frames.selected(old)
        heights, covariances, by_pose = heights_by_others(
            attempt.correction, frames.selected(place), attempt.found, shown,
            (attempt.taken == attempt.evidence)[shown])
        known = FORGETTING**weight * np.linalg.inv(frames.covariances)
        added = weight * image.news[shown, None, None] * np.linalg.inv(covariances)
        vectors = (known @ frames.coefficients[:, :, None])[:, :, 0]
        np.add.at(known, place, added)
        np.add.at(vectors, place, (added @ heights[:, :, None])[:, :, 0])
        joint = np.linalg.inv(known)
        coefficients = (joint @ vectors[:, :, None])[:, :, 0]
        votes = np.zeros((len(old), CLASSES))
        np.add.at(votes, (place, image.found.classes[shown]), weight)
        for k, index in enumerate(old.tolist()):
            plane = planes[index]
            planes[index] = replace(plane, coefficients=coefficients[k], covariance=joint[k],
                                    votes=plane.votes + votes[k])
        # An observation corrects pose and plane together: relative to the camera, the error of a
        # plane in view is less than the sum of both errors. For any gain (Joseph).
        own = frames.covariances[place]
        gain = (by_pose + weight * own) @ np.linalg.inv(own + covariances)
        rest = np.eye(3) - gain
        seen = (rest @ (own + by_pose) @ rest.transpose(0, 2, 1)
                + gain @ (covariances - by_pose) @ gain.transpose(0, 2, 1))
        return {planes[attempt.taken[k]].label: seen[m] for m, k in enumerate(shown.tolist())}

    def _new(self, attempt: _Attempt, image: _Image, fresh: np.ndarray) -> list[MapPlane]:
        """Return planes of the map for detected planes that are not in it yet."""
        if not len(fresh):
            return []
        found = attempt.found
        normals = found.normals[fresh]
        points_m = _split(attempt.points_m, image.ends)
        middles_m = np.array([points_m[k].mean(axis=0) for k in fresh]).reshape(-1, 3)
        frames = PlaneFrames(middles_m, new_axes(normals, self.up), np.zeros((len(fresh), 3)),
                             np.zeros((len(fresh), 3, 3)))
        heights, covariances, _ = heights_of(frames, found, fresh, attempt.correction.error,
                                             attempt.correction.camera.translation_m)
        first, self._next_label = self._next_label, self._next_label + len(fresh)
        return [MapPlane(first + k, middles_m[k], frames.axes[k], heights[k], covariances[k],
                         Cells.none(self.config.cell), 0, image.stamp_s, image.stamp_s,
                         self.images, np.eye(CLASSES)[image.found.classes[fresh[k]]])
                for k in range(len(fresh))]

    def _vote(self, planes: list[MapPlane], attempt: _Attempt, image: _Image,
              taken: np.ndarray, labels: np.ndarray) -> bool:
        """Vote on the cells of the planes in view, in place; return whether some cannot grow."""
        in_view = np.union1d(attempt.index, taken[taken >= 0])
        frames = frames_of([planes[k] for k in in_view])
        own = np.where(taken >= 0, np.searchsorted(in_view, taken), -1)
        lows_m, highs_m = extents(attempt.points_m, image.ends, own, frames)
        borders_m = 0.05 * (highs_m - lows_m) + 2 * self.config.cell
        lows_m, highs_m = lows_m - borders_m, highs_m + borders_m
        others: dict[int, set[int]] = defaultdict(set)
        for k, beside in np.argwhere(image.beside).tolist():
            others[taken[k]].add(int(labels[beside]))
        is_found = np.bincount(own[own >= 0], minlength=len(in_view)).tolist()
        cells, changed, has_too_large = [], [], False
        left = MOST_CELLS_IN_ALL - sum(plane.cells.hits.size for plane in planes)
        for k, index in enumerate(in_view.tolist()):
            plane = planes[index]
            cells.append(plane.cells)
            changed.append({})
            if is_found[k]:
                grown = plane.cells.grown(lows_m[k], highs_m[k], left)
                has_too_large |= grown is None
                if grown is not None:
                    cells[-1] = grown
                    left -= grown.hits.size - plane.cells.hits.size
                changed[-1] = {'views': plane.views + 1, 'last_seen_s': image.stamp_s,
                               'apart': plane.apart | (others[index] - {0, plane.label})}
        steps = attempt.view.steps(
            frames, np.array([one.low for one in cells]).reshape(-1, 2), self.config.cell)
        for k, index in enumerate(in_view.tolist()):
            planes[index] = replace(planes[index], **changed[k], cells=vote(
                attempt.view, steps[k], cells[k], taken == index, _TOLERANCE_M))
        return has_too_large

    def _weight(self, before: Correction) -> float:
        """Return the weight of a view, 0 to 1, by how far the camera has moved."""
        if before.pose is None:
            return 1.0
        way_m, turn_rad = motion(before.camera, self.correction.camera)
        return min(1.0, way_m / _MOVED_M + turn_rad / _TURNED_RAD)

    def _labels(self, attempt: _Attempt) -> np.ndarray:
        return np.array([self.planes[k].label if k >= 0 else 0 for k in attempt.taken], int)

    def _kept(self) -> tuple[MapPlane, ...]:
        kept = tuple(plane for plane in self.planes if not plane.cells.is_gone and (
            plane.views > 1 or self.images - plane.first_image < _FORGOTTEN_IMAGES))
        if len(kept) == len(self.planes):
            return kept
        # Labels of removed planes are dropped too; their number would grow for ever.
        labels = frozenset(plane.label for plane in kept)
        return tuple(replace(plane, apart=plane.apart & labels) for plane in kept)


@dataclass(frozen=True)
class _Image:
    """An image in the form that the map needs, in the frame of the camera."""

    placed: PlacedDetection
    found: Planes
    # The same without the systematic error of the sensor. Planes of one image, and of the next,
    # share most of it, so it says little about whether two of them are one.
    sharp: Planes
    apart: np.ndarray  # (K, K) bool, not one plane, whatever the pose is
    beside: np.ndarray  # (K, K) bool, of these those on the same side
    points_m: np.ndarray  # (N, 3) on the detected planes, one after another
    ends: np.ndarray  # (K + 1,) int, start and end of those of each
    noise: float  # standard deviation of the disparity, 1/m
    news: np.ndarray  # (K,) weight of a view of each in the sum over views
    is_clear: np.ndarray  # (K,) bool, the normal is known well enough for a plane of the map

    @classmethod
    def of(cls, placed: PlacedDetection, systematic: float) -> _Image:
        """Return an image with the systematic error of the sensor, 1/m."""
        detection, intrinsics = placed.detection, placed.intrinsics
        sharp = found = found_planes(detection, intrinsics, _LEAST_SYSTEMATIC)
        if systematic > _LEAST_SYSTEMATIC:
            found = found_planes(detection, intrinsics, systematic)
        apart, same_side = apart_in_image(sharp)
        is_clear = np.sqrt(found.normal_variances) < _MOST_TILT_RAD
        noise = np.hypot(detection.disparity_noise, systematic)
        news = np.ones(len(found))
        if not detection.is_measured and len(found):
            # It differs from image to image, too.
            sharp = found = _with_network_error(found)
            noise = np.hypot(noise, _NETWORK_SHARE * np.nanmedian(1 / detection.depth_m))
        if systematic > _LEAST_SYSTEMATIC or not detection.is_measured:
            # A systematic error is the same in the next views: it does not average out.
            share = detection.planes.covariances[:, 3, 3] / found.covariances[:, 3, 3]
            news = np.maximum(share, _LEAST_NEWS)
        return cls(placed, found, sharp, apart, apart & same_side,
                   *sampled(detection.labels, found, intrinsics, _ROWS),
                   float(noise), news, is_clear)

    @property
    def stamp_s(self) -> float:
        return self.placed.stamp_s

    @property
    def down(self) -> np.ndarray | None:
        return self.placed.detection.gravity.gravity_camera

    def view(self, camera: RigidTransform) -> View:
        """Return the image from a pose in the map."""
        detection, lens = self.placed.detection, self.placed.intrinsics
        return View(np.ascontiguousarray(detection.labels, np.int32),
                    np.ascontiguousarray(detection.depth_m, np.float32),
                    (lens.fx, lens.fy, lens.cx, lens.cy), camera.inverse(), len(self.found),
                    self.noise)


@dataclass(frozen=True)
class _Attempt:
    """An image under one correction, in the frame of the map."""

    correction: Correction
    view: View
    frames: PlaneFrames  # of all planes of the map
    found: Planes
    points_m: np.ndarray  # (N, 3) those of the image
    index: np.ndarray  # (M,) int, planes of the map that are in view
    taken: np.ndarray  # (K,) int, plane of the map, -1 none
    evidence: np.ndarray  # (K,) int, the one used for the correction
    explained: float  # share of the pixels of the detected planes
    unexplained: float  # ... and of pixels that do not fit although a known plane is there


def found_planes(detection: Detection, intrinsics: CameraIntrinsics, systematic: float
                 ) -> Planes:
    """
    Return the planes of an image as arrays, with the systematic error of the sensor.

    It shifts a plane and tilts it over its extent: as 1/z = m . r of the ray r, with m = -n / d.
    """
    planes = detection.planes
    normals, offsets_m, centroids_m = planes.normals, planes.offsets_m, planes.centroids_m
    radius = np.sqrt(planes.counts / np.pi / (intrinsics.fx * intrinsics.fy))
    middle = centroids_m[:, :2] / np.maximum(centroids_m[:, 2:], 1e-3)
    by_error = np.zeros((len(planes), 3, 3))  # of m, by slopes along x and y, and a shift
    by_error[:, 0, 0] = by_error[:, 1, 1] = 1 / np.maximum(radius, 1e-3)
    by_error[:, 2, :2] = -middle * by_error[:, 0, 0, None]
    by_error[:, 2, 2] = 1.0
    by_m = np.empty((len(planes), 4, 3))  # of normal and offset
    by_m[:, :3] = offsets_m[:, None, None] * (
        normals[:, :, None] * normals[:, None, :] - np.eye(3))
    by_m[:, 3] = normals * offsets_m[:, None] ** 2
    jacobian = systematic * by_m @ by_error
    return replace(planes, covariances=planes.covariances
                   + jacobian @ jacobian.transpose(0, 2, 1))


def _with_network_error(planes: Planes) -> Planes:
    """Add the errors of a network: a rotation about the centroid, a share of the distance."""
    turn = np.diag([_NETWORK_TILT_RAD**2] * 3 + [0.0] * 3)
    covariances = with_pose_error(planes, turn, planes.centroids_m).covariances
    covariances[:, 3, 3] += (_NETWORK_SHARE * planes.offsets_m) ** 2
    return replace(planes, covariances=covariances)


def _split(values: np.ndarray, ends: np.ndarray) -> list[np.ndarray]:
    return [values[begin:end] for begin, end in pairwise(ends.tolist())]

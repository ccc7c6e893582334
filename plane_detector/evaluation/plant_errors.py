# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Plant errors, one at a time, in a copy of the tree, and name the test that catches each.

    python -m plane_detector.evaluation.plant_errors --only planes

The tests of a part run in order, those of the whole pipeline first, and stop at the first failure.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Part: the tests that concern it.
TESTS = {
    'pipeline': ('test/test_stream_state.py', 'test/test_handed_over.py'),
    'segmentation': ('test/test_cameras.py', 'test/test_scores.py', 'test/test_handed_over.py',
                     'test/segmentation'),
    'planes': ('test/test_cameras.py', 'test/planes'),
    'geometry': ('test/test_cameras.py', 'test/test_handed_over.py', 'test/geometry',
                 'test/test_plane_fields.py', 'test/directions/test_gravity_choice.py'),
    'scale': ('test/test_cameras.py', 'test/scale'),
    'directions': ('test/directions', 'test/test_pipeline_directions.py',
                   'test/test_stream_state.py'),
    'depth': ('test/depth', 'test/test_stream_state.py'),
    'shapes': ('test/tracking/test_shape_tracker.py', 'test/shapes'),
    'tracking': ('test/tracking',),
    'ground': ('test/ground',),
    'mapping': ('test/mapping', 'test/ros/test_live_map.py',
                'test/ros/test_live_map_limits.py'),
    'inputs': ('test/ros/inputs', 'test/ros/test_calibration.py',
               'test/ros/test_reset_inputs.py'),
    'outputs': ('test/ros/outputs', 'test/ros/test_live_map.py'),
    'tools': ('test/tools/test_export.py', 'test/tools/test_export_places.py',
              'test/tools/replay/test_replay.py')}
# File in the package: exact text that stands there once, what replaces it, what is wrong then.
ERRORS: dict[str, tuple[tuple[str, str, str], ...]] = {
    'tools/export.py': (
        ('height - 1 - y1), (x2, height - 1 - y2)',
         'y1), (x2, y2)', 'keep-out zones are upside down'),
        ('high[1] - corners[:, 1]', 'corners[:, 1] - low[1]', 'the floor plan is mirrored'),
        ('LEAST_GAP_M = 0.4', 'LEAST_GAP_M = 0.85', 'a passage is closed'),),
    'ros/live_map.py': (
        ('CLICK_REACH_M = 0.1', 'CLICK_REACH_M = 5.0', 'a click in the air is answered'),
        ('jitter_m > 2 * self', 'jitter_m > 200 * self', 'jitter of the poses is not reported'),),
    'segmentation/regions/curved.py': (
        ('abs(xx + yy) / 2 + np.sqrt((xx - yy)**2 / 4 + xy**2)',
         'abs(xx + yy) / 2', 'the mean curvature for the largest'),),
    'pipeline.py': (
        ('if epoch != self._epoch:\n            self._epoch, self._state',
         'if False:\n            self._epoch, self._state',
         'the state of a stage outlives a reset'),
        ('if stamp_s < self._stamp_s - JUMP_S:',
         'if stamp_s < self._stamp_s:', 'an image that was overtaken is a jump back in time'),
        ('is_trusted=(\n                observation.is_measured and '
         'surroundings.gravity.gravity_camera is not None)',
         'is_trusted=True',
         'planes of a network, or in the dark, show that nothing turns'),),
    'network_steps.py': (
        ('regions.restricted_to(np.isfinite(depth_m)) if is_rescaled else regions',
         'regions', 'planes have pixels beyond the largest depth'),
        ('np.radians(np.nan_to_num(scale.angle_sigma_deg))))',
         '0.0))', 'the error of the shift does not reach the orientation'),),
    'geometry/projection.py': (
        ('/ intrinsics.fx', '/ intrinsics.fy', 'fy for fx'),
        ('.width) - intrinsics.cx', '.width) + 1 - intrinsics.cx', 'a pixel off')),
    'segmentation/cells/grid.py': (
        ('-(width - 1) / 2', '-width / 2', 'half a pixel off'),
        ('size + (size - 1)', 'size + size + (size - 1)', 'rows off by one cell'),
        ('xy += sums[1, u]', 'xy -= sums[1, u]', 'sign of a mixed moment'),
        ('= xx * pixel**2 +', '= xx * pixel +', 'dropped factor of a moment'),
        ('2 * of_d + n * d', 'of_d + n * d', 'dropped factor of the squared disparity'),
        ('yy * xd - xy * yd', 'yy * xd + xy * yd', 'sign in the plane fit'),
        ('[i, j] -= factor', '[i, j] += factor', 'sign in an elimination')),
    'segmentation/cells/noise.py': (
        ('least = share * LOCAL_RATIO', 'least = LOCAL_RATIO',
         'local noise without the own share of pixels'),
        ('if share < MIN_OWN_SHARE or', 'if', 'smooth noise is local')),
    'segmentation/cells/model.py': (
        ('lateral * min(shared_px / moments[i, N], 1.0)',
         'lateral', 'lateral noise does not average out'),
        ('1 / noise.own_share if', 'noise.own_share if', 'the own share of pixels multiplied'),
        ('table[i, LOCAL_RATIO] = 1 + excess', 'table[i, LOCAL_RATIO] = 1',
         'the ratio of local noise is not passed on'),
        ('residual_rms=scale * grid.residual_rms',
         'residual_rms=grid.residual_rms', 'residuals of cells in the unit before')),
    'segmentation/cells/noise_correlation.py': (
        ('residuals[i] -= quadric', 'residuals[i] += quadric', 'bows are added'),),
    'segmentation/search/ransac.py': (
        ('return planes[:n], share', 'return planes[:n], 0.0', 'the same windows in each round'),),
    'segmentation/regions/model_selection.py': (
        ('2 * count[row, column] >=', '9 * count[row, column] >=',
         'a piece takes all cells that it touches'),),
    'segmentation/pixels/labelling.py': (
        ('1] + b * corner[0', '0] + b * corner[1', 'swapped axes of pixels'),
        ('* square * square', '* square', 'dropped factor in the tolerance of a pixel'),
        ('np.float32(1 / 9)', 'np.float32(1 / 8)', 'wrong factor of a mean of nine')),
    'segmentation/fine_pass.py': (
        ('* (own - other) >', '* (own - other) <', 'the wrong side of an intersection'),),
    'planes/measurement.py': (
        ('[k, XZ] + ((width - 1) / 2 - cx) * sums[k, Z]',
         '[k, XZ]', 'centroid without the principal point'),
        ('fx * fy * offset_m', 'fx * fx * offset_m', 'area with fx twice'),
        ('= offset_m * np.', '= np.', 'rms without the distance'),
        ('i] -= jacobian[i', 'i] += jacobian[i', 'normals look away'),
        ('pixels, offset_m', 'pixels, -offset_m', 'centroid beside its plane'),
        ('[0, 1] -= scale *', '[0, 1] += scale *', 'sign of a covariance'),
        ('[0, 0] += scale * s_yy', '[0, 0] += scale * s_xx', 'swapped variances'),
        ('offset_m * by_ray', 'by_ray', 'derivatives without the distance'),
        ('[0, fy, 0]', '[0, fx, 0]', 'fx for fy')),
    'planes/reorientation.py': (
        ('** 2 - LOG_SHIFT_ODDS', '** 2', 'a common shift without odds against it'),
        ('in (0, len(SHIFT_SHARES) // 2, len(SHIFT_SHARES) - 1)', 'in (len(SHIFT_SHARES) // 2,)',
         'a shift at the end of its range is taken')),
    'planes/classification.py': (
        ('UPRIGHT_SHARE / np.pi', 'UPRIGHT_SHARE * np.pi', 'too many planes are upright before'),
        ('<= -np.cos(np.radians(TOL', '<= -np.sin(np.radians(TOL', 'slopes are level'),
        ('above = facing_down >= np', 'above = facing_down <= -np', 'floor and ceiling swapped'),
        ('np.sin(np.radians(upright))', 'np.cos(np.radians(upright))', 'sine and cosine swapped')),
    'scale/floor.py': (
        ('by_gravity = scale * sine * np.radians(tolerance_deg) / 2 *',
         'by_gravity = 0 *', 'the error of gravity is none of the scale'),
        ('floor_height / height_m', 'floor_height * height_m', 'height multiplied'),
        ('FloorFit(scale, scale * found', 'FloorFit(scale, found', 'shift without the scale')),
    'scale/shift_posterior.py': (
        ('\n            + np.log(np.maximum(np.gradient(logit), 1e-12)))',
         ')', 'the prior of a shift depends on the steps of its grid'),
        ('- 3 * np.log(length)', '+ 3 * np.log(length)', 'flat worlds are likely'),
        (' * angle_sigma_deg / max(spread_deg, 1e-9)', '',
         'the error of a shift is all of its spread'),
        ('angle_sigma_deg > MAX_ANGLE_SIGMA_DEG', 'angle_sigma_deg > 180',
         'uncertain angles are not refused')),
    'scale/sensor_depth.py': (
        (', -beta / alpha,', ', -beta,', 'shift from measured depth without its scale'),),
    'scale/temporal_filter.py': (
        ('inverse)).max()', 'inverse)).min()', 'the change is the least one'),),
    'scale/right_angles.py': (
        ('coplanar.any(0)', 'coplanar.all(0)', 'pieces of one plane are several'),
        ('middle - reach, middle', 'middle + reach, middle', 'one of two shifts of a pair'),
        ('1.0 - 0.5 * (off', '1.0 + 0.5 * (off', 'planes off their axes count more'),
        ('3 * sigma_deg', '3 / sigma_deg', 'the surest planes may be off most'),
        ('middle = -0.5', 'middle = 0.5', 'sign of the shift from right angles'),),
    'scale/disparity_planes.py': (
        ('normals[..., 2] += tau', 'normals[..., 2] -= tau', 'sign of the shift'),
        ('self.coefficients + [0.0, 0.0, shift]',
         '(self.coefficients + [0.0, 0.0, shift])', 'shift in the wrong unit'),),
    'directions/vanishing.py': (
        ('cosine * level - sine', 'cosine / level - sine',
         'axes of a rising floor are none'),),
    'directions/frames.py': (
        ('weight * sine * sine', 'weight / sine * sine',
         'scatter of a fit without its misalignments'),),
    'directions/surfaces.py': (
        ('thinned[len(thinned) - quarter:]', 'thinned[len(thinned) + quarter:]',
         'the trend of the disparity is not seen'),
        ('(1 - USUAL_RATIO) - near', '(1 - USUAL_RATIO) - far', 'the usual shift at the far end')),
    'directions/posterior.py': (
        ('self.downs[is_near] - down', 'self.downs[is_near] + down',
         'the spread of a mode about its opposite'),
        ('Posterior(downs[kept], masses', 'Posterior(-downs[kept], masses', 'gravity points up'),
        ('(best % 3 + 1) % 3', 'best % 3', 'the vertical is its own horizontal axis')),
    'types.py': (
        ('self.tolerance_deg <= COARSE', 'self.tolerance_deg > COARSE',
         'coarse gravity is sure'),),
    'directions/finder.py': (
        ('LIKELY_SIGMAS * float(sigma', 'LIKELY_SIGMAS / float(sigma',
         'the surest vertical is off most'),
        ("' if measured is None", "' if measured is not None", 'wrong source of gravity'),
        ('if not is_trusted or _has_turned(self._normals, normals):',
         'if not is_trusted:', 'lines are held while the camera turns'),
        ('(abs(same @ same.T) > math', '(abs(same @ same.T) < math',
         'one plane shows every turn'),
        ('None if image.has_shift else surface, *by', 'surface, *by',
         'normals at a guessed shift are evidence'),
        ('hold_time * self._hold_times', 'hold_time / self._hold_times',
         'the time of held lines inverted')),
    'depth/preprocessing.py': (
        ('float32(value / std)', 'float32(value)', 'scale and mean without the deviation'),
        ('1 / values if output in DEPTHS else values',
         'values', 'depth resized as depth, then inverted'),
        ('(self.top * down)', '(self.left * down)', 'borders of the other axis'),
        ('height / height) - 0.5', 'height / height)', 'half a pixel off')),
    'depth/readers.py': (
        ('1 / np.maximum(depth, _MIN', '1 * np.maximum(depth, _MIN',
         'far points decide the shift of a point map'),
        ('framing.focal_px(intrinsics) / self.canonical_focal_px',
         'self.canonical_focal_px / framing.focal_px(intrinsics)', 'lens inverted'),
        ('intrinsics.fy / intrinsics.height / focal_per_height',
         'focal_per_height / intrinsics.fy * intrinsics.height',
         'correction of the lens inverted'),
        (', dtype=float) >', ', dtype=float) <', 'normals away from the camera')),
    'depth/views.py': (
        ('np.minimum(inner[::-1]', 'np.maximum(inner[::-1]',
         'crops end in a step'),
        ('view.is_at_end) * is_valid', 'view.is_at_end) / is_valid',
         'invalid pixels of a crop are infinite'),
        ('cv2.flip(crop, 1) if view.is_mirrored else crop',
         'crop + 0', 'a mirrored view not turned back'),),
    'depth/far.py': (
        ('blur(grey * grey', 'blur(grey / grey',
         'a textured wall is sky'),
        ('rgb[2] - rgb[0] >=', 'rgb[1] - rgb[0] >=',
         'green for blue'),
        ('darkest = np.minimum(', 'darkest = np.maximum(', 'a yellow wall is an overexposed sky'),
        ('FAR_DEVIATIONS * noise', 'noise', 'dropped factor of the noise'),
        ('_is_bright(small, _MIN_FLAT_GREY, 0.0)', '_is_bright(small, 0.0, 0.0)',
         'dark regions are sky')),
    'depth/temporal_filter.py': (
        ('known[thinned].any()', 'known[thinned].all()',
         'nothing moves beside an invalid pixel'),
        ('mean = np.abs(_block_means(difference))', 'mean = (_block_means(difference))',
         'what becomes farther does not move'),
        ('(high - low)', '(high + low)',
         'the range of disparities from zero'),
        ('PER_MEDIAN * np.median(residual)', 'PER_MEDIAN / np.median(residual)',
         'wild values change the scale'),
        ('min(keep, previous.image_count / (previous.image_count + 1))',
         'keep', 'the first images weigh more'),),
    'depth/observation.py': (
        ('self._average.image_count == 1',
         'self._average.image_count <= 2', 'the second image of a still scene is not averaged'),
        ('values / np.float32(median', 'values * np.float32(median',
         'relative depth times its median'),),
    'depth/plausibility.py': (
        ('correlation < -_MIN', 'correlation < _MIN',
         'a network that sees no corridor is refused'),
        ("-_FACES_M['left'] / x", "-_FACES_M['left'] * x",
         'a wall of the corridor is bent')),
    'shapes/surfels.py': (
        ('/ camera.fy', '/ camera.fx', 'fx for fy in the points of cells'),),
    'shapes/views.py': (
        ('/ camera.fy', '/ camera.fx', 'fx for fy in the points of pixels'),
        ('+ right / 2 - camera', '- right * 9 - camera', 'silhouette inside the shape')),
    'shapes/detector.py': (
        ('tuple(replace(shape, label=label)', 'tuple(shape',
         'shapes without the labels of their tracks'),),
    'shapes/surface.py': (
        ('root, half - root', 'root, half + root', 'far side of a shape'),),
    'shapes/fitting.py': (
        ('* sine + along *', '* sine - along *', 'sign in the derivative by the half angle'),),
    'shapes/search.py': (
        ('apex, axis * np.', 'apex, -axis * np.', 'cones on the other side'),),
    'shapes/labelling.py': (
        ('high_m - low_m', 'high_m', 'a cylinder is measured from its position'),),
    'plane_fields.py': (
        ('scale * values - normals', 'scale * values + normals', 'sign of the translation'),
        ('-translation_m @ rotation', '-translation_m', 'covariance moved without the rotation'),
        ('scale**power', 'scale**-power', 'another unit divides'),
        ('normal_x normal_y', 'normal_y normal_x', 'swapped fields of ~/planes'),
        ('values[:, 3, 3]', 'values[:, 2, 2]', 'the error of a normal for that of d'),
        ('return np.sqrt(np.maximum(variances, 0.0))', 'return np.maximum(variances, 0.0)',
         'variances for deviations')),
    'tracking/camera_motion.py': (
        ('(min(max((rotation.trace', '(min(min((rotation.trace', 'any turn is as likely'),
        ('[-normals * typical_m', '[-normals / typical_m', 'translation in the wrong unit'),
        ('left[:, 2] *= -1', 'left[:, 2] *= 1', 'a mirror for a rotation'),
        ('left[:, 2] *= -1', 'left[:, 1] *= -1', 'a mirror mended by another axis')),
    'tracking/matching.py': (
        ('spreads[k, 1] += cov', 'spreads[k, 2] += cov', 'normals without their errors'),
        ('exp(-apart_m2 / small_m2)', 'exp(-apart_m2 * small_m2)',
         'large planes are near each other less'),
        ('variance += 2 *', 'variance -= 2 *', 'sign of a mixed covariance'),
        ('after[1][n], before', '-after[1][n], before', 'sign of an offset'),
        ('is_kept = missed <', 'is_kept = missed >', 'missing shapes are forgotten'),
        ('variance / spreads[k, 0]', 'variance * spreads[k, 0]',
         'errors of offsets not as a share of the distance')),
    'tracking/shape_tracker.py': (
        ('_MAX_SIZE_CHANGE * max(a, b)', '_MAX_SIZE_CHANGE * min(a, b)',
         'share of the smaller of two sizes'),),
    'tracking/tracker.py': (
        ('trust = (1 - _YOUTH / known.streaks) * np.where(known.missed > 0, _MISSED, 1.0)',
         'trust = np.ones(len(known.streaks))',
         'young and missed planes are trusted like others'),
        ('* np.where(known.missed > 0, _MISSED, 1.0)',
         '* 1.0', 'missed planes are trusted like others'),
        ('share > _MERGED', 'share < _MERGED', 'merged where little is shared'),
        ('labels=labels, merged', 'labels=np.arange(1, len(labels) + 1), merged',
         'labels are not those of the tracks')),
    'ground/obstacles.py': (
        ('abs(a * ray_x[u] + b) * z * z',
         'abs(b) * z * z', 'errors of heights without the column'),
        ('z <= box[5]', 'z <= box[4]',
         'a side of the box of another axis'),),
    'ground/ground.py': (
        ('TAPE_SHARE = 0.01, 0.02',
         'TAPE_SHARE = 0.01, 0.08', 'a height that is off by a twelfth is not said'),
        ('(down[2], -1, 1)', '(down[1], -1, 1)', 'tilt about the wrong axis')),
    'ground/surfaces.py': (
        ('[self.normals * inv', '[-self.normals * inv', 'normals look down'),
        ('] + self.offsets[', '] - self.offsets[', 'sign of an offset'),
        ('inverse[:, None], self', '1.0, self', 'off the plane, not along gravity')),
    'ground/along_ways.py': (
        ('min(-off, under)', 'max(-off, under)',
         'lower than a ramp would be'),
        ('margin = abs(s) * z * z', 'margin = s * z * z',
         'errors of depth are drops'),
        ('0.5 * (ray_y[v] + ray_y[h])', '0.5 / (ray_y[v] + ray_y[h])',
         'another ray of a border'),
        ('planes[a, OFFSET]) <= max_step', 'planes[a, OFFSET]) >= max_step',
         'planes that meet are apart'),
        ('else z * _far(down, x, y)', 'else z * sight', 'down for ahead'),
        ('min(-off, under)', 'min(off, under)', 'higher for lower'),
        ('x_end * end_z[w], y_end * end_z[w]', 'x_end, y_end', 'edges without their distance'),
        ('s * second + planes[a, OFFSET]', 's * second + planes[b, OFFSET]',
         'the offset of the other plane')),
    'mapping/heights.py': (
        ('heights - frames.coefficients, cov', 'heights + frames.coefficients, cov',
         'sign in the chi-squared of an association'),
        ('= coefficients[m] - heights[m]', '= heights[m] - coefficients[m]',
         'the correction of the poses inverted'),
        ('to_map @ covariances[m] @ to_map.T', 'covariances[m]',
         'the covariance of a moved plane in its old frame'),
        ('[:, 3, :3] = -(centre_m', '[:, 3, :3] = (centre_m', 'sign of the arm of a rotation')),
    'mapping/association.py': (
        ('+ sizes[new] - both', '+ sizes[new] + both', 'a union with common cells twice'),),
    'mapping/registration.py': (
        ('-_cross_matrix(moved_m)',
         '_cross_matrix(moved_m)', 'the drift of the rotation moves the camera the other way'),
        ('MOST_CORRECTION_M = 0.2',
         'MOST_CORRECTION_M = 20', 'poses that run away are not reported'),
        ('way_m / TYPICAL_M', 'way_m * TYPICAL_M', 'drift of the rotation by the wrong distance'),
        ('Prediction(before.persistent, pose, drift, drift',
         'Prediction(RigidTransform.identity(), pose, drift, drift',
         'the correction is not carried on'),),
    'mapping/plane_map.py': (
        ('self.images, np.eye(CLASSES)',
         '0, np.eye(CLASSES)', 'what was seen once is forgotten by the age of the map'),
        ('max([self._next_label, *(1 + plane.label for plane in saved.planes)])',
         'self._next_label', 'labels of a loaded map are given again'),
        ('self.correction = Correction.loaded(self.correction.transform)',
         'pass', 'after a jump back in time the pose is as sure as before'),
        ('FORGETTING**weight * np', 'np', 'nothing is forgotten'),
        ('[_NETWORK_TILT_RAD**2] * 3', '[0.0] * 3', 'normals of a network without their error'),
        ('is_clear = np.sqrt(found', 'is_clear = 0 * np.sqrt(found',
         'planes of any normal are added')),
    'mapping/cells.py': (
        ('hits[i, j] += is_hit', 'hits[i, j] += 1', 'every look at a cell is a hit'),),
    'mapping/merging.py': (
        ('smaller.label in larger.apart or larger.label in smaller.apart',
         'larger.label == smaller.label', 'planes that an image has shown apart become one'),),
    'ros/inputs/image_decoding.py': (
        ('cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION', 'cv2.IMREAD_COLOR',
         'images are turned as their files say'),
        (">' if msg.is_bigendian else '<", "<' if msg.is_bigendian else '>", 'byte order'),),
    'ros/inputs/depth_decoding.py': (
        ('abs(x_m / z_m - own[..., 0]) + abs(y_m / z_m - own[..., 1])',
         'abs(x_m / z_m - own[..., 0])', 'rows of a cloud in any order'),
        ("_field(msg, 'z') * (unit_m or 1.0)", "_field(msg, 'z')",
         'clouds without the unit'),
        ("'16uc1': ('u2', 0.001)", "'16uc1': ('u2', 0.01)", 'centimetres for millimetres'),
        ('counts - np.float32(shift)',
         'counts + np.float32(shift)', 'sign of the shift of inverse depth'),
        ('x_m / z_m - own', 'x_m / z_m + own', 'mirrored rays of a cloud'),
        ('(msg.row_step, msg.point_step))',
         '(msg.width * msg.point_step, msg.point_step))', 'rows of a cloud without their ends')),
    'ros/inputs/rvl.py': (
        ('^ -(change & 1)', '^ (change & 1)', 'sign of a change of depth'),
        ('place = 28 - 4 * (at', 'place = 4 * (at', 'nibbles from the lower end')),
    'ros/inputs/frame_conversion.py': (
        ('_with_size(info, rgb)', 'info',
         'a calibration without a size'),
        ('(reduction, info.distortion_model', '(info.distortion_model',
         'maps of another size are kept'),
        ('np.reshape(info.r, (3, 3)), rectified', 'np.reshape(info.r, (3, 3)).T, rectified',
         'R inverted'),
        ('None if depth_m is None else rectification.depth(depth_m)', 'depth_m',
         'depth is not rectified')),
    'ros/inputs/synchronizer.py': (
        ('            self._gravity.reset()\n', '',
         'gravity from before a jump back in time'),),
    'ros/calibration.py': (
        ('msg.roi.x_offset', 'msg.roi.y_offset', 'swapped offsets of a cut image'),
        ('.y_offset) / every_y', '.y_offset) / every_x', 'binning of the other axis')),
    'ros/inputs/transforms.py': (
        ('self._buffer.clear()', 'pass', 'transforms from before a jump back in time'),
        ('if edge is None or edge.is_static != is_static:', 'if edge is None:',
         'a frame with two parents'),
        ('-self.to_base.rotation[2]', '-self.to_base.rotation[:, 2]',
         'gravity in the wrong frame'),),
    'ros/outputs/clouds.py': (
        ('target_header, PLANE_DTYPE',
         'header, PLANE_DTYPE', '~/planes in the frame of the camera'),
        ('polygon.corners_m[:1]', 'polygon.corners_m[-1:]', 'outlines that do not close'),
        ('[v, u, 1] = (e * x + f) * z + h',
         '[v, u, 1] = (e * x + f) * z + d', 'shift of the other axis in ~/points'),
        ('found.obstacles,', 'found.mask,', 'the ground as obstacle')),
    'ros/outputs/frame.py': (
        ('[found.shape_labels[is_shape]]', '[found.shape_labels[is_shape] - 1]',
         'pixels of another shape'),),
    'ros/outputs/map_messages.py': (
        ('rectangles_of(surfaces).moved(view.snapshot.to_poses)', 'rectangles_of(surfaces)',
         'rectangles of a map before its correction'),
        ('view.snapshot.to_poses.points(_triangles(plane))', '_triangles(plane)',
         'surfaces of a map before its correction')),
    'ros/outputs/plane_json.py': (
        ('is_metric or not POWERS[part.unit]', 'is_metric or part.unit',
         'areas in metres without metres'),),
    'ros/outputs/messages.py': (
        ('(z_axes, x_axes)', '(x_axes, z_axes)', 'poses are mirrored'),),
    'tools/replay/writer.py': (
        ('cv2.cvtColor(_figure(result), cv2.COLOR_RGB2BGR)', '_figure(result)',
         'red for blue in figures'),)}


def part_of(file: str) -> str:
    """Return the part of TESTS that a file belongs to: its folder; in ros, inputs or outputs."""
    if file in ('pipeline.py', 'network_steps.py'):
        return 'pipeline'
    folder = file.split('/')[0] if '/' in file else 'geometry'
    if folder != 'ros':
        return folder
    return 'outputs' if 'outputs' in file or 'live_map' in file else 'inputs'


def main() -> None:
    """Plant the chosen errors and print a Markdown table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--only', default='', metavar='PART', help=f'one of {", ".join(TESTS)}')
    only = parser.parse_args().only
    chosen = [(file, *error) for file, errors in ERRORS.items() for error in errors
              if only in ('', part_of(file))]
    gone = [f'{file}: {old}' for file, old, _, _ in chosen
            if (ROOT / 'plane_detector' / file).read_text(encoding='utf-8').count(old) != 1]
    if gone:
        sys.exit('these texts do not stand exactly once in their files:\n' + '\n'.join(gone))
    print('| part | error | file | caught by | s |\n|---|---|---|---|---|', flush=True)
    caught, failing, passing = 0, [], set()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder, 'tree')
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns('.git', '.venv', '__pycache__'))
        for file, old, new, wrong in chosen:
            path, start_s = tree / 'plane_detector' / file, time.monotonic()
            right, times = path.read_text(encoding='utf-8'), path.stat()
            path.write_text(right.replace(old, new), encoding='utf-8')
            test = first_failure(tree, TESTS[part_of(file)], failing)
            path.write_text(right, encoding='utf-8')
            # With the old time its loops need not be compiled again.
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            if test and test not in passing and first_failure(tree, (test,)):
                failing.append(test)
                test = f'nothing, but {test} fails without an error too'
            passing.add(test)
            caught += bool(test) and not test.startswith('nothing')
            print(f'| {part_of(file)} | {wrong} | {file} | {test or "**nothing**"} '
                  f'| {time.monotonic() - start_s:.0f} |', flush=True)
    print(f'\n{caught} of {len(chosen)} were caught.')


def first_failure(tree: Path, tests: tuple[str, ...], left_out: list[str] | None = None) -> str:
    """Return the first test that fails in a tree, some left out; empty if none does."""
    data = os.environ.get('PLANE_DETECTOR_DATA', str(ROOT.parent / 'shared' / 'data'))
    for path in tests:
        done = subprocess.run(
            [sys.executable, '-m', 'pytest', '-x', '-q', '-rfE', path,
             *(f'--deselect={test}' for test in left_out or ())], cwd=tree, text=True,
            capture_output=True, check=False, env={**os.environ, 'PLANE_DETECTOR_DATA': data})
        if done.returncode not in (0, 5):  # 5: all of its tests are left out
            names = re.findall(r'^(?:FAILED|ERROR) (.+?)(?: - |$)', done.stdout, re.MULTILINE)
            return names[0] if names else f'{path}: exit code {done.returncode}'
    return ''


if __name__ == '__main__':
    main()

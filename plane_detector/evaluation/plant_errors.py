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
    'segmentation': ('test/test_cameras.py', 'test/test_scores.py', 'test/segmentation'),
    'planes': ('test/test_cameras.py', 'test/planes'),
    'geometry': ('test/test_cameras.py', 'test/geometry'),
    'scale': ('test/test_cameras.py', 'test/scale'),
    'directions': ('test/directions', 'test/test_pipeline_directions.py'),
    'depth': ('test/depth',),
    'shapes': ('test/shapes',),
    'tracking': ('test/tracking',),
    'ground': ('test/ground',),
    'inputs': ('test/ros/inputs', 'test/ros/test_calibration.py'),
    'outputs': ('test/ros/outputs',)}
# Part, file in the package, exact text that stands there once, what replaces it, what is wrong.
ERRORS = (
    ('geometry', 'geometry/projection.py',
     'ray_x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx',
     'ray_x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fy', 'fy for fx'),
    ('geometry', 'geometry/projection.py',
     'u_px = points_m[..., 0] / z_m * intrinsics.fx + intrinsics.cx',
     'u_px = points_m[..., 0] / z_m * intrinsics.fx + intrinsics.cx + 1', 'a pixel off'),
    ('segmentation', 'segmentation/cells/grid.py',
     'return (float(width), (part[1].start - (width - 1) / 2) / width,',
     'return (float(width), (part[1].start - width / 2) / width,', 'half a pixel off'),
    ('segmentation', 'segmentation/cells/grid.py',
     'y = frame[2] + (row * size + (size - 1) / 2) * pixel',
     'y = frame[2] + (row * size + size + (size - 1) / 2) * pixel', 'rows off by one cell'),
    ('segmentation', 'segmentation/cells/grid.py', 'xy += sums[1, u] * x', 'xy -= sums[1, u] * x',
     'sign of a mixed moment'),
    ('segmentation', 'segmentation/cells/grid.py',
     'out[XX] = xx * pixel**2 + x * (of_x + sum_x)', 'out[XX] = xx * pixel + x * (of_x + sum_x)',
     'dropped factor of a moment'),
    ('segmentation', 'segmentation/cells/grid.py', 'out[DD] = dd + d * (2 * of_d + n * d)',
     'out[DD] = dd + d * (of_d + n * d)', 'dropped factor of the squared disparity'),
    ('segmentation', 'segmentation/cells/plane_fit.py',
     'a, b = (yy * xd - xy * yd) * inverse', 'a, b = (yy * xd + xy * yd) * inverse',
     'sign in the plane fit'),
    ('segmentation', 'segmentation/cells/plane_fit.py',
     'work[i, j] -= factor * work[k, j]', 'work[i, j] += factor * work[k, j]',
     'sign in an elimination'),
    ('segmentation', 'segmentation/pixels/labelling.py',
     'local[k, 2] = a * corner[1] + b * corner[0] + planes[label, 2]',
     'local[k, 2] = a * corner[0] + b * corner[1] + planes[label, 2]', 'swapped axes of pixels'),
    ('segmentation', 'segmentation/pixels/labelling.py',
     'pixels[3, p] = pixels[4, p] = of_noise + of_depth * square * square',
     'pixels[3, p] = pixels[4, p] = of_noise + of_depth * square',
     'dropped factor in the tolerance of a pixel'),
    ('segmentation', 'segmentation/pixels/labelling.py',
     'mean = (total[u - 1] + total[u] + total[u + 1]) * np.float32(1 / 9)',
     'mean = (total[u - 1] + total[u] + total[u + 1]) * np.float32(1 / 8)',
     'wrong factor of a mean of nine'),
    ('segmentation', 'segmentation/fine_pass.py', 'is_own = side * (own - other) > 0 if',
     'is_own = side * (own - other) < 0 if', 'the wrong side of an intersection'),
    ('planes', 'planes/measurement.py',
     'x_z = width * sums[k, XZ] + ((width - 1) / 2 - cx) * sums[k, Z]',
     'x_z = width * sums[k, XZ]', 'centroid without the principal point'),
    ('planes', 'planes/measurement.py',
     'row[AREA] = sums[k, ZZZ] / (fx * fy * offset_m)',
     'row[AREA] = sums[k, ZZZ] / (fx * fx * offset_m)', 'area with fx twice'),
    ('planes', 'planes/measurement.py',
     'row[RMS] = offset_m * np.sqrt(sums[k, SQUARE] / pixels)',
     'row[RMS] = np.sqrt(sums[k, SQUARE] / pixels)', 'rms without the distance'),
    ('planes', 'planes/measurement.py', 'row[i] -= jacobian[i, j] * planes[k, j]',
     'row[i] += jacobian[i, j] * planes[k, j]', 'normals look away'),
    ('planes', 'planes/measurement.py', 'off_plane = sums[k, Z] / pixels, offset_m',
     'off_plane = sums[k, Z] / pixels, -offset_m', 'centroid beside its plane'),
    ('planes', 'planes/measurement.py', 'fit[0, 1] -= scale * xy', 'fit[0, 1] += scale * xy',
     'sign of a covariance'),
    ('planes', 'planes/measurement.py', 'fit[0, 0] += scale * s_yy', 'fit[0, 0] += scale * s_xx',
     'swapped variances'),
    ('planes', 'planes/measurement.py',
     'chain[i, j] += offset_m * by_ray * jacobian[k, j]',
     'chain[i, j] += by_ray * jacobian[k, j]', 'derivatives without the distance'),
    ('planes', 'planes/measurement.py',
     '[0, intrinsics.fy / width, 0]', '[0, intrinsics.fx / width, 0]', 'fx for fy'),
    ('planes', 'planes/classification.py', 'above = facing_down >= level',
     'above = facing_down <= -level', 'floor and ceiling swapped'),
    ('planes', 'planes/classification.py', 'classes[np.abs(facing_down) <= upright]',
     'classes[np.abs(facing_down) <= level]', 'sine and cosine swapped'),
    ('scale', 'scale/floor.py', 'return 1.0 / alpha, -beta / alpha, jacobian',
     'return 1.0 / alpha, beta / alpha, jacobian', 'sign of the shift from the floor'),
    ('scale', 'scale/floor.py',
     'design = np.stack([gravity_camera / height_m, [0.0, 0.0, 1.0]], axis=1)',
     'design = np.stack([gravity_camera * height_m, [0.0, 0.0, 1.0]], axis=1)',
     'height multiplied'),
    ('scale', 'scale/sensor_depth.py', 'return DepthFit(1.0 / alpha, -beta / alpha,',
     'return DepthFit(1.0 / alpha, -beta,', 'shift from measured depth without its scale'),
    ('scale', 'scale/manhattan.py', 'middle = -0.5 * (first[:, 2] + second[:, 2])',
     'middle = 0.5 * (first[:, 2] + second[:, 2])', 'sign of the shift from right angles'),
    ('scale', 'scale/disparity_planes.py',
     'return scale * self.coefficients + [0.0, 0.0, shift]',
     'return scale * (self.coefficients + [0.0, 0.0, shift])', 'shift in the wrong unit'),
    ('directions', 'directions/posterior.py',
     'downs, left, close = bases[:, 0], mass', 'downs, left, close = -bases[:, 0], mass',
     'gravity points up'),
    ('directions', 'directions/posterior.py',
     'x = np.cos(angle) * bases[best, 1] + np.sin(angle) * bases[best, 2]',
     'x = np.cos(angle) * bases[best, 2] + np.sin(angle) * bases[best, 1]', 'swapped axes'),
    ('directions', 'directions/gravity_choice.py', "source = 'parameter' if measured is None",
     "source = 'parameter' if measured is not None", 'wrong source of gravity'),
    ('depth', 'depth/preprocessing.py', 'planes[channel] -= np.float32(mean / std)',
     'planes[channel] -= np.float32(mean)', 'mean without its deviation'),
    ('depth', 'depth/preprocessing.py',
     "disparity = 1 / values if output == 'metric_depth' else values", 'disparity = values',
     'depth resized as depth, then inverted'),
    ('depth', 'depth/readers.py',
     'framing.focal_px(intrinsics) / self.canonical_focal_px',
     'self.canonical_focal_px / framing.focal_px(intrinsics)',
     'lens inverted'),
    ('depth', 'depth/readers.py', 'return intrinsics.fy / intrinsics.height / focal_per_height',
     'return focal_per_height / intrinsics.fy * intrinsics.height',
     'correction of the lens inverted'),
    ('depth', 'depth/readers.py', 'return -normals if np.nanmean(np.sign(away), dtype=float) > 0',
     'return -normals if np.nanmean(np.sign(away), dtype=float) < 0',
     'normals away from the camera'),
    ('depth', 'depth/preprocessing.py', 'rows = slice(round(self.top * down)',
     'rows = slice(round(self.left * down)', 'borders of the other axis'),
    ('depth', 'depth/preprocessing.py', '* (intrinsics.height / height) - 0.5',
     '* (intrinsics.height / height)', 'half a pixel off'),
    ('depth', 'depth/views.py', 'crop = crop[:, ::-1] if view.is_mirrored else crop',
     'crop = crop + 0', 'a mirrored view not turned back'),
    ('depth', 'depth/far.py', 'else FAR_DEVIATIONS * noise', 'else noise',
     'dropped factor of the noise'),
    ('depth', 'depth/temporal_filter.py',
     'weight = min(keep, previous.image_count / (previous.image_count + 1))', 'weight = keep',
     'the first images weigh more'),
    ('depth', 'depth/estimator.py', 'LOAD / rate_hz - other_s', 'LOAD / rate_hz + other_s',
     'sign of the other work'),
    ('shapes', 'shapes/surfels.py', '(camera.height - 1) / 2) / camera.fy',
     '(camera.height - 1) / 2) / camera.fx', 'fx for fy in the points of cells'),
    ('shapes', 'shapes/views.py', 'rays[:, 1] = (v - camera.cy) / camera.fy',
     'rays[:, 1] = (v - camera.cy) / camera.fx', 'fx for fy in the points of pixels'),
    ('shapes', 'shapes/views.py', 'found[count, 0] = (u + right / 2 - camera[2]) / camera[0]',
     'found[count, 0] = (u - right * 9 - camera[2]) / camera[0]', 'silhouette inside the shape'),
    ('shapes', 'shapes/surface.py', 'np.stack([half + root, half - root])',
     'np.stack([half + root, half + root])', 'far side of a shape'),
    ('shapes', 'shapes/fitting.py', 'row[6] = -(away * sine + along * cosine)',
     'row[6] = -(away * sine - along * cosine)', 'sign in the derivative by the half angle'),
    ('shapes', 'shapes/search.py', 'shapes[AXIS] = apex, axis * np.sign(cosine)[:, None]',
     'shapes[AXIS] = apex, -axis * np.sign(cosine)[:, None]', 'cones on the other side'),
    ('shapes', 'shapes/labelling.py', 'length_m=high_m - low_m)', 'length_m=high_m)',
     'a cylinder is measured from its position'),
    ('tracking', 'tracking/camera_motion.py', 'self.scale * planes.offsets_m - normals',
     'self.scale * planes.offsets_m + normals', 'sign of the translation'),
    ('tracking', 'tracking/matching.py', '@ after.normals.T + after.offsets_m)',
     '@ after.normals.T - after.offsets_m)', 'sign of an offset'),
    ('tracking', 'tracking/tracker.py', 'counts = np.bincount(pixels + 1,',
     'counts = np.bincount(pixels + 2,', 'labels off by one'),
    ('tracking', 'tracking/matching.py', 'not in matched and track.missed < keep_frames',
     'not in matched and track.missed > keep_frames', 'missing shapes are forgotten'),
    ('tracking', 'tracking/tracker.py', 'share * old_offset_m + (1 - share) * plane.offset_m',
     'share * plane.offset_m + (1 - share) * old_offset_m', 'smoothing of offsets inverted'),
    ('tracking', 'tracking/tracker.py',
     'return found, tuple(track.label for track in self._known.tracks[:len(planes)])',
     'return found, tuple(range(1, len(planes) + 1))', 'labels are not those of the tracks'),
    ('ground', 'ground/ground.py',
     'return np.column_stack([self.normals, self.offsets, 1 / upright])',
     'return np.column_stack([-self.normals, self.offsets, 1 / upright])', 'normals look down'),
    ('ground', 'ground/ground.py',
     'heights = (self.centroids @ self.normals[own] + self.offsets[own])',
     'heights = (self.centroids @ self.normals[own] - self.offsets[own])', 'sign of an offset'),
    ('ground', 'ground/columns.py',
     'far = z * (level[1, 0] * x + level[1, 1] * y + level[1, 2])',
     'far = z * (level[0, 0] * x + level[0, 1] * y + level[0, 2])', 'down for ahead'),
    ('ground', 'ground/columns.py',
     'b, last = (planes[r, 1] * y + planes[r, 2]) * planes[r, 4], r',
     'b, last = planes[r, 1] * y + planes[r, 2], r', 'off the plane, not along gravity'),
    ('ground', 'ground/columns.py',
     'if min(-off, under) > min_drop + margin and z > end_z[u]:',
     'if min(off, under) > min_drop + margin and z > end_z[u]:', 'higher for lower'),
    ('ground', 'ground/columns.py',
     'row[0], row[1], row[2], row[3], row[4] = x * z, y * z, z, drop, u',
     'row[0], row[1], row[2], row[3], row[4] = x, y, z, drop, u',
     'edges without their distance'),
    ('ground', 'ground/columns.py',
     'gap = abs((s * second + planes[a, 3]) * planes[a, 4])',
     'gap = abs(s * second + planes[b, 3])', 'the offset of the other plane'),
    ('ground', 'ground/ground.py',
     'tilt_deg = float(np.degrees(np.arcsin(np.clip(down[2], -1, 1))))',
     'tilt_deg = float(np.degrees(np.arcsin(np.clip(down[1], -1, 1))))',
     'tilt about the wrong axis'),
    ('inputs', 'ros/inputs/image_decoding.py',
     "depth_m = _pixels(msg, 'u2', 1)[..., 0] * np.float32(0.001)",
     "depth_m = _pixels(msg, 'u2', 1)[..., 0] * np.float32(0.01)", 'centimetres for millimetres'),
    ('inputs', 'ros/inputs/image_decoding.py',
     "'>' if msg.is_bigendian else '<'", "'<' if msg.is_bigendian else '>'", 'byte order'),
    ('inputs', 'ros/calibration.py', 'sent[0, 2] -= msg.roi.x_offset',
     'sent[0, 2] -= msg.roi.y_offset', 'swapped offsets of a cut image'),
    ('inputs', 'ros/calibration.py', 'sent[1] /= binning[1]', 'sent[1] /= binning[0]',
     'binning of the other axis'),
    ('inputs', 'ros/inputs/transforms.py',
     'return CameraPose(-to_base.rotation.T @ up_base,',
     'return CameraPose(-to_base.rotation @ up_base,', 'gravity in the wrong frame'),
    ('outputs', 'ros/outputs/clouds.py',
     "('normal_x', 'normal_y', 'normal_z'), [plane.normal for plane in planes]",
     "('normal_y', 'normal_x', 'normal_z'), [plane.normal for plane in planes]",
     'swapped fields of ~/planes'),
    ('outputs', 'ros/outputs/clouds.py',
     'return cloud_msg(frame.target_header, PLANE_DTYPE, table, 1, len(table))',
     'return cloud_msg(frame.header, PLANE_DTYPE, table, 1, len(table))',
     '~/planes in the frame of the camera'),
    ('outputs', 'ros/outputs/clouds.py',
     'closed_m += polygon.corners_m, polygon.corners_m[:1]',
     'closed_m += polygon.corners_m, polygon.corners_m[-1:]', 'outlines that do not close'),
    ('outputs', 'ros/outputs/clouds.py', 'numbers[v, u, 1] = e * x + f * y + g * z + h',
     'numbers[v, u, 1] = e * x + f * y + g * z + d', 'shift of the other axis in ~/points'),
    ('outputs', 'ros/outputs/clouds.py', '_xyz_to_msg(frame, ~frame.detection.ground)',
     '_xyz_to_msg(frame, frame.detection.ground | False)', 'the ground as obstacle'),
    ('outputs', 'ros/outputs/messages.py', 'np.cross(z_axes, x_axes)', 'np.cross(x_axes, z_axes)',
     'poses are mirrored'))


def main() -> None:
    """Plant the chosen errors and print a Markdown table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--only', default='', metavar='PART', help=f'one of {", ".join(TESTS)}')
    chosen = [one for one in ERRORS if parser.parse_args().only in ('', one[0])]
    gone = [f'{file}: {old}' for _, file, old, _, _ in chosen
            if (ROOT / 'plane_detector' / file).read_text(encoding='utf-8').count(old) != 1]
    if gone:
        sys.exit('these texts do not stand exactly once in their files:\n' + '\n'.join(gone))
    print('| part | error | file | caught by | s |\n|---|---|---|---|---|', flush=True)
    caught, failing, passing = 0, [], set()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder, 'tree')
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns('.git', '.venv', '__pycache__'))
        for part, file, old, new, wrong in chosen:
            path, start_s = tree / 'plane_detector' / file, time.monotonic()
            right = path.read_text(encoding='utf-8')
            path.write_text(right.replace(old, new), encoding='utf-8')
            test = first_failure(tree, TESTS[part], failing)
            path.write_text(right, encoding='utf-8')
            if test and test not in passing and first_failure(tree, (test,)):
                failing.append(test)
                test = f'nothing, but {test} fails without an error too'
            passing.add(test)
            caught += bool(test) and not test.startswith('nothing')
            print(f'| {part} | {wrong} | {file} | {test or "**nothing**"} '
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

# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Posterior of the vertical and of the azimuth of the scene, on a grid.

1. A frame of three perpendicular axes has pitch and roll, which give the vertical, and an azimuth.
   The prior is how cameras are held, or a coarse direction of gravity.
2. Each line segment points to one of the axes, with a normal error, or anywhere. Segments of one
   line share one vote.
3. Each normal of the surface, by the depth, is along one of the axes, or horizontal, or anything.
4. The evidence is tempered: edges of one object and normals of one surface are not independent.
5. The lines along the vertical may be those of one thing that leans, a ladder or a fence, unless
   the other lines and the normals fit the same frame.
6. The grid is coarse first; the best cells are divided once more. The answer is the mean vertical
   of the main mode, with the probability of the verticals around it (Coughlan and Yuille 1999
   maximise the same mixture; here its mass is needed).

References
----------
Coughlan, Yuille: Manhattan world: compass direction from a single image by Bayesian inference,
ICCV 1999.

"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.compilation import kernel
from plane_detector.directions.frames import misalignment
from plane_detector.directions.line_segments import LineSegments

# Prior of pitch and roll about the expected vertical: of a camera held by hand or on a robot, and
# of a coarse direction of gravity.
HELD_DEG, COARSE_DEG = (35.0, 12.0), (12.0, 12.0)
MAX_PITCH_DEG, MAX_ROLL_DEG, STEP_DEG = 60.0, 36.0, 6.0
# Each step is divided by three; the best cells hold nearly all of the mass.
DIVIDED_CELLS, DIVISION = 40, 3
# Added to all errors for the distance to the next point of the grid, coarse and fine.
COARSE_ERROR_DEG, FINE_ERROR_DEG = 2.5, 0.8
# Error of a segment: of edges and lens, and of its ends over its length at unit focal length.
LINE_DEG, END_ERROR = 1.0, 0.0013
# Lines closer than this, seen from the camera, are one. derived: 14 pixels of 640.
SAME_LINE_DEG = 1.5
# Votes of a line of this length at unit focal length, growing with the root of the length.
# tuned: seeds 300 to 309 of the rooms of benchmark orientation and real frames; at 0.4 one of ten
# images of random strokes is answered, at 0.25 one answer in a kitchen less.
LINE_VOTE, FULL_LENGTH, MAX_VOTES = 0.35, 0.114, 2.0
# Votes of all normals of an image, of which so many are used, and the error of those of a network
# and of a sensor.
# tuned: of a sensor, on the motorcycle and the Kinect, NYU, kitchen and living room frames, where
# all 25 verticals are answered from 4 to 7 degrees, within 3.3 of a plane, and 21 at 14.
SURFACE_VOTES, SURFACE_NORMALS = 16.0, 90
NETWORK_NORMAL_DEG, SENSOR_NORMAL_DEG = 14.0, 7.0
# Shares of lines and normals that are along no axis, and of normals that are only horizontal.
STRAY_LINES, STRAY_NORMALS, OTHER_WALLS = 0.4, 0.3, 0.2
# Share of the images whose upright lines are those of a thing that leans, and the angle beyond
# which a line is not one of them.
LEANING, OTHER_LINE_DEG = 0.15, 4.0
# Verticals within this angle of the answer are the same. derived: what planes can use.
CLOSE_DEG = 5.0
# Errors beyond three standard deviations do not count.
MOST_VARIANCES = 9.0
# Keeps the direction of a line defined where it passes through the vanishing point.
MIN_IMAGE_LENGTH2 = 1e-3


@dataclass(frozen=True)
class UprightPosterior:
    """
    The main mode of the posterior.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: the mean vertical, downwards, and the most likely horizontal axes about it.
    probability : float
        That the true vertical is within CLOSE_DEG of it.

    """

    axes: np.ndarray
    probability: float


def upright_posterior(segments: LineSegments, surface: np.ndarray | None = None,
                      coarse_down: np.ndarray | None = None,
                      normal_deg: float = NETWORK_NORMAL_DEG) -> UprightPosterior:
    """
    Return the posterior of the vertical of an image.

    Parameters
    ----------
    segments : LineSegments
    surface : (N, 3) floating, optional
        Normals of the depth; those without a direction are 0.
    coarse_down : (3,) floating, optional
        Unit direction of gravity, known coarsely; default: that of a camera held upright.
    normal_deg : float
        Error of the normals.

    """
    normal_rad = np.radians(normal_deg)
    lines, normals = _lines(segments), _some_normals(surface)
    spread_deg = HELD_DEG if coarse_down is None else COARSE_DEG
    turn = np.eye(3) if coarse_down is None else _turn_from_upright(np.asarray(coarse_down, float))

    def log_posterior(angles: np.ndarray, error_deg: float) -> tuple[np.ndarray, np.ndarray]:
        frames = np.ascontiguousarray(_frames(angles) @ turn.T)
        pitch, roll = np.radians(angles[:, :2].T)
        prior = (np.log(np.cos(pitch))
                 - 0.5 * ((angles[:, :2] / spread_deg) ** 2).sum(axis=1))
        return frames, prior + _log_likelihood(frames, lines, normals,
                                                np.radians(error_deg), normal_rad)

    coarse = _grid(*(np.arange(-most, most + 1, STEP_DEG)
                     for most in (MAX_PITCH_DEG, MAX_ROLL_DEG)), np.arange(0, 90, STEP_DEG))
    best = np.argsort(-log_posterior(coarse, COARSE_ERROR_DEG)[1])[:DIVIDED_CELLS]
    inside = (np.arange(DIVISION) - (DIVISION - 1) / 2) * STEP_DEG / DIVISION
    fine = (coarse[best][:, None] + _grid(inside, inside, inside)).reshape(-1, 3)
    frames, score = log_posterior(fine, FINE_ERROR_DEG)
    mass = np.exp(score - score.max())
    axes, probability = _main_mode(frames, mass / mass.sum())
    others = np.abs(misalignment(segments, axes[0])) > np.sin(np.radians(OTHER_LINE_DEG))
    gain = _log_likelihood(axes[None], lines[others], normals, np.radians(FINE_ERROR_DEG),
                           normal_rad)[0]
    leaning = LEANING / (1 - LEANING) * np.exp(-gain)
    return UprightPosterior(axes, probability / (1 + leaning))


def _main_mode(frames: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the vertical with most mass around it and the best axes about it; that mass."""
    downs, close = frames[:, 0], np.cos(np.radians(CLOSE_DEG))
    near = downs @ downs[np.argsort(-mass)[:DIVIDED_CELLS]].T > close
    is_near = near[:, (mass @ near).argmax()]
    for _ in range(2):
        down = _unit(mass[is_near] @ downs[is_near])
        is_near = downs @ down > close
    x = frames[np.where(is_near, mass, 0).argmax(), 1]
    x = _unit(x - (x @ down) * down)
    return np.stack([down, x, np.cross(down, x)]), float(mass[is_near].sum())


def _grid(*axes: np.ndarray) -> np.ndarray:
    return np.stack([grid.ravel() for grid in np.meshgrid(*axes, indexing='ij')], axis=1)


def _frames(angles_deg: np.ndarray) -> np.ndarray:
    """Return frames (C, 3, 3) from pitch, roll and azimuth (C, 3); the vertical is first."""
    pitch, roll, azimuth = np.radians(angles_deg.T)
    down = np.stack([-np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch),
                     np.sin(pitch)], axis=1)
    right = np.stack([np.cos(roll), np.sin(roll), np.zeros(len(roll))], axis=1)
    x = np.cos(azimuth)[:, None] * right + np.sin(azimuth)[:, None] * np.cross(down, right)
    return np.stack([down, x, np.cross(down, x)], axis=1)


def _turn_from_upright(down: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) that takes the vertical of an upright camera to another one."""
    upright = np.array([0.0, 1.0, 0.0])
    across = np.cross(upright, down)
    length = np.linalg.norm(across)
    angle = np.arctan2(length, upright @ down)
    return cv2.Rodrigues(angle * (across / length if length > 1e-9 else np.eye(3)[2]))[0]


def _lines(segments: LineSegments) -> np.ndarray:
    """Return planes through the camera, midpoints, variances and votes of segments, (N, 8)."""
    normals = segments.normals
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    in_line = (np.abs(unit @ unit.T) > np.cos(np.radians(SAME_LINE_DEG))).sum(axis=1)
    variance = np.radians(LINE_DEG) ** 2 + (END_ERROR / segments.lengths) ** 2
    votes = np.minimum(np.sqrt(segments.lengths / FULL_LENGTH), MAX_VOTES) * LINE_VOTE / in_line
    return np.column_stack([normals, segments.midpoints, variance, votes])


def _some_normals(surface: np.ndarray | None) -> np.ndarray:
    if surface is None:
        return np.zeros((0, 3))
    known = surface[np.abs(surface).sum(axis=1) > 0]
    return np.ascontiguousarray(known[::max(1, len(known) // SURFACE_NORMALS)])


@kernel('float64[::1](float64[:, :, ::1], float64[:, ::1], float64[:, ::1], float64, float64)')
def _log_likelihood(frames, lines, normals, error_rad, normal_rad):
    """Return the tempered log likelihood (C,) of frames, up to a constant."""
    found = np.zeros(len(frames))
    variance = normal_rad * normal_rad + error_rad * error_rad
    # Densities relative to a uniform one: of six directions and of a circle on the sphere.
    of_axis = 4 * np.pi / (6 * 2 * np.pi * variance)
    of_circle = 4 * np.pi / (2 * np.pi * np.sqrt(2 * np.pi * variance))
    for c in range(len(frames)):
        axes = frames[c]
        for i in range(len(lines)):
            n, m = lines[i, :3], lines[i, 3:6]
            spread, near = lines[i, 6] + error_rad * error_rad, 0.0
            for k in range(3):
                a = axes[k]
                x, y = a[0] - m[0] * a[2], a[1] - m[1] * a[2]
                cross = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
                length2 = (x * x + y * y + MIN_IMAGE_LENGTH2) * spread
                if cross * cross < MOST_VARIANCES * length2:
                    near += np.exp(-0.5 * cross * cross / length2)
            if near > 0:
                near *= np.pi / (3 * np.sqrt(2 * np.pi * spread))
                found[c] += lines[i, 7] * np.log(1 + (1 / STRAY_LINES - 1) * near)
        product = 1.0  # of at most 100 factors between 0.3 and 5
        for i in range(len(normals)):
            near, circle, n = 0.0, 0.0, normals[i]
            for k in range(3):
                cosine = n[0] * axes[k, 0] + n[1] * axes[k, 1] + n[2] * axes[k, 2]
                if 1 - cosine * cosine < MOST_VARIANCES * variance:
                    near += np.exp(-0.5 * (1 - cosine * cosine) / variance)
                if k == 0 and cosine * cosine < MOST_VARIANCES * variance:
                    circle = np.exp(-0.5 * cosine * cosine / variance)
            product *= STRAY_NORMALS + (1 - STRAY_NORMALS) * (
                (1 - OTHER_WALLS) * of_axis * near + OTHER_WALLS * of_circle * circle)
        found[c] += SURFACE_VOTES * np.log(product) / max(len(normals), 1)
    return found


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)

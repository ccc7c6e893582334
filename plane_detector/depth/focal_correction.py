# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Correction of metric depth for the focal length of the camera.

Metric networks assume the camera that they were trained with. With a longer lens, objects appear
nearer by the ratio of the focal lengths (the canonical camera of Metric3D, Yin et al. 2023);
multiplying the depth by this ratio corrects it.
"""

from __future__ import annotations

from plane_detector.types import CameraIntrinsics

OWN_FOCAL = -1.0


def lens_factor(intrinsics: CameraIntrinsics, reference_focal_px: float,
                focal_per_height: float) -> float:
    """
    Return the factor that corrects the metres of a network.

    Parameters
    ----------
    intrinsics : CameraIntrinsics
        Of the image.
    reference_focal_px : float
        Focal length that the network assumes, at the width of the image; 0: no correction;
        OWN_FOCAL: the focal length that the network is known to be trained with.
    focal_per_height : float
        Focal length over image height that the network is known to be trained with; 0: unknown.

    Returns
    -------
    float
        1 if no correction is needed or the focal length is unknown.

    """
    if reference_focal_px > 0:
        return intrinsics.fx / reference_focal_px
    if reference_focal_px == OWN_FOCAL and focal_per_height > 0:
        return intrinsics.fy / intrinsics.height / focal_per_height
    return 1.0
